"""The picture of a dataset can be drawn for every form of data, and shows what it says."""

from __future__ import annotations

import logging
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from skincal.dataset import Dataset, PositionSpec, active_taxels, read_dataset
from skincal.errors import InputError
from skincal.report.dataset import dataset_figure
from skincal.report.style import checked_suffix, new_figure, png_bytes, save, style
from tests.conftest import make_session


def axes_titled(figure: Figure, start: str) -> Axes:
    (found,) = [axes for axes in figure.axes if axes.get_title(loc="left").startswith(start)]
    return found


def drawn(dataset: Dataset, caplog: pytest.LogCaptureFixture) -> Figure:
    """The figure, drawn without a complaint."""
    with caplog.at_level(logging.WARNING), style():
        figure = dataset_figure(dataset)
        figure.draw_without_rendering()
    assert not caplog.records
    return figure


@pytest.fixture(scope="module")
def whole() -> tuple[Dataset, Figure]:
    """Thirty presses and their figure, which has been drawn."""
    dataset = make_session(30)
    figure = dataset_figure(dataset)
    assert png_bytes(figure).startswith(b"\x89PNG")
    return dataset, figure


def test_every_press_and_taxel_is_drawn(whole: tuple[Dataset, Figure]) -> None:
    dataset, figure = whole
    patch = axes_titled(figure, "Presses on the patch")
    (marks,) = patch.collections
    assert len(marks.get_offsets()) == 30
    assert len(patch.patches) == 16
    assert patch.get_xlabel() == "u [mm]"
    assert patch.get_aspect() == 1.0
    colours = sorted(np.asarray(marks.get_array()).tolist())
    assert colours == sorted(active_taxels(dataset).sum(axis=1).tolist())
    area = np.asarray(marks.get_sizes())
    assert (np.diff(area) <= 1e-9).all(), "hard presses first"


def test_answers_and_forces_are_counted(whole: tuple[Dataset, Figure]) -> None:
    dataset, figure = whole
    answers = axes_titled(figure, "Active taxels")
    heights = [bar.get_height() for bar in answers.patches]
    assert heights == np.bincount(active_taxels(dataset).sum(axis=1)).tolist()
    assert sum(bar.get_height() for bar in axes_titled(figure, "Forces").patches) == 30
    (image,) = axes_titled(figure, "Presses per active taxel").images
    np.testing.assert_array_equal(np.asarray(image.get_array()).ravel(), active_taxels(dataset).sum(axis=0))


def without_positions(dataset: Dataset) -> Dataset:
    meta = replace(dataset.meta, position=PositionSpec(np.inf, 0.0))
    nothing = np.full_like(dataset.presses.position_m, np.nan)
    return replace(dataset, meta=meta, presses=replace(dataset.presses, position_m=nothing))


def at_one_place(dataset: Dataset) -> Dataset:
    place = np.tile(dataset.presses.position_m[0], (len(dataset.presses), 1))
    return replace(dataset, presses=replace(dataset.presses, position_m=place))


def one_far_away(dataset: Dataset) -> Dataset:
    points = dataset.presses.position_m.copy()
    points[0, 1] += 0.1
    return replace(dataset, presses=replace(dataset.presses, position_m=points))


def silent(dataset: Dataset) -> Dataset:
    return replace(dataset, presses=replace(dataset.presses, counts=np.zeros_like(dataset.presses.counts)))


def on_branches(dataset: Dataset) -> Dataset:
    branch = np.array(["up", "down", ""], dtype=object)[np.arange(len(dataset.presses)) % 3]
    return replace(
        dataset, presses=replace(dataset.presses, columns={**dataset.presses.columns, "branch": branch})
    )


@pytest.mark.parametrize(
    ("change", "note"),
    [
        (without_positions, "12 presses without a position"),
        (at_one_place, "12 presses at one place"),
        (one_far_away, "1 presses far away are not drawn"),
        (silent, "at its nominal pose"),
        (lambda d: replace(d, presses=d.presses.select([0]), frames=None), "at its nominal pose"),
        (lambda d: replace(d, presses=replace(d.presses, columns={})), "at its nominal pose"),
    ],
)
def test_odd_data_are_drawn_too(
    caplog: pytest.LogCaptureFixture, change: Callable[[Dataset], Dataset], note: str
) -> None:
    figure = drawn(change(make_session()), caplog)
    texts = [text.get_text() for text in axes_titled(figure, "Presses on the patch").texts]
    assert any(note in text for text in texts), texts


def test_branches_are_named(caplog: pytest.LogCaptureFixture) -> None:
    labels = axes_titled(drawn(on_branches(make_session()), caplog), "Session").get_legend_handles_labels()[1]
    assert labels == ["frames with contact", "reached from below", "reached from above", "branch not given"]


def test_titles_and_labels_do_not_overlap(whole: tuple[Dataset, Figure]) -> None:
    boxes = [axes.get_tightbbox() for axes in whole[1].axes if axes.get_title(loc="left")]
    for i, one in enumerate(boxes):
        for other in boxes[i + 1 :]:
            assert not one.padded(-2).overlaps(other.padded(-2))


def test_the_insole_is_drawn(shared: Path, caplog: pytest.LogCaptureFixture) -> None:
    figure = drawn(read_dataset(shared / "real" / "insole"), caplog)
    assert "20" in axes_titled(figure, "Presses per active taxel").get_title(loc="left")


def test_the_same_data_give_the_same_files(tmp_path: Path) -> None:
    """The figure in one format; the others of a plain figure, which is written sooner."""
    for name in ("one", "two"):
        save(dataset_figure(make_session()), tmp_path / f"{name}.svg")
        plain = new_figure(3, 2, "one line")
        plain.subplots().plot([0, 1])
        for suffix in ("png", "pdf"):
            save(plain, tmp_path / f"{name}.{suffix}")
    for suffix in ("png", "pdf", "svg"):
        assert (tmp_path / f"one.{suffix}").read_bytes() == (tmp_path / f"two.{suffix}").read_bytes(), suffix


def test_a_picture_has_a_suffix_that_can_be_written() -> None:
    assert checked_suffix(Path("a.PNG")) == Path("a.PNG")
    with pytest.raises(InputError, match=r"\.png, \.pdf, \.svg"):
        checked_suffix(Path("a.jpg"))
