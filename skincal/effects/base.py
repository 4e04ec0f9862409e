"""What an effect is: a small object at one stage of the chain from the contact to the counts."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping
from enum import IntEnum
from typing import Any, ClassVar

import numpy as np
from numpy.typing import ArrayLike

from skincal.effects.parameter import EffectParameter, Values, checked
from skincal.effects.samples import Samples
from skincal.effects.setting import Setting
from skincal.effects.starts import Scene, Start
from skincal.errors import InputError, Problem
from skincal.model import Patch, StressLaw, TaxelLayout
from skincal.model.arrays import FloatArray

State = Any
"""What an effect with memory keeps from one sample to the next; None before the first."""


class Stage(IntEnum):
    """Where in the chain an effect stands."""

    POSE_AND_FORCE = 0
    """Changes what presses where and how hard, before there is a contact."""
    CONTACT = 1
    """Changes how stress follows from penetration."""
    SPREAD = 2
    """Changes which tactile points a taxel feels."""
    MEMORY = 3
    """Makes loads [N] depend on earlier ones."""
    TRANSFER = 4
    """Changes loads [N] at once, each taxel by itself, before the scale turns them into counts."""
    CROSSTALK = 5
    """Mixes the values of taxels [counts]."""
    CONVERTER = 6
    """Changes values [counts], each taxel by itself, before they are rounded and clipped."""


class Effect(ABC):
    """What a skin does beyond the base model.

    Add one with a file beside this one and a line in the registry, or from another package through the entry point
    group ``skincal.effects``.

    An effect has no state of its own: its parameters, and what it remembers, are handed in. With all strengths at
    their neutral values it is left out, so the model is exactly the one without it.

    Attributes:
        name: as in the list of names of effects.
        stage: where in the chain it stands.
        meaning: one sentence.
        parameters: that it has.
        covariates: that it needs whenever it is not neutral; parameters may need more.
        asks: kinds of presses without which it hardly shows, by their names in :mod:`skincal.diagnosis.reasons`.
        single_taxels: whether it is a fault of some taxels, each for itself.
        in_places: whether it lives in the measured places of presses, so that images hardly show it.
        has_memory: whether it depends on earlier samples.
        of_rig: whether it is an error of what was measured and no property of the skin: where the true place and force
            are known, as in an environment, it has no place.
        shows: presses that show it best in a picture, by their names in :mod:`skincal.report.signatures`; empty: over
            force, or over time if it has memory.
        replaces_range: the range of a preset that holds what is assumed where this effect is not known.
        source: where its equation comes from.
    """

    name: ClassVar[str]
    stage: ClassVar[Stage]
    meaning: ClassVar[str]
    parameters: ClassVar[tuple[EffectParameter, ...]]
    covariates: ClassVar[tuple[str, ...]] = ()
    asks: ClassVar[tuple[str, ...]] = ()
    single_taxels: ClassVar[bool] = False
    in_places: ClassVar[bool] = False
    has_memory: ClassVar[bool] = False
    of_rig: ClassVar[bool] = False
    shows: ClassVar[str] = ""
    replaces_range: ClassVar[str] = ""
    source: ClassVar[str]

    def checked(self, given: Mapping[str, ArrayLike], taxels: int) -> Values:
        """All parameters: those given, neutral or default where not.

        Raises:
            InputError: parameters that the effect does not have, and values that they cannot have.
        """
        return checked(self.name, self.parameters, given, taxels)

    def is_neutral(self, values: Values) -> bool:
        """Whether the effect is not there."""
        return not any(self._differs(parameter, values) for parameter in self.parameters)

    def needs(self, values: Values) -> tuple[str, ...]:
        """Covariates that the effect needs at these values, none of them twice."""
        more = [n for p in self.parameters if self._differs(p, values) for n in p.needs]
        return () if self.is_neutral(values) else tuple(dict.fromkeys([*self.covariates, *more]))

    @property
    def all_covariates(self) -> tuple[str, ...]:
        """Covariates that the effect needs at some values."""
        return tuple(dict.fromkeys([*self.covariates, *(n for p in self.parameters for n in p.needs)]))

    def parameter(self, name: str) -> EffectParameter:
        """A parameter by its name.

        Raises:
            InputError: the effect has no such parameter.
        """
        for parameter in self.parameters:
            if parameter.name == name:
                return parameter
        names = ", ".join(p.name for p in self.parameters)
        raise InputError([Problem(f"effect {self.name}", f"one of the parameters {names}", f'"{name}"')])

    def shift_of_clocks_s(self, parameters: Mapping[str, ArrayLike]) -> float:
        """How much of the effect could as well be clocks that do not agree [s]; 0 for most effects."""
        del parameters
        return 0.0

    @abstractmethod
    def starts(self, scene: Scene) -> tuple[Start, ...]:
        """Where the search for the effect begins: sets of its forms, with points whose span holds what it may do.

        Args:
            scene: the scale of the session.
        """

    def at_strength(
        self, strength: float, rng: np.random.Generator, layout: TaxelLayout, poses: int = 2
    ) -> dict[str, FloatArray]:
        """Parameters of a case of some strength: 0 neutral, 1 a typical one that is clearly visible.

        What varies from taxel to taxel and from pose to pose is drawn; twice the strength with the same draw is
        twice as far from neutral, as far as the bounds allow.

        Args:
            strength: zero or more.
            rng: for what is drawn.
            layout: the taxels.
            poses: number of hand poses.

        Raises:
            InputError: a strength that is negative or not finite.
        """
        if not (np.isfinite(strength) and strength >= 0):
            raise InputError([Problem(f"strength of effect {self.name}", "a number >= 0", f"{strength:g}")])
        return {
            p.name: np.clip(p.neutral + strength * p.typical * _pattern(p, rng, layout, poses), p.low, p.high)
            for p in self.parameters
        }

    @staticmethod
    def _differs(parameter: EffectParameter, values: Values) -> bool:
        return parameter.role == "strength" and bool((values[parameter.name] != parameter.neutral).any())


class InputEffect(Effect):
    """Changes what presses where and how hard."""

    stage = Stage.POSE_AND_FORCE

    @abstractmethod
    def apply(self, samples: Samples, values: Values, setting: Setting) -> Samples:
        """Samples as the skin feels them, from samples as they were measured."""


class LawEffect(Effect):
    """Changes how stress follows from penetration."""

    stage = Stage.CONTACT

    @abstractmethod
    def law(self, values: Values) -> StressLaw:
        """The law in place of the linear one."""


class SpreadEffect(Effect):
    """Changes which tactile points a taxel feels."""

    stage = Stage.SPREAD

    @abstractmethod
    def weights(self, values: Values, patch: Patch) -> FloatArray:
        """How much of each tactile point's load each taxel feels (N, J)."""


