"""Whether a calibration's own pose, E and S are those of a session that it was not fitted to."""

from __future__ import annotations

import numpy as np

from skincal.calibration import Calibration, Finding
from skincal.dataset import Dataset
from skincal.diagnose.newcal import parameters_of
from skincal.diagnose.prepare import Prepared
from skincal.errors import InputError, Problem
from skincal.gap.hypothesis import Hypothesis
from skincal.gap.problem import cost_of_presses
from skincal.gap.reading import Reading
from skincal.gap.relocate import at_best
from skincal.gap.robust import SURE
from skincal.model.arrays import BoolArray

_MORE = 0.5
"""What a calibration's own numbers cost beyond what numbers fitted to the session do is told from this on, in units of
the noise of a value."""
_FAR_MORE = 5.0
"""From here on it is refused."""
_CHANGED, _FAR_CHANGED = 0.05, 0.3
"""In a chamber hardly any noise is left, and gains change with the day: scales that differ by less than that, relative,
are not told. From the second on it is quite another sensor."""
_NOTHING, _CUT = 1e-300, 3.0
_IN_WORDS = {
    "y_m": ("y", 1e3, "mm"),
    "x_m": ("x", 1e3, "mm"),
    "beta_deg": ("beta", 1.0, "°"),
    "alpha_deg": ("alpha", 1.0, "°"),
}
_FIX = (
    "It may be of another sensor of the same make, or sensor, skin or rig have changed since. Fit this session "
    "(skincal fit) and diagnose it with that calibration; where nothing is named the new one keeps the old numbers."
)


def numbers_differ(
    calibration: Calibration,
    dataset: Dataset,
    ready: Prepared,
    found: Hypothesis,
    reading: Reading,
    known: BoolArray,
) -> tuple[Finding, ...]:
    """A finding where a session asks for another pose, E and S than a calibration that was fitted to another one has.

    Far more than what may have changed since is refused.

    Args:
        calibration: that was given.
        dataset: the session.
        ready: the session as it is looked at.
        found: fitted to it with all that was named, every press at its best place.
        reading: what is believed of what was read.
        known: (N,) what may be looked at.

    Raises:
        InputError: the calibration's numbers are those of quite another sensor.
    """
    if _of_this(calibration, dataset):
        return ()
    # What was named is not the calibration's to say.
    start = ready.start.with_effects(found.effects)
    held = at_best(start, ready.session, reading, ready.options)
    presses = np.unique(ready.session.press[known & (ready.session.press >= 0)])
    values = int(reading.seen[np.isin(ready.session.press, presses)].sum())
    # Places and forces make up for a wrong sensor as far as they may, at a cost.
    own, again = (
        np.nansum(
            cost_of_presses(
                one, np.nan_to_num(reading.residual(one.values(ready.session))), ready.session, ready.options
            )[presses]
        )
        / max(values, 1)
        for one in (held, found)
    )
    more = float(np.sqrt(max(own - again, 0.0)))
    if more < _MORE:
        return ()
    old, new = calibration.model.best(), parameters_of(calibration, found).best()
    moved = [
        f"{word} {factor * (new[name] - old[name]):+.2f} {unit}"
        for name, (word, factor, unit) in _IN_WORDS.items()
        if name in new
    ]
    grown = [
        f"{word} {100 * (new[name] / old[name] - 1):+.0f} %"
        for word, name in (("E", "elasticity_pa_per_m"), ("S", "scale_per_n"))
    ]
    text = (
        f"the calibration was fitted to another session; in this one its pose, E and S are off by {more:.1f} times the "
        f"noise more than fitted ones ({', '.join([*moved, *grown])})"
    )
    return _told(calibration, more, text)


def scales_differ(
    calibration: Calibration,
    dataset: Dataset,
    ready: Prepared,
    reading: Reading,
    rows: BoolArray,
) -> tuple[Finding, ...]:
    """The same for uniform pressure, which tells the scale of each taxel and nothing else.

    What a taxel reads at the measured forces is a line over what the calibration says, if a level at rest is free: its
    slope is the ratio of the scales. What was found has no part in it: a wrong scale looks like an effect, too.

    Args:
        calibration: that was given.
        dataset: the session.
        ready: the session as it is looked at.
        reading: what is believed of what was read.
        rows: (N,) what may be looked at.

    Raises:
        InputError: the calibration's scales are those of quite another sensor.
    """
    if _of_this(calibration, dataset):
        return ()
    bare = ready.start.with_effects({}).values(ready.session)
    whole = ready.start.values(ready.session)
    inside = rows[:, None] & reading.seen
    if reading.readout.value_max is not None:
        # What a converter cut off at the top says nothing of a scale.
        inside &= np.nan_to_num(reading.counts) < reading.readout.value_max - _CUT * (
            reading.sigma_counts + 0.5
        )
    weight = np.where(inside, np.nan_to_num(reading.weight(whole)), 0.0) ** 2
    total = np.maximum(weight.sum(axis=0), _NOTHING)
    off = np.where(weight > 0, np.nan_to_num(reading.unlifted - whole), 0.0)
    said, off = (v - (weight * v).sum(axis=0) / total for v in (np.nan_to_num(bare), off))
    pull, curve = (weight * said * off).sum(axis=0), (weight * said**2).sum(axis=0)
    lit = curve > SURE
    if not lit.any():
        return ()
    values = int((weight[:, lit] > 0).sum())
    more = float(np.sqrt((pull[lit] ** 2 / curve[lit]).sum() / max(values, 1)))
    change = float(np.median(np.abs(pull[lit] / curve[lit])))
    if more < _MORE or change < _CHANGED:
        return ()
    text = (
        f"the calibration was fitted to another session; in this one its taxels' scales are off by {more:.1f} times "
        f"the noise, half of them by more than {100 * change:.0f} %"
    )
    return _told(calibration, more if change > _FAR_CHANGED else _MORE, text)


def _of_this(calibration: Calibration, dataset: Dataset) -> bool:
    """Whether a calibration was fitted to a session."""
    return dataset.sha256 is not None and calibration.provenance.dataset_sha256 == dataset.sha256


def _told(calibration: Calibration, more: float, text: str) -> tuple[Finding, ...]:
    """A finding, if numbers are off by so much of the noise.

    Raises:
        InputError: they are off by far more.
    """
    if more > _FAR_MORE:
        place = "the calibration" if calibration.folder is None else str(calibration.folder)
        fix = "Fit this session (skincal fit), and diagnose it with that calibration."
        raise InputError([Problem(place, "a calibration of the sensor that was pressed", text, fix)])
    return (Finding("other_calibration", "warning", text, _FIX),)
