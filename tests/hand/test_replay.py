"""A recorded session is played as it was recorded."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hand_fakes import tiny_description

from skincal.dataset import Dataset, Frames, Presses, write_dataset
from skincal.errors import InputError
from skincal.hand import replay
from skincal.hand.driver import HandCommand
from skincal.hand.errors import HandError
from skincal.hand.guard import GuardedHand
from skincal.hand.replay import ReplayDriver

FRAMES = 30


@pytest.fixture(autouse=True)
def tiny(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(replay, "hand_named", lambda hand: tiny_description())


def recorded(folder: Path, without: tuple[str, ...] = (), frames: int = FRAMES) -> Path:
    """A session of the tiny hand, written as a dataset."""
    t = 0.02 * np.arange(frames) + 5.0
    columns = {
        "q_0": 0.1 * np.sin(t),
        "q_1": 0.1 * np.cos(t),
        "tau_0": 0.3 * t / 10,
        "tau_1": -0.2 * t / 10,
        "dq_0": np.full(frames, 0.25),
        "dq_1": np.full(frames, -0.25),
        "q_desired_0": 0.1 * np.sin(t) + 0.01,
        "q_desired_1": 0.1 * np.cos(t),
        "taxel_time_s": np.floor(t * 10) / 10,
        "temperature_c": np.full(frames, 31.5),
    }
    images = np.tile(np.arange(4.0), (frames, 1)) + np.arange(frames)[:, None]
    point = np.array([0.0, 0.0235, 0.0115])
    table = Frames(
        press=np.zeros(frames, dtype=int),
        phase=np.full(frames, 2),
        time_s=t,
        force_n=np.ones(frames),
        position_m=np.tile(point, (frames, 1)),
        counts=images,
        columns={name: column for name, column in columns.items() if name not in without},
    )
    presses = Presses([0], point[None], [1.0], np.arange(4.0)[None])
    write_dataset(Dataset(tiny_description().meta, presses, table if frames else None), folder)
    return folder


def test_states_are_those_of_the_record(tmp_path: Path) -> None:
    driver = ReplayDriver(recorded(tmp_path / "run"))
    assert driver.period_s == pytest.approx(0.02)
    with GuardedHand(driver) as hand:
        states = [hand.observe() for _ in range(FRAMES)]
        hand.act(HandCommand(states[-1].q_desired_rad))
    t = np.array([state.time_s for state in states])
    np.testing.assert_allclose(t, 0.02 * np.arange(FRAMES) + 5.0)
    np.testing.assert_allclose([s.q_rad[1] for s in states], 0.1 * np.cos(t))
    np.testing.assert_allclose([s.tau_nm[1] for s in states], -0.02 * t)
    np.testing.assert_allclose([s.dq_rad_per_s for s in states], np.tile([0.25, -0.25], (FRAMES, 1)))
    np.testing.assert_allclose([s.q_desired_rad[0] for s in states], 0.1 * np.sin(t) + 0.01)
    np.testing.assert_allclose([s.taxels[3] for s in states], 3.0 + np.arange(FRAMES))
    np.testing.assert_allclose([s.taxel_time_s[0] for s in states], np.floor(t * 10) / 10)
    assert states[0].temperature_c == 31.5
    ((time_s, command),) = driver.commands
    assert time_s == states[-1].time_s
    np.testing.assert_array_equal(command.q_desired_rad, states[-1].q_desired_rad)


def test_what_was_not_recorded_comes_from_what_was(tmp_path: Path) -> None:
    left_out = ("dq_0", "dq_1", "q_desired_0", "q_desired_1", "taxel_time_s", "temperature_c")
    driver = ReplayDriver(recorded(tmp_path / "run", left_out))
    driver.connect()
    states = [driver.observe() for _ in range(FRAMES)]
    t = np.array([state.time_s for state in states])
    np.testing.assert_allclose([s.dq_rad_per_s[0] for s in states], 0.1 * np.cos(t), atol=2e-3)
    np.testing.assert_array_equal(states[3].q_desired_rad, states[3].q_rad)
    np.testing.assert_array_equal(states[3].taxel_time_s, np.full(4, states[3].time_s))
    assert np.isnan(states[0].temperature_c)


def test_the_end_of_the_record_is_reported(tmp_path: Path) -> None:
    place = recorded(tmp_path / "run")
    with pytest.raises(HandError) as caught, GuardedHand(ReplayDriver(place)) as hand:
        while True:
            hand.observe()
    assert caught.value.kind == "end"
    assert f"{place}: the record ends at 5.58 s, after 30 frames" in str(caught.value)


def test_it_begins_anew_with_every_connection(tmp_path: Path) -> None:
    driver = ReplayDriver(recorded(tmp_path / "run"))
    with pytest.raises(HandError, match=r"observe\(\) before connect"):
        driver.observe()
    times = []
    for _ in range(2):
        with driver:
            times.append(driver.observe().time_s)
    assert times[0] == times[1]


@pytest.mark.parametrize(
    ("without", "frames", "text"),
    [
        (("tau_1",), FRAMES, "expected columns tau_0 to tau_1, one per joint; got tau_0"),
        (
            ("q_0", "q_1", "q_desired_0", "q_desired_1"),
            FRAMES,
            "columns q_0 to q_1, one per joint; got none of them",
        ),
        ((), 0, "expected a dataset with frames, to play them; got none"),
        ((), 1, "expected two frames or more; got 1"),
    ],
)
def test_a_record_that_cannot_be_played(
    tmp_path: Path, without: tuple[str, ...], frames: int, text: str
) -> None:
    with pytest.raises(InputError) as caught:
        ReplayDriver(recorded(tmp_path / "run", without, frames))
    assert text in str(caught.value)


def test_a_record_of_another_hand(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    other = tiny_description()
    meta = replace(other.meta, sensor=replace(other.meta.sensor, rows=5))
    monkeypatch.setattr(replay, "hand_named", lambda hand: replace(other, meta=meta))
    with pytest.raises(InputError, match="expected 10 taxels, as the hand has; got 4"):
        ReplayDriver(recorded(tmp_path / "run"))
