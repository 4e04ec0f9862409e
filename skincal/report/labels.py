"""Short labels next to the points of a figure, without overlaps with each other or with points."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np
from matplotlib.axes import Axes

from skincal.fitting.types import Floats
from skincal.report.style import BLACK, GREY

SIZE_PT = 6.0
"""Size of the letters [pt]."""

_WIDE, _HIGH = 0.62, 0.95
"""Width of a digit and height of a line, relative to the size of the letters."""

_DOT_PT = 2.5
_DISTANCES_PT = (3.0, 8.0, 14.0)
_FAR_PT = 5.0
"""Distance from which a thin line leads from the point to its label."""

_DIRECTIONS = np.radians([45, 315, 135, 225, 0, 180, 90, 270, 22, 338, 158, 202])


def name_points(axes: Axes, names: Sequence[str], points: Floats, *, keep_clear: Floats | None = None) -> int:
    """Write labels next to points; the figure must have been laid out, so that the axes have their place and limits.

    Args:
        axes: axes of the points.
        names: one label per point.
        points: (N, 2) in the units of the axes.
        keep_clear: (M, 2) other points that no label may cover.

    Returns:
        Number of labels that were left out for lack of room.
    """
    at = _in_points(axes, points)
    dots = at if keep_clear is None else np.concatenate([at, _in_points(axes, keep_clear)])
    taken = np.concatenate([dots - _DOT_PT, dots + _DOT_PT], axis=1)
    left_out = 0
    for name, point, here in zip(names, points, at, strict=True):
        for offset, box in _candidates(here, name):
            if not _covers(box, taken):
                taken = np.concatenate([taken, box[None]])
                _write(axes, name, point, offset)
                break
        else:
            left_out += 1
    return left_out


def _in_points(axes: Axes, points: Floats) -> Floats:
    """Return the positions on the page [pt]."""
    return axes.transData.transform(points) * 72.0 / axes.figure.dpi  # type: ignore[union-attr]


def _candidates(here: Floats, name: str) -> Iterator[tuple[Floats, Floats]]:
    """Yield candidate offsets of a label from its point, with the boxes (4,) it would fill [pt], the nearest first."""
    half = 0.5 * SIZE_PT * np.array([_WIDE * len(name), _HIGH])
    for distance in _DISTANCES_PT:
        for direction in _DIRECTIONS:
            towards = np.array([np.cos(direction), np.sin(direction)])
            offset = towards * (distance + half)
            yield offset, np.concatenate([here + offset - half, here + offset + half])


def _covers(box: Floats, taken: Floats) -> bool:
    apart = (box[:2] >= taken[:, 2:]) | (box[2:] <= taken[:, :2])
    return not bool(apart.any(axis=1).all())


def _write(axes: Axes, name: str, point: Floats, offset: Floats) -> None:
    line: Any = {"arrowstyle": "-", "color": GREY, "linewidth": 0.4, "shrinkA": 0.0, "shrinkB": 2.0}
    far = float(np.abs(offset).max()) > _FAR_PT + 0.5 * SIZE_PT * _WIDE * len(name)
    axes.annotate(
        name,
        (float(point[0]), float(point[1])),
        (float(offset[0]), float(offset[1])),
        textcoords="offset points",
        fontsize=SIZE_PT,
        color=BLACK,
        ha="center",
        va="center",
        arrowprops=line if far else None,
    ).set_in_layout(False)
