"""Hold images of presses at moved positions, for a skin with effects.

The influence of memory on a hold depends on the course of the press and on the presses before it, but hardly varies
within the slack of a press. Let x be the loads of a hold without memory and y those with it, both at the assumed
positions of the presses. At a nearby position with loads x' without memory, the loads with memory are

    y' = g x' + (y - g x),    g = sum y x / sum x²

with one gain g for each press. This is exact at the assumed positions. All other effects act on the moved contact.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from skincal.dataset import HOLD, Dataset
from skincal.effects import EffectSkin, MemoryEffect, Samples
from skincal.fitting.observe import ImagesAboveRest
from skincal.fitting.types import Floats, Ints
from skincal.model import SkinParameters
from skincal.prediction.images import images_with_effects
from skincal.prediction.places import ObservedImages, Places, Simulate, best_places
from skincal.prediction.session_samples import hold_samples, pose_names, press_order, press_times
from skincal.prediction.touches import CalibratedSkin, Touches, frame_presses, touching


@dataclass(frozen=True, eq=False)
class HoldModel:
    """Hold images at moved positions.

    Attributes:
        touches: H presses at their measured positions, in the order of time.
        samples: H samples in the middle of their holds.
        skin: skin without its effects with memory.
        gain: (H, 1) gain that memory gives the loads.
        left_n: (H, J) loads that memory adds [N].
        level_counts: (J,) mean level of untouched taxels, which is subtracted [counts].
    """

    touches: Touches
    samples: Samples
    skin: EffectSkin
    gain: Floats
    left_n: Floats
    level_counts: Floats

    @classmethod
    def of(cls, on: CalibratedSkin, dataset: Dataset, rows: Ints, slack_m: Floats | None = None) -> HoldModel:
        """Return the model of some presses.

        Args:
            on: the skin.
            dataset: the presses.
            rows: (H,) rows of presses in the order of time.
            slack_m: (P, 2) slacks at which memory is evaluated [m]; None: at the measured positions.
        """
        touches = Touches.of_presses(on, dataset).select(rows)
        samples = _middles(touches, dataset, rows)
        skin = replace(on.full, effects=tuple(e for e in on.full.effects if not e.effect.has_memory))
        gain, left = _memory(on, dataset, slack_m)
        return cls(touches, samples, skin, gain[rows], left[rows], _level(skin, samples))

    def values(self, slack_m: Floats, press: Ints) -> Floats:
        """Return the values (n, J) above the level at rest [counts] of presses (n,) at slacks (n, 2) [m]."""
        order = np.argsort(press, kind="stable")
        rows = press[order]
        contacts = self.touches.select(rows).moved(slack_m[order]).contacts()
        contacted = self.skin.contact(replace(self.samples[rows], contacts=contacts))
        loads = self.skin.loads(contacted) * self.gain[rows] + self.left_n[rows]
        out = np.empty_like(loads)
        out[order] = self.skin.after(loads, contacted.samples, {}) - self.level_counts
        return out


def rest_level(on: CalibratedSkin, dataset: Dataset) -> Floats:
    """Return the mean level of untouched taxels over the session (J,) [counts], with effects, within the range."""
    rows = order_by_time(dataset, np.arange(len(dataset.presses)))
    return _level(on.full, _middles(Touches.of_presses(on, dataset).select(rows), dataset, rows))


def idle_memory_residual(on: CalibratedSkin, dataset: Dataset) -> Floats:
    """Return the mean contribution of memory to the idle frames of a session (J,) [counts]."""
    frames = dataset.frames
    if frames is None or not on.full.has_memory or touching(dataset).all():
        return np.zeros(on.skin.patch.layout.taxels)
    still = replace(on.full, effects=tuple(e for e in on.full.effects if not e.effect.has_memory))
    (_, after), (_, before) = images_with_effects(on, dataset, None, ends=(on.full, still))
    assert after is not None and before is not None
    return np.nanmean((after - before)[~touching(dataset)], axis=0)


def _level(skin: EffectSkin, samples: Samples) -> Floats:
    """Return the mean values of untouched taxels over samples (J,) [counts]."""
    if not len(samples):
        return np.zeros(skin.skin.patch.layout.taxels)
    untouched = np.zeros(len(samples), dtype=np.bool_)
    level = skin.values(replace(samples, touching=untouched)).mean(axis=0)
    # The converter clips a level below its range.
    return level if skin.skin.converter.value_min is None else np.maximum(level, 0.0)


def order_by_time(dataset: Dataset, rows: Ints) -> Ints:
    """Return the rows of presses in the order of time."""
    rank = np.empty(len(dataset.presses), dtype=np.intp)
    middle = _middle_times(dataset)
    order = press_order(dataset) if middle is None else np.argsort(middle, kind="stable")
    rank[order] = np.arange(len(rank))
    return rows[np.argsort(rank[rows], kind="stable")]


def _middles(touches: Touches, dataset: Dataset, rows: Ints) -> Samples:
    """Return one sample per press (H,) in the middle of its hold."""
    middle = _middle_times(dataset)
    more: dict[str, Any] = {} if middle is None else {"time_s": middle[rows], "phase": HOLD}
    contacts, indenters = touches.contacts(), touches.indenters()
    samples = hold_samples(contacts, indenters, dataset, rows, pose_names(dataset), **more)
    if middle is None:
        return samples
    given, clock = press_times(dataset)
    frames = dataset.frames
    start = frames.time_s[0] if frames is not None else given[0].min() if clock else middle.min()
    return replace(samples, start_s=float(start))


def _middle_times(dataset: Dataset) -> Floats | None:
    """Return the middle of the hold of each press (P,) [s]; None without a clock."""
    given, clock = press_times(dataset)
    frames = dataset.frames
    if frames is None:
        return (given[1] + given[2]) / 2 if clock else None
    owner = np.where(touching(dataset), frame_presses(dataset), -1)
    middle = np.full(len(dataset.presses), np.nan)
    for wanted in (owner >= 0, (owner >= 0) & (frames.phase == HOLD)):
        number = np.bincount(owner[wanted], minlength=len(middle))
        total = np.bincount(owner[wanted], frames.time_s[wanted], len(middle))
        middle[number > 0] = total[number > 0] / number[number > 0]
    if clock:
        middle = np.where(np.isfinite(middle), middle, (given[1] + given[2]) / 2)
    # Place a press without frames and times in the middle of the session.
    return np.where(np.isfinite(middle), middle, np.median(frames.time_s))


def _memory(on: CalibratedSkin, dataset: Dataset, slack_m: Floats | None) -> tuple[Floats, Floats]:
    """Return the gain (P, 1) that memory gives the loads of each hold, and the loads that it adds (P, J) [N]."""
    count, taxels = len(dataset.presses), on.skin.patch.layout.taxels
    if not on.full.has_memory:
        return np.ones((count, 1)), np.zeros((count, taxels))
    parameters = SkinParameters(on.skin.parameters.elasticity_pa_per_m, 1.0)
    unit = replace(on.full, skin=replace(on.full.skin, parameters=parameters))
    remembering = replace(unit, effects=tuple(e for e in unit.effects if isinstance(e.effect, MemoryEffect)))
    ends = (remembering, replace(unit, effects=()))
    y, x = (np.nan_to_num(held) for held, _ in images_with_effects(on, dataset, slack_m, ends=ends))
    power = (x**2).sum(axis=1, keepdims=True)
    some = power > 0
    gain = np.where(some, (y * x).sum(axis=1, keepdims=True) / np.where(some, power, 1.0), 1.0)
    return gain, y - gain * x


def best_slack(
    on: CalibratedSkin, dataset: Dataset, seen: ImagesAboveRest, progress: Callable[[int, int], None]
) -> Floats:
    """Return the best slack of the presses (P, 2) [m]; it is 0 for a press of unknown position or without force."""
    progress(0, 1)
    known = np.isfinite(dataset.presses.position_m).all(axis=1) & (dataset.presses.force_n > 0)
    free = np.flatnonzero(known)
    slack = np.zeros((len(known), 2))
    if on.has_effects:
        free = order_by_time(dataset, free)
        found = _estimate_positions(HoldModel.of(on, dataset, free).values, on, dataset, seen, free)
        slack[free] = found.slack_m
        if on.full.has_memory:
            # Repeat with memory evaluated at the estimated positions, where it differs slightly.
            again = HoldModel.of(on, dataset, free, slack)
            slack[free] = _estimate_positions(again.values, on, dataset, seen, free, found).slack_m
    else:
        slack[free] = place_presses(on, dataset, seen, free).slack_m
    progress(1, 1)
    return slack


def place_presses(on: CalibratedSkin, dataset: Dataset, seen: ImagesAboveRest, rows: Ints) -> Places:
    """Estimate the positions of the presses ``rows`` (n,) of known position, on a skin without effects."""
    measured = Touches.of_presses(on, dataset).select(rows)

    def simulate(slack_m: Floats, press: Ints) -> Floats:
        return measured.select(press).moved(slack_m).values()

    return _estimate_positions(simulate, on, dataset, seen, rows)


def _estimate_positions(
    simulate: Simulate,
    on: CalibratedSkin,
    dataset: Dataset,
    seen: ImagesAboveRest,
    free: Ints,
    start: Places | None = None,
) -> Places:
    """Estimate the positions of the presses ``free`` (n,), from ``start`` if given."""
    read = np.isfinite(seen.values[free])
    scatter = seen.rest_sigma_counts if np.isfinite(seen.rest_sigma_counts) else 0.0
    values, weight = np.where(read, seen.values[free], 0.0), np.where(read, seen.slope[free], 0.0)
    lit = read & (values > max(4 * scatter, 0.5))
    images = ObservedImages(values, weight, seen.saturated[free] & read, lit, max(scatter, 0.05))
    spec = dataset.meta.position
    bound = spec.slack_m if np.isfinite(spec.slack_m) else _patch_size_m(on)
    return best_places(simulate, images, spec.sigma_m, bound, start)


def _patch_size_m(on: CalibratedSkin) -> float:
    """Return half of the patch's longer side, the bound of an unlimited slack: a press lies on the patch [m]."""
    low, high = on.skin.patch.layout.bounds_m
    return float((high - low).max()) / 2
