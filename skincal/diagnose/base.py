"""The base model to start from: a calibration's, or a guess where there is none; and the noise of a dataset."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from skincal.calibration import MARGIN_M, Calibration
from skincal.dataset import Dataset, idle_means
from skincal.dataset.uniform import uniform_pressure
from skincal.diagnose.session import hold_groups, readout_of, repeats, rest_means
from skincal.effects.samples import HOLD
from skincal.fit.observe import Readout, clipped_share, observe
from skincal.gap.base import AROUND_M, FINER_M, BaseColumns, BaseModel, resolution_of
from skincal.gap.idle_noise import idle_noise
from skincal.gap.noise import (
    NoiseFloor,
    frame_scatter,
    noise_floor,
    noisy_taxels,
    plateau_scatter,
    repeat_scatter,
    rounding,
)
from skincal.inference.session import GapSession
from skincal.model import Cylinder, Plane
from skincal.model.arrays import FloatArray, IntArray

GUESSED_PA_PER_M = 4.5e8
"""E where no calibration says it [Pa/m]: the middle of the range that a fit searches, on a logarithmic scale."""

GUESSED_PER_N = 70.0
"""S where neither a calibration nor data say it [1/N]."""

MOST_TAXELS = 48
"""So many taxels of a large sensor are looked at."""

_LIT_COUNTS = 5.0


def calibrated_model(calibration: Calibration, dataset: Dataset) -> BaseModel:
    """The base model of a calibration, read out by a dataset's converter."""
    parameters = calibration.parameters()
    # A chamber shares its force out over the whole skin, so the skin must be as large as the calibration's; but every
    # part of a taxel is loaded alike.
    uniform = uniform_pressure(dataset)
    layout = calibration.layout()
    surface = calibration.surface_model()
    finest = resolution_of(layout, FINER_M) if dataset.frames is None else resolution_of(layout)
    # In a chamber every part of a taxel is loaded alike, and the fit's own cells are those of its scales; a mesh gives
    # the areas of cells only.
    exact = not uniform and isinstance(surface, Cylinder | Plane)
    return BaseModel(
        surface,
        layout,
        calibration.pose(),
        parameters.elasticity_pa_per_m,
        parameters.scale_per_n,
        readout_of(dataset),
        float(layout.sizes_m.min()) / 2 if uniform else finest,
        margin_m=MARGIN_M if uniform else AROUND_M,
        rule="gauss" if exact else "midpoint",
    )


def guessed_model(dataset: Dataset, session: GapSession) -> BaseModel:
    """A base model for a dataset without a calibration: nominal pose, a middle E, and the S of these counts."""
    readout = readout_of(dataset)
    layout = dataset.layout()
    model = BaseModel(
        dataset.surface(),
        layout,
        dataset.nominal_pose(),
        GUESSED_PA_PER_M,
        1.0,
        readout,
        resolution_of(layout),
    )
    if session.counts is None:
        return _scaled(model, GUESSED_PER_N)
    # Of the strongest taxel of each image, which hardly depends on where exactly the press was.
    load = session.means(model.skin.values(session.samples)).max(axis=1)
    rest = idle_means(dataset) if uniform_pressure(dataset) else rest_means(dataset)
    seen = np.nan_to_num(session.counts - (0.0 if rest is None else np.nan_to_num(rest))).max(axis=1)
    lit = (load > 0.1 * load.max(initial=0.0)) & (seen > _LIT_COUNTS)
    return _scaled(model, float(np.median(seen[lit] / load[lit])) if lit.any() else GUESSED_PER_N)


def _scaled(model: BaseModel, scale_per_n: float) -> BaseModel:
    return replace(model, scale_per_n=scale_per_n)


def thinned(model: BaseModel, session: GapSession, most: int = MOST_TAXELS) -> GapSession:
    """The session as not too many taxels see it: some of those that the presses reach, evenly spread.

    Args:
        model: the base model.
        session: of all taxels.
        most: how many are kept at most.
    """
    taxels = model.layout.taxels
    if taxels <= most:
        return session
    reached = np.flatnonzero((model.skin.values(session.samples) > _LIT_COUNTS).any(axis=0))
    reached = reached if len(reached) else np.arange(taxels)
    places = np.linspace(0, len(reached) - 1, min(most, len(reached)))
    return session.of_taxels(reached[np.rint(places).astype(np.int64)])


def hold_slopes(session: GapSession, base: BaseColumns, presses: int) -> FloatArray:
    """Slopes (P, J, 3) of the hold images by place and force: the last part of each hold."""
    slopes = np.zeros((presses, *base.press.shape[1:]))
    held = np.flatnonzero((session.phase == HOLD) & (session.press >= 0))
    slopes[session.press[held]] = np.nan_to_num(base.press[held])
    return slopes


def floor_of(
    dataset: Dataset,
    press_slopes: FloatArray | None,
    rng: np.random.Generator,
    taxels: IntArray | None = None,
) -> NoiseFloor:
    """The noise floor of a dataset.

    Args:
        dataset: the session.
        press_slopes: (P, J, 3) slopes of hold images by place and force; None: repeats are not used.
        rng: for intervals.
        taxels: (J,) those that the slopes, and noise by taxel, are of; None for all.
    """
    readout, nothing = readout_of(dataset), (np.zeros(0), np.zeros(0))
    presses, frames = dataset.presses, dataset.frames
    seen = observe(presses.counts, readout)
    rest_scatter = seen.rest_sigma_counts
    if uniform_pressure(dataset):
        # No taxel is untouched there: what the weakest presses scatter by is what they differ by.
        rest_scatter = float(np.fmin(rest_scatter, plateau_scatter(presses.counts, presses.force_n)))
    of_frames, of_repeats, hold_frames, idle = nothing, nothing, 1.0, None
    own = np.full(presses.counts.shape[1], np.nan)
    if frames is not None:
        groups = hold_groups(dataset)
        own = noisy_taxels(frames.counts, groups, readout)
        usual = frames.counts if np.isnan(own).all() else frames.counts[:, np.isnan(own)]
        of_frames = frame_scatter(usual, groups, readout)
        idle = idle_noise(usual[frames.press < 0], readout)
        held = np.bincount(groups[groups >= 0])
        hold_frames = float(np.median(held[held > 0])) if held.any() else 1.0
    elif np.isfinite(seen.frame_sigma_counts):
        hold_frames = _frames_of_a_mean(seen.frame_sigma_counts, rest_scatter, readout)
    first, second = repeats(dataset)
    if press_slopes is not None and len(first):
        counts = presses.counts if taxels is None else presses.counts[:, taxels]
        use = counts > (readout.value_min or 0.0) + 4
        if readout.value_max is not None:
            use &= counts < readout.value_max - 4
        of_repeats = repeat_scatter(counts, first, second, press_slopes, use)
    rest = rest_means(dataset)
    found = noise_floor(of_frames, of_repeats, rest, rest_scatter, hold_frames, readout, rng, idle)
    if taxels is not None:
        own = own[taxels]
    return found if np.isnan(own).all() else found.by_taxel(own)


def _frames_of_a_mean(sigma: float, rest_scatter: float, readout: Readout) -> float:
    """How many frames a hold mean stands for, from how much less untouched taxels scatter than a frame would."""
    if not rest_scatter > 0:
        return 1.0
    share = clipped_share(readout.value_min or 0.0, sigma, readout)
    return max(1.0, float(np.hypot(sigma, rounding(readout)) * share / rest_scatter) ** 2)
