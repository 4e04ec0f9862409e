"""Where the search for an effect begins: points in its parameters, and what is known of a session's scale."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from skincal.model.arrays import FloatArray


@dataclass(frozen=True)
class Scene:
    """The scale of a session, so that starts are where something shows.

    Attributes:
        taxels: number of taxels J.
        poses: number of hand poses.
        top_counts: a large value, less rest [counts].
        top_n: a large load on a taxel [N].
        force_n: a middling force [N].
        duration_s: of the session [s].
        speed_m_per_s: a middling speed.
    """

    taxels: int
    poses: int
    top_counts: float
    top_n: float
    force_n: float
    duration_s: float
    speed_m_per_s: float = 1e-3


@dataclass(frozen=True)
class Start:
    """One start: the effect is looked for in the span of some points, each a set of parameters.

    Attributes:
        points: parameters by name; what is left out is neutral or default. All have the same forms.
        sigma: what is expected beforehand of the multiple of each point, as a standard deviation.
        alone: no other start of the effect has the same taxel: several may be there at once (a dead taxel each).
    """

    points: tuple[Mapping[str, FloatArray], ...]
    sigma: tuple[float, ...]
    alone: int | None = None


def start(*points: Mapping[str, ArrayLike], sigma: float | Iterable[float] = 1.0) -> Start:
    """Return a start of some points; each is one standard deviation away unless ``sigma`` says otherwise."""
    each = [float(sigma)] * len(points) if isinstance(sigma, int | float) else [float(s) for s in sigma]
    return Start(
        tuple({k: np.asarray(v, dtype=np.float64) for k, v in p.items()} for p in points), tuple(each)
    )


def each_taxel(name: str, step: float, taxels: int, **forms: float) -> list[Mapping[str, ArrayLike]]:
    """Return a point for each taxel, whose own number alone is a step from neutral zero."""
    return [{name: step * np.eye(taxels)[j], **forms} for j in range(taxels)]


def each_of(
    name: str, step: float, count: int, neutral: float = 0.0, **forms: float
) -> list[Mapping[str, ArrayLike]]:
    """Return a point for each of several numbers of a parameter, a step from neutral."""
    return [{name: neutral + step * np.eye(count)[j], **forms} for j in range(count)]
