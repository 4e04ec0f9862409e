"""Frames that are too many to be held are read column by column, and say the same."""

from __future__ import annotations

import shutil
from collections.abc import Iterator
from dataclasses import replace

import numpy as np
import pytest

from skincal.dataset import (
    Dataset,
    Frames,
    check_dataset,
    idle_means,
    read_dataset,
    rest_levels,
    table_file,
    write_dataset,
)
from skincal.dataset.plausibility import hold_means
from skincal.errors import InputError
from tests.conftest import make_session


@pytest.fixture(scope="module")
def both(tmp_path_factory: pytest.TempPathFactory) -> Iterator[tuple[Dataset, Dataset]]:
    """The same session, held in memory and not."""
    made, folder = make_session(8, frames_per_press=20), tmp_path_factory.mktemp("large") / "s"
    frames = made.frames
    columns = {
        "q_0": np.arange(len(frames)) * 0.1,
        "pose": np.array(["A", "B"], dtype=object)[frames.press % 2],
    }
    write_dataset(replace(made, frames=replace(frames, columns=columns)), folder)
    held = read_dataset(folder)
    with pytest.MonkeyPatch.context() as patched:
        patched.setattr(table_file, "MOST_CELLS_HELD", 0)
        yield held, read_dataset(folder)


def test_counts_are_read_when_asked_for(both):
    held, stored = both[0], read_dataset(both[1].folder)
    assert "counts" not in vars(stored.frames)
    assert not [w for w in stored.warnings if w not in held.warnings]
    for own, other in zip(held.frames.taxel_columns(), stored.frames.taxel_columns(), strict=True):
        np.testing.assert_array_equal(own, other)
    assert "counts" not in vars(stored.frames)
    np.testing.assert_array_equal(held.frames.counts, stored.frames.counts)
    assert not stored.frames.counts.flags.writeable


def test_other_columns(both):
    held, stored = both
    assert list(held.frames.columns) == list(stored.frames.columns) == ["q_0", "pose"]
    for name in ("q_0", "pose"):
        np.testing.assert_array_equal(held.frames.column(name), stored.frames.column(name))
    assert stored.frames.column("nothing") is None


def test_statistics(both):
    held, stored = both
    np.testing.assert_array_equal(rest_levels(held), rest_levels(stored))
    np.testing.assert_array_equal(idle_means(held), idle_means(stored))
    np.testing.assert_array_equal(
        hold_means(held, held.frames.counts), hold_means(stored, stored.frames.taxel_columns())
    )


def test_rows_are_selected(both):
    held, stored = (data.frames.select(data.frames.phase == 2) for data in both)
    assert isinstance(stored, Frames)
    np.testing.assert_array_equal(held.counts, stored.counts)
    np.testing.assert_array_equal(held.column("q_0"), stored.column("q_0"))


def test_moved_frames_stay_in_their_file(both):
    frames = read_dataset(both[1].folder).frames
    moved = frames.moved(np.zeros_like(frames.position_m), frames.force_n * 2)
    assert "counts" not in vars(moved)
    np.testing.assert_array_equal(moved.force_n, 2 * frames.force_n)
    with pytest.raises(ValueError, match="force_n"):
        frames.moved(frames.position_m, np.zeros(3))


def test_a_file_that_changes_meanwhile(both, tmp_path):
    frames = read_dataset(shutil.copytree(both[1].folder, tmp_path / "s")).frames
    path = tmp_path / "s" / "frames.parquet"
    path.write_bytes(path.read_bytes())
    with pytest.raises(InputError, match="has been replaced"):
        frames.counts  # noqa: B018


@pytest.mark.parametrize("limit", [0, 10**9])
def test_what_is_wrong_is_said_alike(tmp_path, monkeypatch, limit):
    monkeypatch.setattr(table_file, "MOST_CELLS_HELD", limit)
    made = make_session(8, frames_per_press=20)
    counts, force = made.frames.counts.copy(), made.frames.force_n.copy()
    counts[3, 2], counts[5, 7], counts[9, 7], counts[11, 4] = 0.5, 300.0, -1.0, np.nan
    force[4] = np.inf
    columns = {"indenter_radius_m": np.where(np.arange(len(force)) == 6, -1.0, 0.006)}
    write_dataset(
        replace(made, frames=replace(made.frames, counts=counts, force_n=force, columns=columns)),
        tmp_path / "s",
    )
    said = sorted(
        str(problem).removeprefix(f"{tmp_path}/s/frames.parquet, ")
        for problem in check_dataset(tmp_path / "s").errors
    )
    assert [text.partition(":")[0] for text in said] == [
        "column force_n, row 5", "column indenter_radius_m, row 7", "column taxel_0_2, row 4",
        "column taxel_1_3, rows 6, 10",
    ]  # fmt: skip
