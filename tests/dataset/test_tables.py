"""Presses and frames as data frames, and back."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from skincal.dataset import PHASES, Frames, Presses
from skincal.dataset.joined import join_sessions
from tests.dataset.changes import with_presses


@pytest.fixture
def data(session):
    notes, rows = np.array(["a", "", "b", "c"], dtype=object), np.arange(4)
    columns = {"note": notes, "seen": rows > 1, "temperature_c": rows + 20.5}
    normals = np.tile([0.0, 0.0, 1.0], (4, 1))
    return with_presses(session(4, frames_per_press=6), columns=columns, normals=normals)


def test_presses_come_back_from_a_data_frame(data):
    taxels = data.meta.sensor.taxel_columns()
    table = data.presses.to_pandas(taxels)
    assert [*table][:5] == ["press", "x_m", "y_m", "z_m", "force_n"]
    others = {"nx", "ny", "nz", "note", "seen", "temperature_c"}
    assert set(table) == {*taxels, "press", "x_m", "y_m", "z_m", "force_n", *others}
    again = Presses.of_pandas(table, taxels)
    for name in ("press", "position_m", "force_n", "counts", "normals"):
        np.testing.assert_array_equal(getattr(again, name), getattr(data.presses, name))
    for name, column in data.presses.columns.items():
        assert again.columns[name].dtype == column.dtype
        np.testing.assert_array_equal(again.columns[name], column)


def test_frames_come_back_from_a_data_frame(data):
    taxels = data.meta.sensor.taxel_columns()
    table = data.frames.to_pandas(taxels)
    assert set(table["phase"]) <= set(PHASES)
    again = Frames.of_pandas(table, taxels)
    for name in ("press", "phase", "time_s", "force_n", "position_m", "counts"):
        np.testing.assert_array_equal(getattr(again, name), getattr(data.frames, name))


def test_presses_without_normals_have_none(data):
    taxels = data.meta.sensor.taxel_columns()
    presses = replace(data.presses, normals=None)
    assert Presses.of_pandas(presses.to_pandas(taxels), taxels).normals is None


def test_truth_values_of_one_session_are_numbers_in_both(data):
    both = join_sessions(with_presses(data, columns={}), data)
    np.testing.assert_array_equal(both.presses.columns["seen"], [*[np.nan] * 4, 0.0, 0.0, 1.0, 1.0])


def test_frames_know_the_row_of_their_press(data):
    order = np.array([2, 0, 3, 1])
    shuffled = replace(data, presses=data.presses.select(order))
    row = shuffled.frame_presses()
    own = data.frames.press >= 0
    np.testing.assert_array_equal(shuffled.presses.press[row[own]], data.frames.press[own])
    assert (row[~own] == -1).all()
    fewer = replace(data, presses=data.presses.select([1, 2]))
    assert set(fewer.frame_presses()[data.frames.press == data.presses.press[0]].tolist()) == {-1}
    none = replace(data, presses=data.presses.select([False] * 4))
    assert set(none.frame_presses().tolist()) == {-1}
