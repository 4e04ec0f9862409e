"""Small recorded sessions for the tests of the diagnosis, made by a skin whose truth is known."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cache
from typing import Any

import numpy as np
from effects.effect_sessions import FINGER
from gap.gap_sessions import READOUT, full, static

from skincal.effects.samples import HOLD
from skincal.fit.observe import Readout
from skincal.fit.tasks import Mapper
from skincal.gap.base import BaseModel
from skincal.gap.candidates import Scene
from skincal.gap.hypothesis import PLACE, Hypothesis
from skincal.gap.models import Material, Model
from skincal.gap.problem import RefitOptions
from skincal.gap.reading import Reading
from skincal.gap.refit import refit
from skincal.gap.relocate import relocated
from skincal.gap.session import Binning, GapSession, binned
from skincal.gap.split import SELECTION, TRAIN, split_presses
from skincal.model import SensorPose, TaxelLayout

LAYOUT = TaxelLayout.grid(3, 3, taxel_size_m=0.0025, pitch_m=0.004)
MODEL = BaseModel(FINGER, LAYOUT, SensorPose(0.0235, 0.2, 0.05), 4e8, 70.0, READOUT, 0.75e-3, 4e-3)
OPEN = Readout(None, None, integer=False)
"""A converter that neither rounds nor clips."""
SIGMA = 1.0
OPTIONS = RefitOptions(position_sigma_m=1e-4, force_sigma=0.005)

Effects = Mapping[str, Mapping[str, object]]


@dataclass(frozen=True, eq=False)
class Made:
    """A session that was recorded, and what was true of it."""

    session: GapSession
    reading: Reading
    truth: Hypothesis

    @property
    def start(self) -> Hypothesis:
        """The true base model, presses where they were measured, no effects."""
        return Hypothesis(self.truth.model, np.zeros_like(self.truth.places))

    @property
    def material(self) -> Material:
        """The session, split by presses; rest goes with the press before it."""
        last = np.maximum.accumulate(self.session.press)
        assert (np.diff(self.session.press[self.session.press >= 0]) >= 0).all()
        part = split_presses(np.arange(self.session.presses), np.random.default_rng(4)).part
        own = np.where(last >= 0, part[np.maximum(last, 0)], TRAIN)
        return Material(self.session, self.reading, own == TRAIN, own == SELECTION, OPTIONS)


def arrays(effects: Effects) -> dict[str, dict[str, np.ndarray]]:
    """Parameters of effects as arrays."""
    return {
        name: {key: np.asarray(value, dtype=float) for key, value in own.items()}
        for name, own in effects.items()
    }


@cache
def pressed(presses: int = 24, seed: int = 3) -> GapSession:
    """Loading, hold, unloading and rest of presses, with all covariates; nothing was read yet."""
    session = full(presses, seed)
    few = binned(session.samples, session.row, None, FINGER, Binning(4, 3, 4, 1))
    return replace(few, frames=np.where(few.phase == HOLD, 6.0, 2.0))


@cache
def held(presses: int = 30, seed: int = 5) -> GapSession:
    """Hold means of static presses without covariates."""
    session = static(presses, seed)
    return replace(session, frames=np.full(len(session), 20.0))


def read(session: GapSession, values: np.ndarray, rng: np.random.Generator, readout: Readout) -> np.ndarray:
    """Means of noisy, rounded and clipped frames at values (N, J)."""
    counts = np.zeros_like(values)
    for number in np.unique(session.frames):
        own = session.frames == number
        frames = values[own] + SIGMA * rng.standard_normal((int(number), int(own.sum()), values.shape[1]))
        frames = np.round(frames) if readout.integer else frames
        counts[own] = np.clip(frames, readout.value_min, readout.value_max).mean(axis=0)
    return counts


def made(
    effects: Effects | None = None,
    session: GapSession | None = None,
    *,
    seed: int = 1,
    model: BaseModel = MODEL,
    exact: bool = False,
) -> Made:
    """A session that a skin with effects recorded, presses off by what their priors allow.

    Args:
        effects: that are true.
        session: what is pressed.
        seed: of places, forces and noise.
        model: that is true.
        exact: presses are where they are measured.
    """
    session, rng = pressed() if session is None else session, np.random.default_rng(seed)
    places = rng.standard_normal((session.presses, PLACE)) * OPTIONS.place_prior
    truth = Hypothesis(model, np.zeros_like(places) if exact else places, arrays(effects or {}))
    session = replace(session, counts=read(session, truth.values(session), rng, model.readout))
    return Made(session, Reading.of(session, SIGMA, model.readout), truth)


def based(one: Made) -> Model:
    """The base model, fitted to what learns and chooses, with a second look at where presses were."""
    known = one.material.known
    found = refit(one.start, one.session, one.reading, OPTIONS, learn=known)
    placed = relocated(found.hypothesis, one.session, one.reading, OPTIONS)
    if placed is not found.hypothesis:
        again = replace(OPTIONS, settle=0, steps=4)
        found = refit(placed, one.session, one.reading, again, learn=known)
    return Model(found)


def scene_of(one: Made, model: Model) -> Scene:
    """The scene about a fit."""
    return Scene.of(model.hypothesis, model.refit.slopes, one.session, one.reading, OPTIONS)


CASES: Mapping[str, Effects] = {
    "none": {},
    "hysteresis": {"hysteresis": {"height": 0.3, "width": 3.0}},
    "crosstalk": {"crosstalk": {"leak": 0.05}},
    "contact_offset": {
        "contact_offset": {"stretch_across": 0.08, "stretch_along": -0.08, "pose_along_m": [3e-4, -3e-4]}
    },
    "taxel_gain": {"taxel_gain": {"gain": [1.1, 0.9, 1.0, 1.15, 1.0, 0.85, 0.95, 1.05, 1.1]}},
}
"""Sessions that several files of tests look at."""


@dataclass(frozen=True, eq=False)
class Case:
    """A session, its base model fitted, and the scene about it."""

    made: Made
    model: Model
    scene: Scene


@cache
def case(name: str) -> Case:
    """A case by its name, worked out once."""
    one = made(CASES[name])
    model = based(one)
    return Case(one, model, scene_of(one, model))


def counted(spread: Mapper, sent: list[int]) -> Mapper:
    """A mapper that notes how many pieces it was given each time."""

    def noting(function: Callable[[Any], Any], arguments: Sequence[Any], /) -> Iterable[Any]:
        sent.append(len(arguments))
        return spread(function, arguments)

    return noting
