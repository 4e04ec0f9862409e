"""Starting points of the search for an effect, and the scales of a session."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from skincal.model.arrays import FloatArray


@dataclass(frozen=True)
class Scene:
    """Scales of a session, so that starting points lie where an effect is visible.

    Attributes:
        taxels: number of taxels J.
        poses: number of hand poses.
        top_counts: a large value above rest [counts].
        top_n: a large load on a taxel [N].
        force_n: a medium force [N].
        duration_s: length of the session [s].
        speed_m_per_s: a medium speed.
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
    """Starting point of a search: the effect is sought in the span of some points, each a set of parameters.

    Attributes:
        points: parameters by name; omitted ones are neutral or default. All have the same forms.
        sigma: prior standard deviation of the multiple of each point.
        alone: no other start of the effect has the same taxel, so that several may act at once (one dead taxel each).
    """

    points: tuple[Mapping[str, FloatArray], ...]
    sigma: tuple[float, ...]
    alone: int | None = None


def start(*points: Mapping[str, ArrayLike], sigma: float | Iterable[float] = 1.0) -> Start:
    """Return a start of some points; each has a prior standard deviation of one unless ``sigma`` is given."""
    each = [float(sigma)] * len(points) if isinstance(sigma, int | float) else [float(s) for s in sigma]
    return Start(
        tuple({k: np.asarray(v, dtype=np.float64) for k, v in p.items()} for p in points), tuple(each)
    )


def each_taxel(name: str, step: float, taxels: int, **forms: float) -> list[Mapping[str, ArrayLike]]:
    """Return a point per taxel, at which only its own number is a step away from neutral zero."""
    return [{name: step * np.eye(taxels)[j], **forms} for j in range(taxels)]


def each_of(
    name: str, step: float, count: int, neutral: float = 0.0, **forms: float
) -> list[Mapping[str, ArrayLike]]:
    """Return a point for each of several numbers of a parameter, a step away from neutral."""
    return [{name: neutral + step * np.eye(count)[j], **forms} for j in range(count)]
