"""Set-ups that the tests of the verbs share."""

from __future__ import annotations

from pathlib import Path

import pytest
from calibrations import make_calibration

from skincal.calibration import write_calibration


@pytest.fixture
def cal(tmp_path: Path) -> Path:
    """A calibration on disk."""
    write_calibration(make_calibration(), tmp_path / "cal")
    return tmp_path / "cal"
