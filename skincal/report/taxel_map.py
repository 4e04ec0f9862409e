"""Maps with a value per taxel: taxels at their places on the patch, u to the right, v up."""

from __future__ import annotations

from typing import Any

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import PolyCollection
from matplotlib.colors import Normalize
from matplotlib.patches import Rectangle
from numpy.typing import NDArray

from skincal.model import TaxelLayout
from skincal.model.arrays import BoolArray, FloatArray
from skincal.report.style import BLACK, GREY, LIGHT

MOST_LABELLED = 36
"""Largest number of taxels whose values are written on them."""

LUMA = (0.299, 0.587, 0.114)
"""How light red, green and blue look (ITU-R BT.601)."""


def draw_outlines(axes: Axes, layout: TaxelLayout, edge: str = GREY) -> None:
    """Draw the taxels as light boxes over (u, v) [mm]."""
    for centre, size in zip(1e3 * layout.centres_m, 1e3 * layout.sizes_m, strict=True):
        corner = (float(centre[0] - size[0] / 2), float(centre[1] - size[1] / 2))
        axes.add_patch(Rectangle(corner, *size, facecolor=LIGHT, edgecolor=edge, linewidth=0.6))


def near_patch(uv: NDArray[np.floating[Any]], bounds: FloatArray) -> BoolArray:
    """Return which points (N, 2) lie within a patch's size of the patch; a stray press must not shrink the others."""
    size = float(np.ptp(bounds, axis=0).max())
    return np.asarray((np.abs(uv - bounds.mean(axis=0)) <= 1.5 * size).all(axis=1))


def draw_taxels(
    axes: Axes, layout: TaxelLayout, values: NDArray[np.floating[Any]], norm: Normalize, colours: str
) -> PolyCollection:
    """Draw taxels as coloured boxes [mm], with their values where there are not too many.

    Args:
        axes: axes to draw on.
        layout: layout of the taxels.
        values: (J,) NaN without a value, which is light grey.
        norm: normalisation of the colours.
        colours: name of the colour map.
    """
    centres, half = 1e3 * layout.centres_m, 1e3 * layout.sizes_m / 2
    corners = centres[:, None] + half[:, None] * np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]])
    cmap = mpl.colormaps[colours].with_extremes(bad=LIGHT)
    boxes = PolyCollection(list(corners), norm=norm, cmap=cmap, edgecolors=GREY, linewidths=0.4)
    boxes.set_array(np.ma.masked_invalid(values))
    axes.add_collection(boxes)
    if layout.taxels <= MOST_LABELLED:
        for centre, value in zip(centres, values, strict=True):
            if np.isfinite(value):
                _label(axes, centre, value, float(norm(value)), colours)
    axes.autoscale_view()
    return boxes


def _label(axes: Axes, centre: FloatArray, value: float, share: float, colours: str) -> None:
    """Write a value on a taxel, white on dark colours."""
    dark = np.dot(mpl.colormaps[colours](share)[:3], LUMA) < 0.5
    digits = 2 if abs(value) < 10 else 1 if abs(value) < 100 else 0
    # Adding zero turns a rounded −0.00 into 0.00.
    text = f"{round(float(value), digits) + 0.0:.{digits}f}"
    text, colour = text.replace("-", "−"), "white" if dark else BLACK
    look: Any = {"ha": "center", "va": "center", "fontsize": 7, "color": colour}
    axes.text(centre[0], centre[1], text, **look, in_layout=False)
