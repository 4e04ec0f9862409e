"""Ranges that a task cannot use are refused at once, with the reason."""

from __future__ import annotations

from pathlib import Path

import pytest
from calibrations import on_a_plane

from skincal.envs.needed import ranges_for
from skincal.errors import InputError
from skincal.ranges import from_calibration, write_ranges


@pytest.mark.parametrize("task", ["marble", "bolt"])
def test_ranges_of_a_flat_pad_are_refused_with_the_reason(tmp_path: Path, task):
    write_ranges(from_calibration(on_a_plane()), tmp_path / "ranges.toml")
    with pytest.raises(InputError) as refused:
        ranges_for(task, tmp_path / "ranges.toml")
    assert "flat pad" in str(refused.value)
    assert "ranges.toml" in str(refused.value)
    assert "Add the table" not in str(refused.value)
