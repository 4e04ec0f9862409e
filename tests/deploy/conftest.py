"""Leaves out the picture of a run where a test is not about it."""

from __future__ import annotations

import pytest
from matplotlib.figure import Figure


@pytest.fixture
def no_picture(monkeypatch: pytest.MonkeyPatch) -> None:
    """Drawing takes as long as a second of rolling."""
    monkeypatch.setattr("skincal.report.hand.deploy_figure", lambda *_, **__: Figure())
