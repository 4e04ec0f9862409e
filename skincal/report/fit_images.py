"""Measured and simulated images, press by press, with taxels at their places; which presses to show."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Any

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.cm import ScalarMappable
from matplotlib.collections import PolyCollection
from matplotlib.colors import Normalize
from matplotlib.figure import Figure
from matplotlib.patches import Rectangle

from skincal.calibrate.assemble import calibration_of
from skincal.calibration import Provenance
from skincal.dataset import Dataset
from skincal.fitting.problem import USED
from skincal.fitting.result import FitResult
from skincal.fitting.types import Floats
from skincal.model import TaxelLayout
from skincal.model.arrays import IntArray
from skincal.prediction.holds import place_presses
from skincal.prediction.touches import CalibratedSkin, Touches
from skincal.report.style import BLACK, CORNERS, DIVERGING, GREEN, GREY, RED, new_figure, styled

ALL_UP_TO = 48
"""Up to this number, all presses are shown; of more, some of the worst, of the best and from between."""

COLUMNS = 4
COLOURS = "YlGnBu"
"""Colour map whose light end is zero, as most taxels of a press read nothing."""

UNREAD = "#D0D0D0"


@styled
def images_figure(result: FitResult, dataset: Dataset) -> Figure:
    """Draw three maps per press: the measured image, the simulated one at the best point, and the difference.

    The worst presses come first, preceded by those that were left out as outliers; green frames mark good matches, red
    frames bad ones.
    """
    chosen = chosen_presses(result.presses.rmse_counts, ALL_UP_TO)
    used = used_presses(result, chosen)
    presses = left_out(result, dataset) + used
    shown = [(press.observed, press.simulated, press.simulated - press.observed) for press in presses]
    tiles = _Tiles.of(result.problem.rig.layout, len(presses))
    counts = Normalize(0.0, max((float(np.nanmax(images[:2])) for images in shown), default=1.0))
    # Outliers do not set this scale: nothing else would be visible next to them.
    clear = shown[len(presses) - len(used) :]
    most = max((float(np.nanmax(np.abs(images[2]), initial=0.0)) for images in clear), default=0.1)
    differences = Normalize(-max(most, 0.1), max(most, 0.1))
    count = len(result.problem)
    part = f"{len(chosen)} of {count} presses" if len(chosen) < count else "all presses used"
    figure = new_figure(*tiles.size_in, f"Measured | simulated | simulated − measured ({part}, worst first)")
    grid = figure.add_gridspec(2, 2, height_ratios=(0.12, tiles.size_in[1] - 0.12), hspace=0.02)
    axes = figure.add_subplot(grid[1, :])
    for numbers, norm, colours in (((0, 1), counts, COLOURS), ((2,), differences, DIVERGING)):
        maps = [(place, number) for place in range(len(presses)) for number in numbers]
        values = [shown[place][number] for place, number in maps]
        axes.add_collection(tiles.maps(maps, values, norm, colours), autolim=False)
    for place, press in enumerate(presses):
        words = f"press {dataset.presses.press[press.row]}, {dataset.presses.force_n[press.row]:.3g} N"
        _frame(axes, tiles, place, press, words)
    axes.set(xlim=(0, tiles.width), ylim=(-tiles.height, 0))
    axes.set_aspect("equal", anchor="N")
    axes.set_axis_off()
    for column, norm, colours, label in (
        (0, counts, COLOURS, "measured and simulated: value above rest [counts]"),
        (1, differences, DIVERGING, "simulated − measured [counts]"),
    ):
        bar = figure.add_subplot(grid[0, column])
        figure.colorbar(ScalarMappable(norm, colours), cax=bar, orientation="horizontal", label=label)
    return figure


@dataclass(frozen=True, eq=False)
class _Tiles:
    """Layout of the figure: one tile per press, with three maps in it; the unit is the longer side of a map.

    ``corners`` (J, 4, 2) are those of the taxels in a map.
    """

    corners: Floats
    map_width: float
    map_height: float
    tile_width: float
    width: float
    height: float

    GAP, TITLE, BETWEEN = 0.2, 0.3, 0.32

    @classmethod
    def of(cls, layout: TaxelLayout, presses: int) -> _Tiles:
        low, high = layout.bounds_m
        unit = float((high - low).max())
        at, half = (layout.centres_m - low) / unit, layout.sizes_m / unit / 2
        corners = at[:, None] + half[:, None] * CORNERS
        (width, height), rows = ((high - low) / unit).tolist(), max(1, math.ceil(presses / COLUMNS))
        tile = 3 * width + 2 * cls.GAP
        all_width = COLUMNS * tile + (COLUMNS + 1) * cls.BETWEEN
        all_height = rows * (height + cls.TITLE + cls.BETWEEN) + cls.BETWEEN
        return cls(corners, width, height, tile, all_width, all_height)

    @property
    def size_in(self) -> tuple[float, float]:
        """Size of the figure with its title and colour bars."""
        scale = 11.0 / self.width
        return 11.0, max(self.height * scale, 0.8) + 0.85

    def corner(self, place: int) -> tuple[float, float]:
        """Return the lower left corner of a tile's maps."""
        row, column = divmod(place, COLUMNS)
        left = self.BETWEEN + column * (self.tile_width + self.BETWEEN)
        top = self.BETWEEN / 2 + row * (self.map_height + self.TITLE + self.BETWEEN) + self.TITLE
        return left, -(top + self.map_height)

    def maps(
        self, maps: list[tuple[int, int]], values: list[Floats], norm: Normalize, colours: str
    ) -> PolyCollection:
        """Return maps, each a tile and its number there, of one colour scale.

        One rectangle per taxel, u to the right and v up; grey where nothing was read.
        """
        corners: list[Floats] = []
        for place, number in maps:
            left, bottom = self.corner(place)
            corners += list(self.corners + np.array([left + number * (self.map_width + self.GAP), bottom]))
        cmap = mpl.colormaps[colours].with_extremes(bad=UNREAD)
        look = PolyCollection(corners, norm=norm, cmap=cmap, edgecolors=UNREAD, linewidths=0.3)
        look.set_array(np.ma.masked_invalid(np.concatenate([*values, np.empty(0)])))
        return look


