"""A randomized parameter: its distribution, when it is drawn, and the source of its figures."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise
from typing import Annotated, Final, Literal, get_args

import numpy as np

from skincal.dataset.keys import Key
from skincal.errors import InputError, Problem
from skincal.model.arrays import FloatArray

Figures = Mapping[str, FloatArray]
"""Figures by name: one number, or one a joint or taxel."""


@dataclass(frozen=True)
class Distribution:
    """A distribution: the names of its figures (fields of :class:`Parameter`), and what draws so many values.

    ``middle`` stands for it where it is not drawn, ``text`` shows its figures in tables. The figures have to lie above
    0 if ``positive``; none of them may be above the next if ``rising``; ``sigma`` is at least 0.
    """

    figures: tuple[str, ...]
    draw: Callable[[Figures, np.random.Generator, int], FloatArray]
    middle: Callable[[Figures], FloatArray]
    text: str
    positive: bool = False
    rising: bool = False


def _uniform(f: Figures, rng: np.random.Generator, size: int) -> FloatArray:
    # A span of equal bounds, or of neighbouring floats, must not round beyond them.
    return np.minimum(np.maximum(rng.uniform(f["low"], f["high"], size), f["low"]), f["high"])


def _log_uniform(f: Figures, rng: np.random.Generator, size: int) -> FloatArray:
    # exp(log(x)) may miss x by one unit in the last place, and then leave the range.
    return np.clip(np.exp(rng.uniform(np.log(f["low"]), np.log(f["high"]), size)), f["low"], f["high"])


DISTRIBUTIONS: Final = {
    "uniform": Distribution(
        ("low", "high"), _uniform, lambda f: (f["low"] + f["high"]) / 2, "{low:g} … {high:g}", rising=True
    ),
    "log_uniform": Distribution(
        ("low", "high"),
        _log_uniform,
        lambda f: np.sqrt(f["low"] * f["high"]),
        "log {low:g} … {high:g}",
        positive=True,
        rising=True,
    ),
    "normal": Distribution(
        ("mean", "sigma"),
        lambda f, rng, size: rng.normal(f["mean"], f["sigma"], size),
        lambda f: f["mean"],
        "N({mean:g}, {sigma:g})",
    ),
    "constant": Distribution(
        ("value",),
        lambda f, rng, size: np.broadcast_to(f["value"], (size,)).astype(np.float64),
        lambda f: f["value"],
        "{value:g}",
    ),
}

FIGURES: Final = tuple(dict.fromkeys(name for one in DISTRIBUTIONS.values() for name in one.figures))


Mode = Literal["episode", "step"]
Source = Literal["calibrated", "assumed"]
Numbers = float | tuple[float, ...]
"""One figure for all joints or taxels, or one for each."""

_Figure = Annotated[Numbers, Key("a number, or a list of numbers")]

MODES: Final[tuple[str, ...]] = get_args(Mode)
SOURCES: Final[tuple[str, ...]] = get_args(Source)


@dataclass(frozen=True, kw_only=True)
class SetFigures:
    """Figures that a parameter may have, in code and in a file; None: not set."""

    low: _Figure | None = None
    high: _Figure | None = None
    mean: _Figure | None = None
    sigma: _Figure | None = None
    sigma_from: str | None = None
    value: _Figure | None = None


@dataclass(frozen=True)
class Parameter(SetFigures):
    """A parameter that is drawn anew every episode or every step.

    The figures are in the unit that the parameter's name carries. Each is one number, or a tuple with one
    number a joint or taxel. Build one with :meth:`uniform`, :meth:`log_uniform`, :meth:`normal` or
    :meth:`constant`.

    Attributes:
        distribution: ``uniform`` or ``log_uniform`` in [low, high], ``normal``, ``constant``, or another of
            ``skincal.ranges.parameter``.
        mode: drawn once per ``episode``, or at every ``step`` of the skin and the policy.
        source: ``calibrated`` if a fit to data gave the figures, else ``assumed``.
        low: lower bound of a (log-)uniform distribution.
        high: upper bound of a (log-)uniform distribution.
        mean: mean of a normal distribution.
        sigma: standard deviation of a normal distribution.
        sigma_from: full name of another parameter, drawn per episode, whose draw is the standard deviation:
            the taxel noise N(0, sigma) with sigma ~ U(0, 5) is such a one.
        value: value of a constant.

    Raises:
        InputError: figures that the distribution needs are missing, superfluous or impossible; all at once.
    """

    distribution: str
    mode: Mode = "episode"
    source: Source = "assumed"

    def __post_init__(self) -> None:
        if found := problems(self, "parameter"):
            raise InputError(found)

    @classmethod
    def uniform(
        cls, low: Numbers, high: Numbers, mode: Mode = "episode", source: Source = "assumed"
    ) -> Parameter:
        """Return the distribution U(low, high)."""
        return cls("uniform", mode, source, low=low, high=high)

    @classmethod
    def log_uniform(
        cls, low: Numbers, high: Numbers, mode: Mode = "episode", source: Source = "assumed"
    ) -> Parameter:
        """Return the distribution whose logarithm is uniform between log(low) and log(high); both above 0."""
        return cls("log_uniform", mode, source, low=low, high=high)

    @classmethod
    def normal(
        cls, mean: Numbers, sigma: Numbers | str, mode: Mode = "step", source: Source = "assumed"
    ) -> Parameter:
        """Return the distribution N(mean, sigma²); a string for sigma names the parameter whose draw it is."""
        if isinstance(sigma, str):
            return cls("normal", mode, source, mean=mean, sigma_from=sigma)
        return cls("normal", mode, source, mean=mean, sigma=sigma)

    @classmethod
    def constant(cls, value: Numbers, mode: Mode = "episode", source: Source = "assumed") -> Parameter:
        """Return the distribution that always gives the same value."""
        return cls("constant", mode, source, value=value)

    def middle(self) -> FloatArray:
        """Return the middle of the distribution, (): one number for all joints or taxels, or one for each."""
        return DISTRIBUTIONS[self.distribution].middle(self.arrays)

    @cached_property
    def arrays(self) -> Mapping[str, FloatArray]:
        """The figures that are set, as arrays."""
        return {name: np.asarray(numbers, dtype=np.float64) for name, numbers in self.figures().items()}

    def __str__(self) -> str:
        if self.size is not None:
            return f"{self.size} {'values' if self.value is not None else 'ranges'}"
        sigma = {} if self.sigma_from is None else {"sigma": self.sigma_from.rpartition(".")[2]}
        text = DISTRIBUTIONS[self.distribution].text
        return (text.replace("{sigma:g}", "`{sigma}`") if sigma else text).format(**self.figures(), **sigma)

    def figures(self) -> dict[str, Numbers]:
        """Return the figures that are set, by name."""
        pairs = {name: getattr(self, name) for name in FIGURES}
        return {name: numbers for name, numbers in pairs.items() if numbers is not None}

    @cached_property
    def size(self) -> int | None:
        """Length of the figures that are lists; None if one number stands for all joints or taxels."""
        sizes = {len(numbers) for numbers in self.figures().values() if isinstance(numbers, tuple)}
        return max(sizes, default=None)

    def width(self) -> float:
        """Return the width of the range (the widest of several): 4 sigma of a normal; nan if sigma is drawn itself."""
        figures = self.arrays
        if "low" in figures:
            return float(np.max(figures["high"] - figures["low"]))
        if "mean" in figures:
            return 4.0 * float(np.max(figures.get("sigma", np.nan)))
        return 0.0


def as_tuple(numbers: Numbers | None) -> tuple[float, ...]:
    """Return the number or numbers as a tuple; empty for None."""
    if numbers is None:
        return ()
    return numbers if isinstance(numbers, tuple) else (numbers,)


def problems(parameter: Parameter, place: str) -> list[Problem]:
    """Return every problem of a parameter."""
    found = [
        Problem(f"{place} {key}", f"one of {', '.join(allowed)}", repr(got))
        for key, allowed, got in (
            ("distribution", DISTRIBUTIONS, parameter.distribution),
            ("mode", MODES, parameter.mode),
            ("source", SOURCES, parameter.source),
        )
        if got not in allowed
    ]
    if parameter.distribution in DISTRIBUTIONS:
        found += _figure_problems(parameter, place)
    return found


def _figure_problems(parameter: Parameter, place: str) -> list[Problem]:
    set_figures = set(parameter.figures())
    if parameter.sigma_from is not None:
        set_figures.add("sigma_from")
    named = DISTRIBUTIONS[parameter.distribution].figures
    needed = set(named)
    if "sigma" in needed and "sigma_from" in set_figures:
        needed = needed - {"sigma"} | {"sigma_from"}
    expected = f"{' and '.join(named)} for a {parameter.distribution} distribution"
    found = [Problem(f"{place} {key}", expected, "nothing") for key in sorted(needed - set_figures)]
    found += [
        Problem(f"{place} {key}", expected, f"{key} = {getattr(parameter, key)}", f"Take {key} out.")
        for key in sorted(set_figures - needed)
    ]
    for key, numbers in parameter.figures().items():
        if not as_tuple(numbers) or not all(math.isfinite(number) for number in as_tuple(numbers)):
            found.append(Problem(f"{place} {key}", "finite numbers", str(numbers)))
    return found or _order_problems(parameter, place)


def _order_problems(parameter: Parameter, place: str) -> list[Problem]:
    sizes = {len(numbers) for numbers in parameter.figures().values() if isinstance(numbers, tuple)}
    if len(sizes) > 1:
        return [Problem(place, "lists of one length", f"lengths {sorted(sizes)}")]
    figures, found, of = parameter.arrays, list[Problem](), DISTRIBUTIONS[parameter.distribution]
    for low, high in pairwise(of.figures if of.rising else ()):
        if np.any(figures[low] > figures[high]):
            got = f"{low} = {getattr(parameter, low)}, {high} = {getattr(parameter, high)}"
            found.append(Problem(f"{place} {low}", f"not above {high}", got))
    least = {name: float(array.min()) for name, array in figures.items()}
    if least.get("sigma", 0.0) < 0.0:
        found.append(Problem(f"{place} sigma", "at least 0", f"{least['sigma']}"))
    name, lowest = min(least.items(), key=lambda item: item[1])
    if of.positive and lowest <= 0.0:
        expected = f"above 0 for a {parameter.distribution} distribution"
        found.append(Problem(f"{place} {name}", expected, f"{lowest}"))
    return found
