"""Figures of the influence of each effect on a press: the model with and without it, where it is most visible."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import cache, partial
from types import MappingProxyType
from typing import Final

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from numpy.typing import ArrayLike

from skincal.covariates import COVARIATES
from skincal.effects import EffectSkin, Samples, effect
from skincal.effects.samples import HOLD, IDLE, LOAD, UNLOAD
from skincal.model import Contacts, Cylinder, Patch, SensorPose, Skin, SkinParameters, Sphere, TaxelLayout
from skincal.model.arrays import FloatArray
from skincal.report.style import BLACK, BLUE, DIVERGING, GREY, ORANGE, new_figure, styled

FEW = 16
"""Most values that are drawn as bars."""

STRENGTH = 2.0
"""Strength of the effect in a figure: twice a typical case."""

_FORCE_N, _SEED = 3.0, 3
_CENTRE_M, _RADIUS_M = 0.0235, 0.0115
_PLACE_M = (0.6e-3, 1.0e-3)
"""Position of presses relative to the middle of the patch: between taxels, so that several feel them [m]."""


@dataclass(frozen=True, eq=False)
class Curve:
    """A line of a figure: values (n,) over x (n,), without and with the effect."""

    label: str
    x: FloatArray
    base: FloatArray
    changed: FloatArray


@dataclass(frozen=True, eq=False)
class Signature:
    """The influence of an effect.

    Attributes:
        name: name of the effect.
        x_label: label of the x axis.
        y_label: label of the y axis.
        curves: curves that show it best.
        change: (rows, cols) change of the image where it is largest [counts].
        place_m: (2,) position of that press on the patch [m]; NaN without contact.
    """

    name: str
    x_label: str
    y_label: str
    curves: tuple[Curve, ...]
    change: FloatArray
    place_m: FloatArray


Lines = tuple[tuple[str, int, slice], ...]
"""Label, taxel and rows of each curve."""


@dataclass(frozen=True, eq=False)
class _View:
    """Samples of some presses, drawn over x as the curves of some taxels; no curves: each press by its own taxel."""

    samples: Samples
    x: FloatArray
    x_label: str
    curves: Lines
    y_label: str = "strongest taxel [counts]"
    place_m: FloatArray | None = None


@cache
def _base() -> EffectSkin:
    surface, layout = Cylinder(_RADIUS_M), TaxelLayout.grid(4, 4, taxel_size_m=2.5e-3, pitch_m=4e-3)
    patch = Patch.build(surface, layout, SensorPose(_CENTRE_M, 0.0), resolution_m=0.4e-3)
    return EffectSkin(Skin(patch, SkinParameters(2.5e8, 70.0)), surface)


def signature(name: str, strength: float = STRENGTH) -> Signature:
    """Return the influence of an effect on a sensor of 4 by 4 taxels on a fingertip.

    Args:
        name: name of the effect.
        strength: 1 is a typical case.

    Raises:
        InputError: there is no such effect.
    """
    one = effect(name)
    usual = partial(_over_time, 0.4, 4.0, 3.0) if one.has_memory else _forces
    view = _VIEWS.get(one.shows, usual)()
    base = _base()
    given = one.at_strength(strength, np.random.default_rng(_SEED), base.skin.patch.layout)
    values, changed = base.values(view.samples), base.with_effects({name: given}).values(view.samples)
    change = changed - values
    if not view.curves:
        image, place = np.diag(change), np.full(2, np.nan)
        curves = (Curve("with it", view.x, np.diag(values), np.diag(changed)),)
    else:
        largest = int(np.argmax((change**2).sum(axis=1)))
        image = change[largest]
        place = _here(len(change)) if view.place_m is None else view.place_m
        place = place[largest] if view.samples.touching[largest] else np.full(2, np.nan)
        curves = tuple(
            Curve(label, view.x[rows], values[rows, taxel], changed[rows, taxel])
            for label, taxel, rows in view.curves
        )
    return Signature(name, view.x_label, view.y_label, curves, image.reshape(4, 4), place)


@styled
def signature_figure(name: str, strength: float = STRENGTH) -> Figure:
    """Return the figure of an effect: curves without and with it, and a map of the largest change.

    Args:
        name: name of the effect.
        strength: 1 is a typical case.

    Raises:
        InputError: there is no such effect.
    """
    found = signature(name, strength)
    figure = new_figure(7.6, 2.6)
    left, right = figure.subplots(1, 2, width_ratios=(1.7, 1.0))
    _draw_curves(left, found)
    _draw_change(figure, right, found)
    return figure


def _draw_curves(axes: Axes, found: Signature) -> None:
    bars = len(found.curves[0].x) <= FEW
    for curve, colour, dashes in zip(found.curves, (BLUE, ORANGE), ("--", ":"), strict=False):
        if bars:
            axes.bar(curve.x, curve.changed, color=colour, width=0.7, label=curve.label)
            axes.plot(curve.x, curve.base, "_", color=BLACK, ms=11, mew=1.4, label="without it")
        else:
            axes.plot(curve.x, curve.changed, color=colour, lw=1.6, label=curve.label)
            axes.plot(curve.x, curve.base, color=GREY, lw=1.2, ls=dashes)
    if bars:
        axes.margins(y=0.3)
        axes.set_ylim(bottom=0.0)
    else:
        axes.plot([], [], color=GREY, lw=1.2, ls="--", label="without it")
    axes.set_xlabel(found.x_label)
    axes.set_ylabel(found.y_label)
    axes.legend(loc="upper right" if bars else "best", ncols=2 if bars else 1)


def _draw_change(figure: Figure, axes: Axes, found: Signature) -> None:
    most = max(float(np.abs(found.change).max()), 1e-9)
    half = 8.0
    shown = axes.imshow(
        found.change, origin="lower", cmap=DIVERGING, vmin=-most, vmax=most, extent=(-half, half, -half, half)
    )
    if np.isfinite(found.place_m).all():
        for colour, width in (("white", 3.0), (BLACK, 1.2)):
            axes.plot(*(1e3 * found.place_m), "+", color=colour, ms=9, mew=width)
    axes.set_xticks([])
    axes.set_yticks([])
    axes.set_title("largest change [counts]", fontweight="normal", fontsize=9)
    figure.colorbar(shown, ax=axes, shrink=0.85)


def _samples(place_m: FloatArray, force_n: FloatArray, **covariates: ArrayLike) -> Samples:
    """Return presses at positions (K, 2) across and along from the middle of the patch, with all covariates."""
    surface = Cylinder(_RADIUS_M)
    start = np.tile([0.0, _CENTRE_M, _RADIUS_M], (len(place_m), 1))
    points = surface.offset(start, place_m[:, 0], place_m[:, 1])
    usual: dict[str, ArrayLike] = {
        name: value
        for one in COVARIATES.values()
        for name, value in zip(one.columns or (one.attribute,), one.typical, strict=False)
    }
    contacts = Contacts(points, surface.normal_at(points), force_n)
    return Samples.of(contacts, Sphere(0.006), touching=force_n > 0, **(usual | covariates))


def _here(count: int) -> FloatArray:
    return np.tile(_PLACE_M, (count, 1))


def _strongest() -> tuple[int, int]:
    """Return the taxel that feels the press most, and the next one."""
    image = _base().values(_samples(_here(1), np.array([_FORCE_N])))[0]
    order = np.argsort(-image)
    return int(order[0]), int(order[1])


def _lines(*labels: str, rows: int | None = None) -> Lines:
    """Return curves of the strongest taxels, or of the strongest one in one part of the samples after another."""
    if rows is None:
        return tuple((label, taxel, slice(None)) for label, taxel in zip(labels, _strongest(), strict=False))
    return tuple((label, _strongest()[0], slice(i * rows, (i + 1) * rows)) for i, label in enumerate(labels))


def _press(load_s: float, hold_s: float, rest_s: float) -> Samples:
    """Return one press at 100 Hz: a fifth of a second of rest, load, hold, unload, rest."""
    step, before = 0.01, 20
    load, hold, rest = (round(length / step) for length in (load_s, hold_s, rest_s))
    rise = np.arange(1, load + 1) / load
    share = np.concatenate([np.zeros(before), rise, np.ones(hold), 1 - rise, np.zeros(rest)])
    phase = np.repeat([IDLE, LOAD, HOLD, UNLOAD, IDLE], [before, load, hold, load, rest])
    time = step * np.arange(1, len(share) + 1)
    return _samples(_here(len(share)), _FORCE_N * share, time_s=time, phase=phase, press=0)


def _over_time(*times_s: float) -> _View:
    """Return one press over time."""
    samples = _press(*times_s)
    assert samples.time_s is not None
    return _View(samples, samples.time_s, "time [s]", _lines("with it"))


def _loop() -> _View:
    """Return one slow press over its force."""
    samples = _press(1.5, 0.3, 0.2)
    return _View(samples, samples.contacts.force_n, "force [N]", _lines("with it"))


def _speeds() -> _View:
    """Return the loading at two speeds, over the force."""
    force, speed = np.tile(np.linspace(0.05, _FORCE_N, 60), 2), np.repeat([2.5e-4, 4e-3], 60)
    time = np.concatenate([np.linspace(0, 4, 60), np.linspace(10, 10.25, 60)])
    press = np.repeat([0, 1], 60)
    samples = _samples(_here(120), force, time_s=time, phase=LOAD, speed_m_per_s=speed, press=press)
    return _View(samples, force, "force [N], loading", _lines("0.25 mm/s", "4 mm/s", rows=60))


def _forces() -> _View:
    """Return holds at several forces: the strongest taxel and the next one."""
    force = np.linspace(0.0, 5.0, 51)
    lines = _lines("strongest taxel", "the next one")
    return _View(_samples(_here(51), force), force, "force [N]", lines, "value [counts]")


def _poses() -> _View:
    """Return holds at several forces in two hand poses."""
    force = np.tile(np.linspace(0.01, 4.0, 41), 2)
    samples = _samples(_here(82), force, pose=np.repeat([0, 1], 41))
    return _View(samples, force, "force [N]", _lines("in one pose", "in another", rows=41))


def _session(touching: bool) -> _View:
    """Return the same press, or the untouched skin, over ten minutes."""
    time, force = np.linspace(0.0, 600.0, 31), np.full(31, _FORCE_N if touching else 0.0)
    samples = _samples(_here(31), force, time_s=time, phase=HOLD if touching else IDLE)
    lines = _lines("with it") if touching else _lines("one taxel", "another")
    label = "the same press [counts]" if touching else "untouched [counts]"
    return _View(samples, time, "time of the session [s]", lines, label)


def _touches() -> _View:
    """Return the same press again and again."""
    cycle = np.arange(7.0)
    samples = _samples(_here(7), np.full(7, _FORCE_N), cycle=cycle)
    return _View(samples, cycle, "earlier touches of the site", _lines("with it"), "the same press [counts]")


def _places() -> _View:
    """Return a press that moves across the patch, as one taxel sees it."""
    across = np.linspace(-8e-3, 8e-3, 81)
    place = np.column_stack([across, np.full(81, _PLACE_M[1])])
    samples = _samples(place, np.full(81, _FORCE_N))
    label = "place of the press, across [mm]"
    return _View(samples, 1e3 * across, label, _lines("with it"), "one taxel [counts]", place)


def _taxels() -> _View:
    """Return a press on each taxel, as that taxel sees it."""
    place = _base().skin.patch.layout.centres_m
    samples, x = _samples(place, np.full(len(place), _FORCE_N)), np.arange(float(len(place)))
    return _View(samples, x, "taxel, pressed at its centre", (), "that taxel [counts]", place)


_VIEWS: Final[Mapping[str, Callable[[], _View]]] = MappingProxyType(
    {
        "poses": _poses,
        "places": _places,
        "speeds": _speeds,
        "loop": _loop,
        "quick": partial(_over_time, 0.3, 0.4, 0.3),
        "touches": _touches,
        "taxels": _taxels,
        "session": partial(_session, touching=True),
        "rests": partial(_session, touching=False),
    }
)
"""Presses by what effects say shows them best (:attr:`skincal.effects.Effect.shows`)."""
