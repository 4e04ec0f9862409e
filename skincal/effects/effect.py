"""Base classes of effects: small objects at one stage of the chain from the contact to the counts."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping
from enum import IntEnum
from typing import Any, ClassVar, Literal

import numpy as np
from numpy.typing import ArrayLike

from skincal.effects.parameter import TYPICAL_TOP_COUNTS, EffectParameter, Scene, Start, Values
from skincal.effects.samples import Samples, Setting
from skincal.errors import InputError, Problem, input_error
from skincal.model import Patch, StressLaw, TaxelLayout
from skincal.model.arrays import FloatArray, IntArray, frozen

State = Any
"""What an effect with memory carries from one sample to the next; None before the first."""


class Stage(IntEnum):
    """Stage of an effect in the chain."""

    POSE_AND_FORCE = 0
    """Changes place and force of a press, before there is a contact."""
    CONTACT = 1
    """Changes the stress as a function of penetration."""
    SPREAD = 2
    """Changes which tactile points a taxel feels."""
    MEMORY = 3
    """Makes loads [N] depend on earlier ones."""
    TRANSFER = 4
    """Changes loads [N] without memory, taxel by taxel, before the scale turns them into counts."""
    CROSSTALK = 5
    """Mixes the values of taxels [counts]."""
    CONVERTER = 6
    """Changes values [counts], taxel by taxel, before they are rounded and clipped."""


MOST_STRENGTH = 1e3
"""Largest strength of an effect: all parameters are at their bounds long before."""


class Effect(ABC):
    """An effect of the skin beyond the base model.

    To add one, add a file here and a line in the registry; another package adds one through the entry point group
    ``skincal.effects``.

    An effect has no state of its own: its parameters and its memory are passed in. With all strengths at their neutral
    values it is skipped, so that the model is exactly the one without it.

    Attributes:
        name: name of the effect, as in the contract.
        stage: its stage in the chain.
        meaning: description in one sentence.
        parameters: its parameters.
        search_from: starting points of the search for it, where they do not depend on the session.
        covariates: covariates that it needs whenever it is not neutral; parameters may need more.
        asks: kinds of presses without which it is hardly visible (:mod:`skincal.diagnosis.invisible_effects`).
        single_taxels: whether it is a fault of single taxels.
        in_places: whether it acts on the measured positions of presses, so that images hardly show it.
        has_memory: whether it depends on earlier samples.
        of_rig: whether it is an error of the measurement, not a property of the skin; where the true place and force
            are known, as in an environment, it does not apply.
        equation_error: relative error that its equation may have against a real skin, one standard deviation; 0 where
            the effect is what its equation says.
        errs_over: what its equation is a function of, and so its error: force and what a taxel feels, where each taxel
            lies to the contact, the time of the session, or all that was before, as with memory and friction.
        zero_error: how far scale and stiffness of the base model may lie from where its equation does nothing, in parts
            of what it does, relative, in the mean over a press; 0 where all equations of it agree about that.
        shows: presses that show it best in a picture, by their names in ``docs/_ext/signatures.py``; empty: over
            force, or over time if it has memory.
        replaces_range: the range of a preset that holds what is assumed where this effect is not known.
        source: source of its equation.
    """

    name: ClassVar[str]
    stage: ClassVar[Stage]
    meaning: ClassVar[str]
    parameters: ClassVar[tuple[EffectParameter, ...]]
    search_from: ClassVar[tuple[Start, ...]]
    covariates: ClassVar[tuple[str, ...]] = ()
    asks: ClassVar[tuple[str, ...]] = ()
    single_taxels: ClassVar[bool] = False
    in_places: ClassVar[bool] = False
    has_memory: ClassVar[bool] = False
    of_rig: ClassVar[bool] = False
    equation_error: ClassVar[float] = 0.2
    errs_over: ClassVar[Literal["load", "place", "session", "history"]] = "load"
    zero_error: ClassVar[float] = 0.3
    shows: ClassVar[str] = ""
    replaces_range: ClassVar[str] = ""
    source: ClassVar[str]

    def checked(self, given: Mapping[str, ArrayLike], taxels: int) -> Values:
        """Return the values of all parameters: given ones, and neutral or default ones for the rest.

        Raises:
            InputError: unknown parameters, or values out of bounds.
        """
        known = {parameter.name: parameter for parameter in self.parameters}
        expected = f"parameters among {', '.join(known)}"
        problems = [
            Problem(f"effect {self.name}", expected, f'"{name}"') for name in given if name not in known
        ]
        arrays: dict[str, FloatArray] = {}
        for name, parameter in known.items():
            array = np.array(given.get(name, parameter.neutral), dtype=np.float64)
            if fault := parameter.fault(array, taxels):
                problems.append(Problem(f"effect {self.name}, parameter {name}", *fault))
                continue
            if parameter.shape == "per-taxel":
                array = np.broadcast_to(array, (taxels,)).copy()
            elif parameter.shape == "per-pose":
                array = np.atleast_1d(array)
            arrays[name] = frozen(array)
        if problems:
            raise InputError(problems)
        return Values(arrays)

    def is_neutral(self, values: Values) -> bool:
        """Return whether the effect has no influence at these values."""
        return not any(self._differs(parameter, values) for parameter in self.parameters)

    def needs(self, values: Values) -> tuple[str, ...]:
        """Return the covariates that the effect needs at these values, without duplicates."""
        more = [n for p in self.parameters if self._differs(p, values) for n in p.needs]
        return () if self.is_neutral(values) else tuple(dict.fromkeys([*self.covariates, *more]))

    @property
    def all_covariates(self) -> tuple[str, ...]:
        """Covariates that the effect may need, whatever its values."""
        return tuple(dict.fromkeys([*self.covariates, *(n for p in self.parameters for n in p.needs)]))

    def parameter(self, name: str) -> EffectParameter:
        """Return a parameter by its name.

        Raises:
            InputError: the effect has no such parameter.
        """
        own = {p.name: p for p in self.parameters}
        if name not in own:
            raise input_error(f"effect {self.name}", f"one of the parameters {', '.join(own)}", f'"{name}"')
        return own[name]

    def shift_of_clocks_s(self, parameters: Mapping[str, ArrayLike]) -> float:
        """Return how much of the effect could also be explained by a clock offset [s]; 0 for most effects."""
        del parameters
        return 0.0

    def starts(self, scene: Scene) -> tuple[Start, ...]:
        """Return the starting points of the search: sets of forms, with points whose span holds the possible effect.

        Args:
            scene: scales of the session; override this where they depend on it.
        """
        return self.search_from

    def at_strength(
        self,
        strength: float,
        rng: np.random.Generator,
        layout: TaxelLayout,
        poses: int = 2,
        *,
        top_counts: float = TYPICAL_TOP_COUNTS,
    ) -> dict[str, FloatArray]:
        """Return the parameters of a case of some strength: 0 is neutral, 1 a typical, clearly visible case.

        Parameters that vary between taxels or poses are drawn. With one draw, twice the strength is twice as far from
        neutral, within the bounds.

        Args:
            strength: zero or more.
            rng: generator of the draws.
            layout: the taxels.
            poses: number of hand poses.
            top_counts: a large value of the sensor above rest, in its unit.

        Raises:
            InputError: the strength is negative, or above that of any effect.
        """
        self.check_strength(strength)
        return {
            p.name: np.clip(
                p.neutral + strength * p.typical_at(top_counts) * _pattern(p, rng, layout, poses),
                p.low,
                p.high,
            )
            for p in self.parameters
        }

    def check_strength(self, strength: float) -> None:
        """Raise InputError if a strength is negative, or above that of any effect."""
        if not 0 <= strength <= MOST_STRENGTH:
            raise input_error(f"strength of effect {self.name}", f"0 to {MOST_STRENGTH:g}", f"{strength:g}")

    @staticmethod
    def _differs(parameter: EffectParameter, values: Values) -> bool:
        return parameter.role == "strength" and bool((values[parameter.name] != parameter.neutral).any())


class InputEffect(Effect):
    """An effect that changes place and force of a press."""

    stage = Stage.POSE_AND_FORCE

    @abstractmethod
    def apply(self, samples: Samples, values: Values, setting: Setting) -> Samples:
        """Return the samples as the skin feels them, from the samples as measured."""


class LawEffect(Effect):
    """An effect that changes the stress as a function of penetration."""

    stage = Stage.CONTACT

    @abstractmethod
    def law(self, values: Values) -> StressLaw:
        """Return the law that replaces the linear one."""


class SpreadEffect(Effect):
    """An effect that changes which tactile points a taxel feels."""

    stage = Stage.SPREAD

    @abstractmethod
    def weights(self, values: Values, patch: Patch) -> FloatArray:
        """Return the weight of each tactile point's load in each taxel (N, J)."""


