"""From which side an effect shows: for each effect the picture in which a person sees it."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from types import MappingProxyType
from typing import Final, Literal

import numpy as np

from skincal.effects.samples import HOLD, LOAD, UNLOAD
from skincal.model.arrays import FloatArray, IntArray
from skincal.report.diagnosis_left import FEWEST, Left, Part

Kind = Literal["curve", "thin", "categories", "taxels", "moves"]

PERCENT = "measured − simulated\n[% of the simulated value]"
BRIGHTEST = "measured − simulated\n[% of the brightest taxel]"
AFTER = "measured − simulated\n[% of the taxel's largest value]"
COUNTS = "measured − simulated\n[counts]"

LEAST: Mapping[str, float] = MappingProxyType({PERCENT: 2.0, BRIGHTEST: 0.5, AFTER: 1.0, COUNTS: 0.3})
"""So far up and down an axis reaches at least, in its unit: what is flat is to look flat."""

_PHASES = ((LOAD, "loading"), (HOLD, "hold"), (UNLOAD, "unloading"))
_BRIGHT_COUNTS = 10.0
RINGS = ("the brightest itself", "next to it", "diagonal", "further in its\nrow or column", "elsewhere")


@dataclass(frozen=True)
class Trace:
    """A picture.

    Attributes:
        name: of the view.
        title: what is looked at.
        x_label: of the axis.
        y_label: of the axis, or of the colours of a map.
        parts: its lines; none where the data do not have what it needs.
        kind: curves with errors, thin lines without, one place for each category, a map, or shifts of presses.
        factor: from what is computed to what is shown.
        bins: along x.
        log: whether x is on a logarithmic scale.
    """

    name: str
    title: str
    x_label: str
    y_label: str
    parts: Callable[[Left], tuple[Part, ...]]
    kind: Kind = "curve"
    factor: float = 1.0
    bins: int = 8
    log: bool = False


def _gain(x: FloatArray, left: Left, label: str = "all presses") -> Part:
    """By how many parts of the simulated value the measured one is larger, while something presses."""
    return Part(label, x[:, None], left.values, left.touching)


def _in_phases(x: FloatArray, left: Left) -> tuple[Part, ...]:
    phase = left.session.phase
    return tuple(
        Part(word, x[:, None], left.values, left.touching & (phase == number)[:, None])
        for number, word in _PHASES
        if (phase == number).any()
    )


def _loop(left: Left) -> tuple[Part, ...]:
    return _in_phases(left.covariates.force_n, left)


def _hold(left: Left) -> tuple[Part, ...]:
    held = (left.session.phase == HOLD)[:, None]
    since = np.maximum(left.covariates.since_hold_s, 0.02)
    return (Part("hold", since[:, None], left.values, left.touching & held),)


def _speed(left: Left) -> tuple[Part, ...]:
    return _in_phases(1e3 * left.covariates.speed_m_per_s, left)


def _change(left: Left) -> tuple[Part, ...]:
    """The level against how fast the value changes, within a press."""
    v, time, press = left.values, left.covariates.time_s, left.session.press
    speed = np.full(v.shape, np.nan)
    same = (np.diff(press) == 0) & (press[1:] >= 0) & (np.diff(time) > 0)
    step = np.diff(v, axis=0) / np.where(same, np.diff(time), 1.0)[:, None]
    speed[1:] = np.where(same[:, None], step, np.nan)
    bright = left.touching & (v > 0.5 * v.max(axis=1, keepdims=True))
    return (Part("taxels above half of the brightest", speed, np.ones_like(v), bright),)


def _session(left: Left) -> tuple[Part, ...]:
    return (_gain(left.covariates.time_s, left),)


def _temperature(left: Left) -> tuple[Part, ...]:
    return (_gain(left.covariates.temperature_c, left),)


def _cycle(left: Left) -> tuple[Part, ...]:
    return (_gain(left.covariates.cycle, left),)


def _rest(left: Left) -> tuple[Part, ...]:
    ones, time = np.ones((len(left.owner), 1)), left.covariates.time_s[:, None]
    columns = np.eye(left.values.shape[1], dtype=np.bool_)
    return tuple(Part(f"taxel {j}", time, ones, ~left.touching & column) for j, column in enumerate(columns))


def _after(left: Left) -> tuple[Part, ...]:
    """What is left of a press after it, in parts of the largest value that each taxel had in it."""
    time, press = left.covariates.time_s, left.session.press
    since, largest = np.full(len(press), np.nan), np.zeros_like(left.values)
    for row in np.unique(left.owner[left.owner >= 0]).tolist():
        own = np.flatnonzero(press == row)
        rest = np.flatnonzero((left.owner == row) & (press < 0))
        since[rest] = time[rest] - time[own[-1]]
        largest[rest] = left.values[own].max(axis=0)
    return (Part("at rest", since[:, None], largest, ~left.touching & (since > 0)[:, None]),)


def _level(left: Left) -> tuple[Part, ...]:
    columns = np.arange(left.values.shape[1], dtype=np.float64)[None]
    resting = ~left.touching if (~left.touching).any() else left.values < 1.0
    rested = np.unique(left.owner[np.broadcast_to(resting, left.values.shape).any(axis=1)])
    # On a staircase nothing rests between its ends: there the level is what lies under everything.
    dark = resting if len(rested) >= FEWEST else np.ones_like(resting)
    return (Part("at rest", columns, np.ones((len(left.owner), 1)), dark),)


def _taxels(left: Left) -> tuple[Part, ...]:
    columns = np.arange(left.values.shape[1], dtype=np.float64)[None]
    return (Part("touched", columns, left.values, left.touching),)


def _value(left: Left) -> tuple[Part, ...]:
    return (Part("all taxels", left.values, np.ones_like(left.values), left.touching),)


def _brightest(left: Left) -> tuple[FloatArray, IntArray]:
    """Value (N, 1) of the brightest taxel of each image, and where it is (N,)."""
    return left.values.max(axis=1, keepdims=True), left.values.argmax(axis=1)


def _rings(left: Left) -> tuple[Part, ...]:
    top, place = _brightest(left)
    row, col = np.divmod(left.taxels, left.layout.cols)
    rows, cols = np.abs(row - row[place][:, None]), np.abs(col - col[place][:, None])
    ring = np.full(left.values.shape, 4.0)
    ring[(rows == 0) | (cols == 0)] = 3
    ring[(rows == 1) & (cols == 1)] = 2
    ring[rows + cols == 1] = 1
    ring[rows + cols == 0] = 0
    return (Part("all presses", ring, top, left.touching & (top > _BRIGHT_COUNTS)),)


def _distance(left: Left) -> tuple[Part, ...]:
    top, _ = _brightest(left)
    return (Part("all presses", 1e3 * left.distances_m, top, left.touching & (top > _BRIGHT_COUNTS)),)


def _indenter(left: Left) -> tuple[Part, ...]:
    top, _ = _brightest(left)
    use, which = left.touching & (top > _BRIGHT_COUNTS), left.covariates.indenter
    names = [_indenter_name(i, k) for k, i in enumerate(left.session.samples.indenters)]
    return tuple(
        Part(name, 1e3 * left.distances_m, top, use & (which == k)[:, None]) for k, name in enumerate(names)
    )


def _indenter_name(indenter: object, number: int) -> str:
    radius = getattr(indenter, "radius_m", None)
    return f"indenter {number + 1}" if radius is None else f"indenter of {1e3 * radius:.3g} mm"


def _force(left: Left) -> tuple[Part, ...]:
    return (_gain(left.covariates.force_n, left),)


def _poses(left: Left) -> tuple[Part, ...]:
    pose, force = left.covariates.pose, left.covariates.force_n[:, None]
    numbers = np.unique(pose[np.isfinite(pose) & (pose >= 0)])
    if len(numbers) < 2:
        return (_gain(left.covariates.force_n, left),)
    return tuple(
        Part(f"hand pose {int(n) + 1}", force, left.values, left.touching & (pose == n)[:, None])
        for n in numbers
    )


def _shear(left: Left) -> tuple[Part, ...]:
    shear = left.session.samples.shear_n
    if shear is None:
        return ()
    found: list[Part] = []
    for k, word in enumerate(("across", "along")):
        own = left.session.means(np.repeat(np.nan_to_num(shear[:, k])[:, None], left.layout.taxels, axis=1))
        found.append(Part(word, own[:, :1], left.slopes[..., k], left.touching, white=True))
    return tuple(found)


def _none(_: Left) -> tuple[Part, ...]:
    return ()


_FORCE, _TIME = "force [N]", "session time [s]"

VIEWS: Final[Mapping[str, Trace]] = MappingProxyType(
    {
        v.name: v
        for v in (
            Trace("loop", "Against force, while loading and unloading", _FORCE, PERCENT, _loop, factor=100),
            Trace("hold", "In the hold", "time since the hold began [s]", PERCENT, _hold, factor=100, log=True),
            Trace("speed", "Against the speed of loading", "speed [mm/s]", PERCENT, _speed, factor=100, log=True),
            Trace("change", "Against how fast the value changes", "simulated change [counts/s]", COUNTS, _change),
            Trace("session", "Over the session", _TIME, PERCENT, _session, factor=100),
            Trace("temperature", "Against temperature", "temperature [°C]", PERCENT, _temperature, factor=100),
            Trace("cycle", "First and later touches of a site", "earlier touches", PERCENT, _cycle, factor=100),
            Trace("rest", "Level at rest, a line each taxel", _TIME, COUNTS, _rest, kind="thin", bins=10),
            Trace("after", "At rest, after each press", "time since the press ended [s]", AFTER, _after, factor=100,
                 log=True),
            Trace("level", "Level at rest, by taxel", "", COUNTS, _level, kind="taxels"),
            Trace("taxels", "Answer by taxel", "", PERCENT, _taxels, kind="taxels", factor=100),
            Trace("value", "Against the value", "simulated value [counts]", COUNTS, _value, bins=12),
            Trace("rings", "About the brightest taxel", "", BRIGHTEST, _rings, kind="categories", factor=100),
            Trace("distance", "Against the distance from the contact", "distance [mm]", BRIGHTEST, _distance,
                 factor=100, bins=10),
            Trace("indenter", "Against the distance from the contact, by indenter", "distance [mm]", BRIGHTEST,
                 _indenter, factor=100, bins=8),
            Trace("force", "Against force", _FORCE, PERCENT, _force, factor=100),
            Trace("poses", "Against force, by hand pose", _FORCE, PERCENT, _poses, factor=100),
            Trace("shear", "Shift of the image under tangential force", "tangential force [N]",
                 "measured − simulated\nplace [mm]", _shear, factor=1e3),
            Trace("moves", "By how much presses had to be moved to match", "across [mm]", "along [mm]", _none,
                 kind="moves"),
        )
    }
)  # fmt: skip

OF_EFFECT: Final[Mapping[str, str]] = MappingProxyType(
    {
        "hysteresis": "loop", "creep": "hold", "rate": "speed", "latency": "change", "first_cycle": "cycle",
        "baseline_drift": "rest", "gain_drift": "session", "spread": "distance", "crosstalk": "rings",
        "ghosting": "rings", "saturation": "value", "dead_band": "value", "response_curve": "value",
        "stiffening": "force", "taxel_gain": "taxels", "taxel_offset": "level", "dead_taxel": "taxels",
        "shear": "shear", "force_bias": "poses", "contact_offset": "moves", "indenter_radius": "indenter",
        "cover": "force",
    }
)  # fmt: skip
"""The view in which each effect shows."""
