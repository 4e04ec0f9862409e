"""Names beside points: none on top of another, and it is known how many found no room."""

from __future__ import annotations

from itertools import combinations

import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.text import Annotation, Text

from skincal.report.fit_slack import name_points
from skincal.report.style import new_figure, style


def _named(points: np.ndarray, keep_clear: np.ndarray | None = None) -> tuple[list[Annotation], int, Axes]:
    with style():
        figure = new_figure(5, 5)
        axes = figure.add_subplot()
        axes.set(xlim=(-1, 1), ylim=(-1, 1))
        FigureCanvasAgg(figure).draw()
        left_out = name_points(axes, [str(k) for k in range(len(points))], points, keep_clear=keep_clear)
        FigureCanvasAgg(figure).draw()
    return [t for t in axes.texts if isinstance(t, Annotation)], left_out, axes


def test_labels_of_close_points_do_not_overlap() -> None:
    points = np.random.default_rng(0).normal(0.0, 0.12, (30, 2))
    names, left_out, axes = _named(points)
    assert len(names) + left_out == 30
    assert len(names) > 20
    boxes = [Text.get_window_extent(name).padded(-1.0) for name in names]
    for one, other in combinations(boxes, 2):
        assert not one.overlaps(other)
    dots = axes.transData.transform(points)
    assert not any(box.contains(*dot) for box in boxes for dot in dots)


def test_lone_point_has_label_without_line() -> None:
    (name,), left_out, _ = _named(np.zeros((1, 2)))
    assert left_out == 0
    assert name.arrow_patch is None
    assert np.hypot(*name.xyann) < 15


def test_where_everything_is_taken_a_name_is_left_out() -> None:
    axis = np.linspace(-0.5, 0.5, 60)
    everywhere = np.stack(np.meshgrid(axis, axis), axis=-1).reshape(-1, 2)
    names, left_out, _ = _named(np.zeros((1, 2)), everywhere)
    assert not names
    assert left_out == 1
