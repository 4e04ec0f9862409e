"""Style of figures: fonts, colours, legends, maps of the taxels, and saving.

Figures are objects without a window or global state (no pyplot), so that they can be made anywhere, in tests and
on machines without a display.
"""

from __future__ import annotations

import io
from collections.abc import Callable, Generator
from contextlib import contextmanager
from functools import lru_cache, wraps
from pathlib import Path
from typing import Any, ParamSpec

import matplotlib as mpl
import numpy as np
from matplotlib import font_manager
from matplotlib.axes import Axes
from matplotlib.axis import Axis
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.collections import PolyCollection
from matplotlib.colors import Normalize
from matplotlib.figure import Figure
from matplotlib.patches import Rectangle
from matplotlib.text import Text
from matplotlib.ticker import FuncFormatter, LogLocator, NullLocator
from numpy.typing import NDArray

from skincal.errors import input_error
from skincal.files import whole_file
from skincal.model import TaxelLayout
from skincal.model.arrays import BoolArray, FloatArray
from skincal.units import in_unit

Given = ParamSpec("Given")

BLUE, ORANGE, GREEN, RED, PURPLE, GREY, BLACK = (
    "#0072B2", "#E69F00", "#009E73", "#D55E00", "#CC79A7", "#8A8A8A", "#222222",
)  # fmt: skip
"""Okabe and Ito's colours, which people with any colour vision can distinguish."""

SEVERAL = (BLUE, RED, GREEN, ORANGE, PURPLE, GREY)
"""Colours of policies or runs, in this order."""

OPEN: Any = {"markerfacecolor": "none", "markeredgecolor": RED, "markeredgewidth": 1.5}
"""Look of a mark for the best point."""

BAD: Any = {"markerfacecolor": "white", "markeredgecolor": RED, "markeredgewidth": 1.3}
"""Look of a mark for a press that matches badly."""

LIGHT = "#E8E8E8"
SEQUENTIAL = "viridis"
DIVERGING = "RdBu_r"

SUFFIXES = (".png", ".pdf", ".svg")
DPI = 150

_WIDE_FONTS = (
    "Noto Sans CJK SC", "Noto Sans CJK JP", "Noto Sans SC", "Source Han Sans SC", "WenQuanYi Micro Hei",
    "WenQuanYi Zen Hei", "Microsoft YaHei", "SimHei", "PingFang SC", "Hiragino Sans", "Yu Gothic", "Malgun Gothic",
    "Arial Unicode MS",
)  # fmt: skip
"""Fonts with Chinese, Japanese or Korean letters that are common on one system or another."""

_UNKNOWN = "\N{WHITE SQUARE}"

_RC: Any = {
    "font.size": 9,
    "axes.titlesize": 10,
    "axes.titleweight": "bold",
    "axes.titlelocation": "left",
    "axes.labelsize": 9,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.edgecolor": GREY,
    "axes.labelcolor": BLACK,
    "axes.axisbelow": True,
    "xtick.color": BLACK,
    "ytick.color": BLACK,
    "xtick.labelsize": 8,
    "ytick.labelsize": 8,
    "legend.frameon": False,
    "legend.fontsize": 8,
    "grid.color": LIGHT,
    "grid.linewidth": 0.8,
    "image.interpolation": "nearest",
    "svg.hashsalt": "skincal",
}


@contextmanager
def style() -> Generator[None]:
    """Give figures and axes that are made within this context skincal's style, whatever a ``matplotlibrc`` says."""
    with mpl.rc_context():
        mpl.rcdefaults()
        mpl.rcParams.update({**_RC, "font.family": _families()})
        yield


def styled(draw: Callable[Given, Figure]) -> Callable[Given, Figure]:
    """Give the figures of a function skincal's style."""

    @wraps(draw)
    def drawn(*args: Given.args, **named: Given.kwargs) -> Figure:
        with style():
            return draw(*args, **named)

    return drawn


def new_figure(width_in: float, height_in: float, title: str = "") -> Figure:
    """Return an empty figure that lays its axes out without overlaps. Make it within :func:`style`."""
    figure = Figure(figsize=(width_in, height_in), layout="constrained")
    if title:
        figure.suptitle(as_it_is(title), x=0.01, ha="left", fontsize=12, fontweight="bold")
    return figure


@lru_cache(maxsize=1)
def _families() -> list[str]:
    """Return the default font, followed by installed fonts with letters that it lacks."""
    installed = {font.name for font in font_manager.fontManager.ttflist}
    return [*mpl.rcParamsDefault["font.sans-serif"][:1], *(name for name in _WIDE_FONTS if name in installed)]


