"""Two sessions as one: numbered on, on one clock, with the columns of both."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from diagnosis.diagnose_data import moving

from skincal.dataset import read_dataset, write_dataset
from skincal.dataset.joined import join_sessions
from skincal.errors import InputError
from tests.dataset.changes import with_presses, with_sensor


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
