"""A command of skincal, run in this process."""

from __future__ import annotations

from functools import partial

import pytest
from commands import Run, captured


@pytest.fixture
def run(capsys: pytest.CaptureFixture[str]) -> Run:
    """Runs a command; returns its exit status, standard output and standard error."""
    return partial(captured, capsys)