def _frame(axes: Axes, tiles: _Tiles, place: int, press: ShownPress, words: str) -> None:
    left, bottom = tiles.corner(place)
    pad, colour, width = 0.07, GREEN if press.good else RED, 1.4 if press.good else 2.6
    corner, size = (left - pad, bottom - pad), (tiles.tile_width + 2 * pad, tiles.map_height + 2 * pad)
    axes.add_patch(Rectangle(corner, *size, fill=False, edgecolor=colour, linewidth=width))
    top, right = bottom + tiles.map_height + pad + 0.05, left + tiles.tile_width + pad
    look: Any = {"fontsize": 7, "va": "bottom", "in_layout": False}
    axes.text(left - pad, top, words, color=BLACK, **look)
    axes.text(right, top, press.mark, color=GREY if press.good else RED, ha="right", **look)


FEW = 30
"""Presses that are shown of a larger number."""

MOST_LEFT_OUT = 8
"""Most presses that were left out to simulate; a larger number are not outliers."""


def chosen_presses(rmse_counts: Floats, most: int) -> IntArray:
    """Return indices of the presses to show, the worst first: all up to ``most``, else :data:`FEW`.

    A third of the few are the worst, a sixth the best, the rest evenly from between. Errors are (K,) [counts].
    """
    order = np.argsort(-rmse_counts, kind="stable")
    count = len(order)
    if count <= most:
        return order
    worst, best = FEW // 3, FEW // 6
    between = np.linspace(worst, count - best - 1, FEW - worst - best).round().astype(np.int64)
    return order[np.concatenate([np.arange(worst), between, np.arange(count - best, count)])]


@dataclass(frozen=True, eq=False)
class ShownPress:
    """The images of a press in a row of the dataset, how it matches in words, and whether it does.

    Observed values (J,) lie above rest, NaN where not read [counts]; simulated ones are those at the best position
    within the slack. ``rmse_counts`` is that of the taxels that were read; for presses of the fit, it is that of the
    counts as the converter gives them, clipping and fitted levels at rest included.
    """

    row: int
    observed: Floats
    simulated: Floats
    rmse_counts: float
    mark: str
    good: bool = False


def used_presses(result: FitResult, chosen: IntArray) -> list[ShownPress]:
    """Return some of the presses that were used, by their index among those."""
    problem, presses = result.problem, result.presses
    observed = np.where(problem.weight > 0, presses.observed, np.nan)
    found: list[ShownPress] = []
    for k in chosen.tolist():
        rmse, good = float(presses.rmse_counts[k]), bool(presses.good[k])
        mark = f"rmse {rmse:.2g}" if good else f"bad: rmse {rmse:.2g}"
        found.append(ShownPress(int(problem.rows[k]), observed[k], presses.simulated[k], rmse, mark, good))
    return found


def left_out(result: FitResult, dataset: Dataset) -> list[ShownPress]:
    """Return presses, the worst first, that were left out although enough taxels were active."""
    problem = result.problem
    least = int(problem.active[problem.rows].min(initial=len(problem.active)))
    known = np.isfinite(dataset.presses.position_m).all(axis=1) & (dataset.presses.force_n > 0)
    unused = np.array([status != USED for status in problem.status])
    rows = np.flatnonzero(unused & known & (problem.active >= least))[:MOST_LEFT_OUT]
    if not len(rows):
        return []
    on = CalibratedSkin.of(calibration_of(result, dataset, Provenance("")), dataset)
    values = np.where(result.dead_taxels, np.nan, problem.observed.values)
    slack_m = place_presses(on, dataset, replace(problem.observed, values=values), rows).slack_m
    simulated = Touches.of_presses(on, dataset).select(rows).moved(slack_m).values()
    rmse = np.sqrt(np.nanmean((simulated - values[rows]) ** 2, axis=1))
    found = [
        ShownPress(row, values[row], image, error, f"left out: rmse {error:.2g}")
        for row, image, error in zip(rows.tolist(), simulated, rmse.tolist(), strict=True)
    ]
    return sorted(found, key=lambda press: -press.rmse_counts)