class MemoryEffect(Effect):
    """An effect that makes loads depend on earlier ones."""

    stage = Stage.MEMORY
    has_memory = True
    errs_over: ClassVar[Literal["load", "place", "session", "history"]] = "history"

    @abstractmethod
    def run(
        self, loads_n: FloatArray, samples: Samples, values: Values, state: State
    ) -> tuple[FloatArray, State]:
        """Return the resulting loads (K, J) [N] and the new state.

        Args:
            loads_n: (K, J) finite loads [N].
            samples: K samples that follow those of the state.
            values: parameters.
            state: state of the previous call; None at the beginning of a session.
        """

    def prepare(self) -> None:
        """Compile what :meth:`run` needs, if anything: a hand's first image has as little time as the others."""


class SignalEffect(Effect):
    """An effect that changes loads or values without memory, at its ``stage``."""

    @abstractmethod
    def apply(self, signal: FloatArray, samples: Samples, values: Values, setting: Setting) -> FloatArray:
        """Return the changed signal (K, J): loads [N] at the transfer, values [counts] later; keep ``signal`` as is."""


def known(covariate: FloatArray | None, where: FloatArray) -> FloatArray:
    """Return numbers (K,) where a covariate (K,) is known, and zero in samples that lack it."""
    assert covariate is not None
    return np.where(np.isfinite(covariate), where, 0.0)


def by_pose(per_pose: FloatArray, pose: IntArray | None, neutral: float) -> FloatArray:
    """Return a parameter (P,) for the pose of each sample (K,), neutral for unknown poses."""
    assert pose is not None
    if len(per_pose) == 1:
        return np.where(pose >= 0, per_pose[0], neutral)
    there = (pose >= 0) & (pose < len(per_pose))
    return np.where(there, per_pose[np.where(there, pose, 0)], neutral)


def _pattern(
    parameter: EffectParameter, rng: np.random.Generator, layout: TaxelLayout, poses: int
) -> FloatArray:
    """Return the pattern of a typical case: one number, or draws for taxels, or draws for poses about their mean."""
    if parameter.shape == "scalar":
        return np.asarray(1.0)
    if parameter.shape == "per-taxel":
        return rng.standard_normal(layout.taxels)
    signs = np.where(np.arange(poses) % 2 == 0, 1.0, -1.0) * rng.choice([-1.0, 1.0])
    return signs * rng.uniform(0.7, 1.3, poses)