class MemoryEffect(Effect):
    """Makes loads depend on earlier ones."""

    stage = Stage.MEMORY
    has_memory = True

    @abstractmethod
    def run(
        self, loads_n: FloatArray, samples: Samples, values: Values, state: State
    ) -> tuple[FloatArray, State]:
        """Loads (K, J) [N] as they show, and what to remember.

        Args:
            loads_n: (K, J) finite loads [N].
            samples: K of them, that follow those of the state.
            values: parameters.
            state: of an earlier call; None at the beginning of a session.
        """


class SignalEffect(Effect):
    """Changes loads or values at once; ``stage`` says which."""

    @abstractmethod
    def apply(self, signal: FloatArray, samples: Samples, values: Values, setting: Setting) -> FloatArray:
        """The changed signal (K, J): loads [N] at the transfer, values [counts] later. The given one stays as it is."""


def known(covariate: FloatArray | None, where: FloatArray) -> FloatArray:
    """What a covariate says where it is known, zero in the samples that do not have it.

    Args:
        covariate: (K,) NaN where not known.
        where: (K,) what to take in its place.
    """
    assert covariate is not None
    return np.where(np.isfinite(covariate), where, 0.0)


def by_pose(
    per_pose: FloatArray, pose: np.ndarray[Any, np.dtype[np.int64]] | None, neutral: float
) -> FloatArray:
    """A parameter (P,) for the pose of each sample (K,); neutral for poses that it does not know."""
    assert pose is not None
    if len(per_pose) == 1:
        return np.where(pose >= 0, per_pose[0], neutral)
    there = (pose >= 0) & (pose < len(per_pose))
    return np.where(there, per_pose[np.where(there, pose, 0)], neutral)


def _pattern(
    parameter: EffectParameter, rng: np.random.Generator, layout: TaxelLayout, poses: int
) -> FloatArray:
    """How a typical case of a parameter varies: one, or drawn for taxels, or drawn for poses about their mean."""
    if parameter.shape == "scalar":
        return np.asarray(1.0)
    if parameter.shape == "per-taxel":
        return rng.standard_normal(layout.taxels)
    signs = np.where(np.arange(poses) % 2 == 0, 1.0, -1.0) * rng.choice([-1.0, 1.0])
    return signs * rng.uniform(0.7, 1.3, poses)
