from __future__ import annotations

import os
import time

import pytest

from skincal import compiling
from skincal.calibrate.workers import mapper


def _says(_: int) -> tuple[int, bool]:
    time.sleep(0.05)  # so that both workers get some
    return os.getpid(), compiling.on_compile is compiling.tell


@pytest.mark.parametrize("says", [True, False])
def test_one_worker_says_that_it_compiles(monkeypatch: pytest.MonkeyPatch, says: bool):
    monkeypatch.setattr(compiling, "on_compile", compiling.tell if says else None)
    with mapper(2) as spread:
        found = set(spread(_says, range(12)))
    assert len(found) == 2
    assert sum(told for _, told in found) == says


def test_note_goes_to_standard_error(capsys: pytest.CaptureFixture[str]):
    compiling.tell()
    assert capsys.readouterr().err == f"{compiling.NOTE}\n"
