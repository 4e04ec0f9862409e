"""Parameters of effects: what they are, and checked values of them."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike

from skincal.errors import InputError, Problem
from skincal.model.arrays import FloatArray, frozen

Shape = Literal["scalar", "per-taxel", "per-pose"]
Role = Literal["strength", "form"]
Scale = Literal["linear", "log"]


@dataclass(frozen=True)
class EffectParameter:
    """One parameter of an effect.

    Attributes:
        name: with its unit: ``time_constant_s``.
        unit: for people; ``-`` for a plain number.
        neutral: at this value of all strengths the effect is not there. For a form: its default.
        low: smallest value.
        high: largest value.
        description: what it is, in a few words.
        typical: how far from neutral a clearly visible case lies; 0 where such a case does not need it.
        shape: one number, one for each taxel, or one for each hand pose.
        role: ``strength`` if it brings the effect in, ``form`` if it only says what it is like.
        needs: covariates that are needed as soon as it is not neutral.
        scale: the scale on which to fit and to draw it.
    """

    name: str
    unit: str
    neutral: float
    low: float
    high: float
    description: str
    typical: float = 0.0
    shape: Shape = "scalar"
    role: Role = "strength"
    needs: tuple[str, ...] = ()
    scale: Scale = "linear"


class Values(Mapping[str, FloatArray]):
    """Checked parameters of an effect by name: read-only arrays, () for one number, (J,) or (poses,) for more."""

    def __init__(self, arrays: Mapping[str, FloatArray]) -> None:
        """Take arrays that :func:`checked` has looked at."""
        self._arrays = dict(arrays)

    def __getitem__(self, name: str) -> FloatArray:
        return self._arrays[name]

    def __iter__(self) -> Iterator[str]:
        return iter(self._arrays)

    def __len__(self) -> int:
        return len(self._arrays)

    def __repr__(self) -> str:
        return f"Values({ {name: array.tolist() for name, array in self._arrays.items()} })"

    def number(self, name: str) -> float:
        """Return a parameter that is one number."""
        return float(self._arrays[name])

    @property
    def key(self) -> tuple[tuple[str, tuple[int, ...], bytes], ...]:
        """Equal for equal values, and fit to be a key."""
        return tuple((name, array.shape, array.tobytes()) for name, array in self._arrays.items())


def checked(
    effect: str, parameters: tuple[EffectParameter, ...], given: Mapping[str, ArrayLike], taxels: int
) -> Values:
    """Return the values of all parameters of an effect: those given, neutral or default where not.

    Args:
        effect: its name, for errors.
        parameters: that it has.
        given: numbers by parameter; one number stands for all taxels or poses.
        taxels: number of taxels J.

    Raises:
        InputError: parameters that the effect does not have, and values that they cannot have.
    """
    known = {parameter.name: parameter for parameter in parameters}
    problems = [
        Problem(f"effect {effect}", f"parameters among {', '.join(known)}", f'"{name}"')
        for name in given
        if name not in known
    ]
    arrays: dict[str, FloatArray] = {}
    for name, parameter in known.items():
        array = np.array(given.get(name, parameter.neutral), dtype=np.float64)
        problem = _problem(effect, parameter, array, taxels)
        if problem is not None:
            problems.append(problem)
            continue
        if parameter.shape == "per-taxel":
            array = np.broadcast_to(array, (taxels,)).copy()
        elif parameter.shape == "per-pose":
            array = np.atleast_1d(array)
        arrays[name] = frozen(array)
    if problems:
        raise InputError(problems)
    return Values(arrays)


def _problem(effect: str, parameter: EffectParameter, array: FloatArray, taxels: int) -> Problem | None:
    """What is wrong with an array as a parameter's value; None if nothing is."""
    place = f"effect {effect}, parameter {parameter.name}"
    if parameter.shape == "scalar" and array.ndim:
        return Problem(place, "one number", f"an array of shape {array.shape}")
    if parameter.shape == "per-taxel" and array.shape not in ((), (taxels,)):
        return Problem(place, f"one number, or {taxels}, one for each taxel", f"shape {array.shape}")
    if parameter.shape == "per-pose" and (array.ndim > 1 or array.size == 0):
        return Problem(place, "one number for each hand pose", f"shape {array.shape}")
    inside = (array >= parameter.low) & (array <= parameter.high)
    if not inside.all():
        worst = array[~inside].ravel()[0] if array.ndim else array
        return Problem(
            place, f"{parameter.low:g} to {parameter.high:g} {parameter.unit}", f"{float(worst):g}"
        )
    return None
