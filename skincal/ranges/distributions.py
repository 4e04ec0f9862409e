"""The distributions that a parameter may have: their figures, and what each does. A new one is one entry here."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Final

import numpy as np

from skincal.model.arrays import FloatArray

Figures = Mapping[str, FloatArray]
"""Figures by name: one number, or one a joint or taxel."""


@dataclass(frozen=True)
class Distribution:
    """A distribution.

    Attributes:
        figures: names of its figures; ``low`` and ``high`` are in this order, ``sigma`` is at least 0.
        draw: draws so many values.
        middle: its middle, which stands for it where it is not drawn.
        text: its figures in a few characters, for tables.
        positive: whether its figures have to lie above 0.
    """

    figures: tuple[str, ...]
    draw: Callable[[Figures, np.random.Generator, int], FloatArray]
    middle: Callable[[Figures], FloatArray]
    text: str
    positive: bool = False


def _uniform(f: Figures, rng: np.random.Generator, size: int) -> FloatArray:
    # A span of equal bounds, or of neighbouring floats, must not round beyond them.
    return np.minimum(np.maximum(rng.uniform(f["low"], f["high"], size), f["low"]), f["high"])


def _log_uniform(f: Figures, rng: np.random.Generator, size: int) -> FloatArray:
    # exp(log(x)) may miss x by one unit in the last place, and then leave the range.
    return np.clip(np.exp(rng.uniform(np.log(f["low"]), np.log(f["high"]), size)), f["low"], f["high"])


DISTRIBUTIONS: Final = {
    "uniform": Distribution(
        ("low", "high"), _uniform, lambda f: (f["low"] + f["high"]) / 2, "{low:g} … {high:g}"
    ),
    "log_uniform": Distribution(
        ("low", "high"),
        _log_uniform,
        lambda f: np.sqrt(f["low"] * f["high"]),
        "log {low:g} … {high:g}",
        positive=True,
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
"""By the word in a file."""