@lru_cache(maxsize=1)
def _letters() -> frozenset[int]:
    fonts = [font_manager.get_font(font_manager.findfont(name)) for name in _families()]
    return frozenset[int]().union(*(font.get_charmap() for font in fonts))


def as_it_is(text: str) -> str:
    """Return a user's name for a figure: letters that no font has become boxes, and dollars start no formula."""
    letters = (letter if ord(letter) in _letters() else _UNKNOWN for letter in text)
    return "".join(letters).replace("$", r"\$")


def legend_below(axes: Axes, columns: int, below: float = 0.1, **more: Any) -> None:
    """Put the legend under the axes, so far below as a part of their height."""
    axes.legend(loc="upper left", bbox_to_anchor=(0.0, -below), borderaxespad=0.0, ncols=columns, **more)


def equal_axes_mm(axes: Axes, x_label: str, y_label: str) -> None:
    """Set up axes over lengths in millimetres with equal scales; the limits widen to fill the space."""
    axes.set_aspect("equal", adjustable="datalim")
    axes.set(xlabel=f"{x_label} [mm]", ylabel=f"{y_label} [mm]")


def log_scale(axes: Axes, along: str) -> None:
    """Make one axis logarithmic, with few ticks."""
    axes.set(**{f"{along}scale": "log"})
    few_logarithmic_ticks(axes.xaxis if along == "x" else axes.yaxis)


def few_logarithmic_ticks(axis: Axis) -> None:
    """Put ticks at 1, 2 and 5 of every decade of a logarithmic axis, as plain numbers."""
    axis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0)))
    axis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
    axis.set_minor_locator(NullLocator())


def checked_suffix(path: Path) -> Path:
    """Return the path of a figure after checking its suffix.

    Raises:
        InputError: the suffix is not supported.
    """
    if path.suffix.lower() not in SUFFIXES:
        raise input_error(str(path), f"a picture's name in {', '.join(SUFFIXES)}", f'"{path.suffix}"')
    return path


def relabel(figure: Figure, unit: str | None) -> None:
    """Put the unit of the taxel values in the place of counts in all texts of a figure; None: counts."""
    if unit is not None:
        for text in figure.findobj(Text):
            text.set_text(in_unit(text.get_text(), as_it_is(unit)))  # pyright: ignore[reportAttributeAccessIssue]


PICTURE_MARK = "atplotlib"
"""Text near the beginning or end of every figure, whatever its format."""


def save(figure: Figure, path: str | Path) -> None:
    """Write a figure without a date, so that the same figure gives the same bytes."""
    suffix = Path(path).suffix.lower()
    dates = {".svg": {"Date": None}, ".pdf": {"CreationDate": None}}
    with style():
        figure.savefig(path, dpi=DPI, metadata=dates.get(suffix))


def save_whole(figure: Figure, path: Path, *, force: bool) -> None:
    """Write a figure that appears complete or not at all, and replaces only an earlier figure."""
    with whole_file(path, force=force, mark=PICTURE_MARK) as temporary:
        save(figure, temporary)


def png_bytes(figure: Figure) -> bytes:
    """Return a figure as the bytes of a PNG, for a self-contained page."""
    buffer = io.BytesIO()
    with style():
        # `savefig` would draw all of it to lay it out, and then again.
        figure.set_dpi(DPI)
        lay_out(figure)
        # A tenth to a fifth larger than at zlib's usual level, and sooner.
        FigureCanvasAgg(figure).print_png(buffer, pil_kwargs={"compress_level": 3})
    return buffer.getvalue()


def lay_out(figure: Figure) -> None:
    """Give the axes of a figure their places and limits, once and for all."""
    layout = figure.get_layout_engine()
    if layout is not None and figure.axes:
        layout.execute(figure)
        figure.set_layout_engine("none")


MOST_LABELLED = 36
"""Largest number of taxels whose values are written on them."""

CORNERS = np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]])

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
    """Draw taxels as coloured boxes [mm], with their values (J,) if there are not too many; light grey for NaN."""
    centres, half = 1e3 * layout.centres_m, 1e3 * layout.sizes_m / 2
    corners = centres[:, None] + half[:, None] * CORNERS
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
    dark = np.dot(mpl.colormaps[colours](share)[:3], LUMA) < 0.5
    digits = 2 if abs(value) < 10 else 1 if abs(value) < 100 else 0
    # Adding zero turns a rounded −0.00 into 0.00.
    text = f"{round(float(value), digits) + 0.0:.{digits}f}"
    text, colour = text.replace("-", "−"), "white" if dark else BLACK
    look: Any = {"ha": "center", "va": "center", "fontsize": 7, "color": colour}
    axes.text(centre[0], centre[1], text, **look, in_layout=False)
