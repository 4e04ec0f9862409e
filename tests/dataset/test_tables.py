"""Presses and frames as data frames, and back; two sessions as one, on one clock, with the columns of both."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from diagnosis.diagnose_data import moving

from skincal.dataset import PHASES, Frames, Presses, read_dataset, write_dataset
from skincal.dataset.dataset import join_sessions
from skincal.errors import InputError
from tests.dataset.changes import with_presses, with_sensor


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


def test_presses_are_numbered_on_and_time_goes_on(tmp_path):
    first, second = moving(4), moving(3)
    both = join_sessions(first, second)
    assert len(both.presses) == 7 and len(set(both.presses.press.tolist())) == 7
    assert both.frames is not None and first.frames is not None and second.frames is not None
    assert len(both.frames) == len(first.frames) + len(second.frames)
    assert (np.diff(both.frames.time_s) > 0).all()
    start = both.presses.column("t_start_s")
    assert start is not None and (np.diff(start) > 0).all()
    own = both.frames.press == both.presses.press[5]
    assert both.frames.force_n[own] == pytest.approx(
        second.frames.force_n[second.frames.press == second.presses.press[1]]
    )
    write_dataset(both, tmp_path / "both")
    again = read_dataset(tmp_path / "both")
    assert len(again.presses) == 7 and again.sha256 is not None


def test_a_later_clock_is_kept():
    first, second = moving(2), moving(2)
    assert first.frames is not None and second.frames is not None
    later = replace(second, frames=replace(second.frames, time_s=second.frames.time_s + 1000))
    columns = {k: v + 1000 if k.startswith("t_") else v for k, v in second.presses.columns.items()}
    both = join_sessions(first, with_presses(later, columns=columns))
    assert both.frames is not None
    assert both.frames.time_s[-1] == second.frames.time_s[-1] + 1000


def test_a_column_of_one_is_empty_in_the_other():
    first, second = moving(2), moving(3)
    more = {"temperature_c": np.full(3, 21.0), "note": np.array(["a", "b", "c"], dtype=object)}
    both = join_sessions(first, with_presses(second, columns={**second.presses.columns, **more}))
    assert np.isnan(both.presses.columns["temperature_c"][:2]).all()
    assert both.presses.columns["temperature_c"][2:].tolist() == [21.0] * 3
    assert both.presses.columns["note"].tolist() == ["", "", "a", "b", "c"]


def test_another_sensor_is_refused():
    first, second = moving(2), moving(2)
    with pytest.raises(InputError, match="sensor"):
        join_sessions(first, with_sensor(second, value_max=77))
    with pytest.raises(InputError, match="frames"):
        join_sessions(first, replace(second, frames=None))
