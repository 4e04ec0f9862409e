"""The patch of skin as tactile points (paper, equation 1)."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from functools import cached_property, lru_cache
from itertools import pairwise
from typing import Literal

import numpy as np

from skincal.model.arrays import (
    BoolArray,
    FloatArray,
    IntArray,
    check_shape,
    floats,
    frozen,
    positive,
    unit_rows,
)
from skincal.model.layout import TaxelLayout
from skincal.model.press.points import TiledPoints
from skincal.model.surfaces.surface import SensorPose, Surface

Rule = Literal["midpoint", "gauss"]
"""Quadrature rule for the integral over a taxel.

``midpoint`` uses the centres of even cells, as in the paper. ``gauss`` uses as many points at the nodes of Gaussian
quadrature, which integrates a cubic pressure over a taxel exactly; at a resolution of half a millimetre its error is
half that of the midpoints. An axis whose cells do not end at the edges of taxels keeps the midpoints.
"""

_SNAP_M = 1e-9
"""Largest distance of two edges of taxels that count as one edge [m]: a numerical tolerance."""

_NODES = {order: np.polynomial.legendre.leggauss(order) for order in (1, 2, 3)}
"""Nodes in [-1, 1] and weights of Gaussian quadrature, by the number of points."""


@dataclass(frozen=True, eq=False)
class Patch:
    """Tactile points t_i = (position, normal, area), and the taxel each belongs to.

    Attributes:
        points_m: (N, 3) positions, fingertip frame [m].
        normals: (N, 3) outward unit normals n_t.
        areas_m2: (N,) areas a_t [m²].
        taxel: (N,) flat taxel index; -1 in the gaps and the margin.
        layout: the taxels.
        border: (N,) True at the edge of the patch; a press that touches such a point is not wholly on the patch.
            Default: no point is a border point.
        uv_m: (N, 2) patch coordinates [m]; None for points that were not cut from a surface.
        depth_m: largest penetration that the finger allows [m].
    """

    points_m: FloatArray
    normals: FloatArray
    areas_m2: FloatArray
    taxel: IntArray
    layout: TaxelLayout
    border: BoolArray = field(default_factory=lambda: np.zeros(0, dtype=np.bool_))
    uv_m: FloatArray | None = None
    depth_m: float = np.inf

    def __repr__(self) -> str:
        return f"<Patch of {len(self.points_m)} points, {self.layout.taxels} taxels>"

    def __post_init__(self) -> None:
        object.__setattr__(self, "points_m", floats("patch points_m", self.points_m, (None, 3)))
        count = len(self.points_m)
        object.__setattr__(self, "normals", unit_rows("patch normals", self.normals))
        check_shape("patch normals", self.normals, (count, 3))
        object.__setattr__(self, "areas_m2", floats("patch areas_m2", self.areas_m2, (count,)))
        if np.any(self.areas_m2 < 0):
            raise ValueError(f"patch areas_m2: expected areas >= 0; got {self.areas_m2.min():.6g}")
        taxel = np.array(self.taxel, dtype=np.int64)
        check_shape("patch taxel", taxel, (count,))
        if count and not (taxel.min() >= -1 and taxel.max() < self.layout.taxels):
            raise ValueError(
                f"patch taxel: expected -1 to {self.layout.taxels - 1}; got {taxel.min()} to {taxel.max()}"
            )
        object.__setattr__(self, "taxel", frozen(taxel))
        border = np.array(self.border if np.size(self.border) else np.zeros(count), dtype=np.bool_)
        check_shape("patch border", border, (count,))
        object.__setattr__(self, "border", frozen(border))
        if self.uv_m is not None:
            object.__setattr__(self, "uv_m", floats("patch uv_m", self.uv_m, (count, 2)))

    def __len__(self) -> int:
        return len(self.points_m)

    @cached_property
    def tiled(self) -> TiledPoints:
        """The points in tiles for the compiled routine, computed at first use."""
        return TiledPoints.of(self.points_m, self.normals, self.areas_m2, self.taxel, self.border)

    def moved(self, points_m: FloatArray, normals: FloatArray) -> Patch:
        """Return the same cells at new positions (N, 3) [m] with new normals (N, 3), in the same tiles."""
        patch = replace(self, points_m=points_m, normals=normals)
        # Fill the cached property, so that the points are not tiled anew.
        patch.__dict__["tiled"] = self.tiled.moved(patch.points_m, patch.normals, patch.areas_m2)
        return patch

    @classmethod
    def build(
        cls,
        surface: Surface,
        layout: TaxelLayout,
        pose: SensorPose,
        resolution_m: float = 0.25e-3,
        margin_m: float = 8e-3,
        rule: Rule = "midpoint",
    ) -> Patch:
        """Cut the patch into cells and map them onto the surface.

        Cells are at most ``resolution_m`` long (on average, with Gaussian quadrature). They end at the edges of the
        taxels, so that every taxel has its exact area; the paper's layout gives 122 x 122 cells of 0.25 mm. If the
        taxels have so many different edges that this would more than double the cells of an axis, the axis is divided
        evenly.

        Args:
            surface: the fingertip.
            layout: the taxels.
            pose: pose of the patch on the surface.
            resolution_m: longest edge of a cell [m].
            margin_m: width of the skin around the taxels [m]. It carries force but has no taxels.
            rule: positions of the points in their cells: see :data:`Rule`.

        Returns:
            The patch, without those points of margin and gaps that lie beyond the surface.

        Raises:
            ValueError: a length is out of range, or a taxel lies beyond the surface.
        """
        uv, size, taxel, columns = _cells(layout, resolution_m, margin_m, rule)
        points, normals = surface.wrap(pose, uv)
        areas = surface.cell_areas(pose, uv, size)
        on = np.isfinite(points).all(axis=1) & np.isfinite(areas)
        lost = np.unique(taxel[~on & (taxel >= 0)])
        if lost.size:
            raise ValueError(
                f"patch: expected every taxel to lie on the surface; got {lost.size} taxels beyond its edge or "
                f"wrapped around by more than half a turn (first: {lost[0]}). Check the pose and the pitch"
            )
        border = _border(on, columns)
        return cls(points[on], normals[on], areas[on], taxel[on], layout, border[on], uv[on], surface.depth_m)


def patch_cells(
    layout: TaxelLayout, resolution_m: float, margin_m: float, rule: Rule = "midpoint"
) -> tuple[FloatArray, FloatArray]:
    """Return the cells of a patch, row by row (u varies fastest).

    Args:
        layout: the taxels.
        resolution_m: longest edge of a cell [m].
        margin_m: width of the margin [m], zero or more.
        rule: see :data:`Rule`.

    Returns:
        Points (N, 2) and their quadrature weights (N, 2) along u and v [m]; with the midpoint rule these are the
        centres and edge lengths of the cells.

    Raises:
        ValueError: the resolution is not positive, or the margin is negative.
    """
    positive("resolution_m", resolution_m)
    if not (np.isfinite(margin_m) and margin_m >= 0):
        raise ValueError(f"margin_m: expected a finite length >= 0; got {margin_m!r}")
    edges = np.concatenate([layout.centres_m - layout.sizes_m / 2, layout.centres_m + layout.sizes_m / 2])
    span = layout.bounds_m + np.array([[-margin_m], [margin_m]])
    stops = [_cell_boundaries(edges[:, k], span[:, k], resolution_m) for k in (0, 1)]
    # Gaussian nodes of a cell that contains the edge of a taxel would assign wrong areas to the taxels.
    (point_u, size_u), (point_v, size_v) = (
        (_gauss_nodes if rule == "gauss" and len(ends) > 2 else _midpoints)(ends, resolution_m)
        for ends in stops
    )
    points = np.stack(np.meshgrid(point_u, point_v), axis=-1).reshape(-1, 2)
    sizes = np.stack(np.meshgrid(size_u, size_v), axis=-1).reshape(-1, 2)
    return points, sizes


@lru_cache(maxsize=16)
def _cells(
    layout: TaxelLayout, resolution_m: float, margin_m: float, rule: Rule
) -> tuple[FloatArray, FloatArray, IntArray, int]:
    """Return what patches at all poses share: cells, the taxel of each (N,), and the number of columns."""
    uv, size = patch_cells(layout, resolution_m, margin_m, rule)
    return frozen(uv), frozen(size), frozen(layout.taxel_at(uv)), len(np.unique(uv[:, 0]))


def _border(placed: BoolArray, columns: int) -> BoolArray:
    """Return which cells (N,), row by row, have fewer than four neighbours on the surface."""
    inside: BoolArray = np.pad(placed.reshape(-1, columns), 1)
    whole = inside[:-2, 1:-1] & inside[2:, 1:-1] & inside[1:-1, :-2] & inside[1:-1, 2:]
    return ~whole.ravel()


def _cell_boundaries(taxel_edges: FloatArray, span: FloatArray, resolution_m: float) -> FloatArray:
    """Return cell boundaries along one axis: the edges of the taxels, or only the two ends if those are too many."""
    stops = np.unique(np.concatenate([span, taxel_edges]))
    stops = stops[np.concatenate([[True], np.diff(stops) > _SNAP_M])]
    ends: list[float] = stops.tolist()
    cells = sum(_cells_in(high - low, resolution_m) for low, high in pairwise(ends))
    return span if cells > 2 * _cells_in(span[1] - span[0], resolution_m) else stops


def _midpoints(stops: FloatArray, resolution_m: float) -> tuple[FloatArray, FloatArray]:
    """Return centres and lengths of even cells between stops."""
    ends: list[float] = stops.tolist()
    parts = [
        np.linspace(low, high, _cells_in(high - low, resolution_m), endpoint=False)
        for low, high in pairwise(ends)
    ]
    edges = np.concatenate([*parts, stops[-1:]])
    return (edges[1:] + edges[:-1]) / 2, np.diff(edges)


def _gauss_nodes(stops: FloatArray, resolution_m: float) -> tuple[FloatArray, FloatArray]:
    """Return nodes and weights of Gaussian quadrature between stops.

    There are as many nodes as there would be cells, in groups of two, with one group of three if the number is odd. A
    single node is the centre.
    """
    nodes, weights = list[FloatArray](), list[FloatArray]()
    ends: list[float] = stops.tolist()
    for low, high in pairwise(ends):
        count = _cells_in(high - low, resolution_m)
        groups = [2] * (count // 2)
        if count % 2:
            groups = groups[1:]
            groups.insert(len(groups) // 2, min(count, 3))
        length, at = (high - low) / count, low
        for order in groups:
            node, weight = _NODES[order]
            half = order * length / 2
            nodes.append(at + half * (1 + node))
            weights.append(half * weight)
            at += 2 * half
    return np.concatenate(nodes), np.concatenate(weights)


def _cells_in(length_m: float, resolution_m: float) -> int:
    """Return the number of cells for a length; an excess within rounding does not add a cell."""
    return max(1, int(np.ceil(length_m / resolution_m - 1e-6)))
