"""Progress of a session on a terminal."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from hands import other_hand

from skincal.cli import live
from skincal.cli.live import SessionProgress, taxel_image
from skincal.collect import PlannedPress, Progress
from skincal.collect.senses import Senses
from skincal.hand.sim import SimDriver
from skincal.robot import Kinematics


def test_the_image_has_the_sensors_rows_columns_and_range(tmp_path: Path) -> None:
    sensor = SimDriver(hand=str(other_hand(tmp_path))).description.meta.sensor
    assert (sensor.rows, sensor.cols, sensor.value_max) == (3, 5, 4095)
    taxels = np.zeros(15)
    taxels[1], taxels[14] = 4095, np.nan
    lines = taxel_image(taxels, sensor).split("\n")
    assert [len(line.plain) for line in lines[:3]] == [10, 10, 10]
    assert lines[0].plain == " " * 8 + "x "  # row 2 is on top
    assert [str(span.style) for span in lines[2].spans][:2] == ["on rgb(0,40,120)", "on rgb(255,167,35)"]


def test_the_terminal_shows_presses_force_image_and_time_left(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    for name, value in (("FORCE_COLOR", "1"), ("COLORTERM", "truecolor"), ("TERM", "xterm-256color")):
        monkeypatch.setenv(name, value)
    monkeypatch.setattr(live, "EVERY_S", 0.0)
    with SimDriver(hand=str(other_hand(tmp_path))) as driver:
        description = driver.description
        sample = Senses(Kinematics(description), 0.004).sample(driver.observe())
    planned = PlannedPress(0.0, 0.0, 2.5, 0.04, 0.5)
    with SessionProgress(description.meta.sensor) as show:
        for done in (3, 5):
            show(Progress(done, 9, planned, "hold", sample))
    seen = capsys.readouterr().err
    assert "press 6 of 9" in seen and "N of 2.50 N" in seen and "s left" in seen
    assert "48;2;0;40;120" in seen  # a taxel at rest
