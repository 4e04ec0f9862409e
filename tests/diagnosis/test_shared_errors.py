"""Intervals after a diagnosis include the errors that presses share."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from report.diagnosis_cases import LOOP, calibration, refitted, refitted_loop, session

from skincal.calibration import Calibration
from skincal.dataset import LOAD, UNLOAD, Dataset, ForceSpec
from skincal.diagnosis.observed import observe
from skincal.inference.start import with_image_error
from skincal.prediction import predict_dataset

ANGLE, STIFFNESS, SCALE = "alpha_deg", "elasticity_pa_per_m", "scale_per_n"


def width(found: Calibration, name: str) -> float:
    low, high = found.intervals[name]
    return high - low


def off(data: Dataset, error_m: np.ndarray) -> Dataset:
    """Return the session with position errors (P, 2) [m] across and along."""
    presses, frames = data.presses, data.frames
    assert frames is not None
    row = np.searchsorted(presses.press, np.maximum(frames.press, presses.press[0]))
    moved = data.surface().offset(presses.position_m, *error_m.T)
    of_frames = data.surface().offset(frames.position_m, *error_m[row].T)
    return replace(
        data, presses=replace(presses, position_m=moved), frames=replace(frames, position_m=of_frames)
    )


def test_smooth_position_errors_widen_the_angle():
    wider = list[float]()
    for presses in (24, 36):
        data = session(LOOP, presses)
        along = data.presses.position_m[:, 1] - data.presses.position_m[:, 1].mean()
        smooth = np.outer(along, [0.1, -0.06])
        # Permuted errors for comparison: the widths of single permutations scatter as much as the expected difference.
        orders = [np.random.default_rng(k).permutation(smooth) for k in (1, 2, 3)]
        found, *permuted = (refitted(off(data, errors)) for errors in (smooth, *orders))
        wider.append(width(found, ANGLE) / float(np.mean([width(one, ANGLE) for one in permuted])))
        if presses == 24:
            low, high = found.intervals[ANGLE]
            assert low <= calibration().model.alpha_deg <= high
    assert np.mean(wider) > 1.1


def test_force_scale_widens_the_stiffness():
    data = session(LOOP)
    found = refitted(replace(data, meta=replace(data.meta, force=ForceSpec(scale_sigma=0.1))))
    best = found.model.elasticity_pa_per_m
    assert width(found, STIFFNESS) > 0.4 * best > width(refitted_loop(), STIFFNESS)


def test_scale_interval_contains_the_middle_of_a_loop():
    # In our equation the lower curve is that of the base model; in others it is the middle of the loop.
    data, state = session(LOOP), calibration(LOOP)
    loaded = predicted(state, data, LOAD) / predicted(calibration(), data, LOAD)
    unloaded = predicted(state, data, UNLOAD) / predicted(calibration(), data, UNLOAD)
    plain = refitted_loop()
    low, high = plain.intervals[SCALE]
    middle = plain.model.scale_per_n * (1 + unloaded / loaded) / 2
    assert low < plain.model.scale_per_n < middle < high


def predicted(state: Calibration, data: Dataset, phase: int) -> float:
    """Return the sum of the predicted counts in a phase."""
    frames = predict_dataset(state, data).dataset.frames
    assert frames is not None
    return float(np.nansum(frames.counts[frames.phase == phase]))


def test_image_error_is_estimated():
    data, state = session(LOOP), calibration(LOOP)
    found = []
    for size in (0.0, 0.2):
        observed = observe(scattered(data, size), state, np.random.default_rng(0))
        fitter = observed.fitter
        fit = fitter.solve(fitter.priors.start, steps=3)
        found.append(with_image_error(fitter, fit.state).priors.image)
    assert found[0] <= 0.02 and found[1] >= 0.05


def scattered(data: Dataset, size: float) -> Dataset:
    """Return the session with a relative error of each taxel in each press."""
    frames = data.frames
    assert frames is not None
    rng = np.random.default_rng(3)
    off = 1 + size * rng.standard_normal((len(data.presses), frames.counts.shape[1]))
    row = np.searchsorted(data.presses.press, np.maximum(frames.press, data.presses.press[0]))
    own = np.where(frames.press[:, None] >= 0, off[row], 1.0)
    return replace(data, frames=replace(frames, counts=frames.counts * own))
