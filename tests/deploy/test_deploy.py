"""A policy on a reference hand: it rolls, it stops on what is odd, and its record is a session."""

from __future__ import annotations

import errno
import json
import os
import tempfile
from dataclasses import replace
from pathlib import Path

import numpy as np
import onnx
import pytest
from commands import run

from benchmarks.remote_cost import Clock, Link
from skincal.dataset import HOLD, read_dataset
from skincal.deploy import deploy, letters, marble_targets, record
from skincal.deploy.policy_run import PolicyObservation
from skincal.deploy.record import read_run_file
from skincal.envs.pinch import read_pinch
from skincal.envs.reference_hand import ReferenceHand
from skincal.errors import InputError, WorkError
from skincal.hand.driver import HandState
from skincal.hand.errors import HandError
from skincal.hand.registry import create_driver
from skincal.train import Policy, policy_path, read_policy

WIDTH = {"object_width_m": 0.012, "speed_rad_per_s": 0.3}


@pytest.fixture(scope="module")
def policy() -> Policy:
    return read_policy(policy_path("marble-tactile-1"))


class Blind(ReferenceHand):
    """A hand whose taxels do not answer."""

    def observe(self) -> HandState:
        state = super().observe()
        return replace(state, taxels=np.full_like(state.taxels, np.nan))


class Jumping(ReferenceHand):
    """A hand whose clock jumps while the policy acts."""

    def observe(self) -> HandState:
        state = super().observe()
        return replace(state, time_s=state.time_s + (0.4 if state.time_s > 2.0 else 0.0))


class Empty(ReferenceHand):
    """A hand whose object is taken away before it closes."""

    def connect(self) -> None:
        super().connect()
        scene = self._connected
        scene.release()
        scene.engine.resetBasePositionAndOrientation(scene.body, [1, 1, 1], [0, 0, 0, 1])


def test_marble_is_rolled(policy: Policy) -> None:
    found = deploy(policy, ReferenceHand(seed=1), read_pinch(None), marble_targets("still", 3.0), **WIDTH)
    assert found.lost_s is None and found.steps == 30
    assert np.nanmean(found.error_m[15:]) < 1e-3
    assert found.jitter_s < 1e-6
    assert 0.5 < found.record.grip_n[found.record.acting :].mean() < 4.0
    assert found.record.phases[-1] == "letting go"


def test_a_slow_and_lossy_link_is_borne(policy: Policy) -> None:
    """Messages that take 20 ms, of which one in a hundred is lost: later steps, but no stop and no drop."""
    link = Link(ReferenceHand(seed=1), 0.02, 0.01, seed=3)
    found = deploy(
        policy, link, read_pinch(None), marble_targets("still", 3.0), clock=link.clock.monotonic, **WIDTH
    )
    assert found.lost_s is None and found.steps == 30
    assert np.nanmean(found.error_m[15:]) < 1.5e-3
    assert 0.01 < found.jitter_s < 0.1
    apart = np.diff([state.time_s for state in found.record.states])
    assert 0.08 <= np.median(apart) < 0.1 < apart.max()


def test_a_reference_hand_keeps_pace_with_a_clock() -> None:
    hand, clock = ReferenceHand(seed=1), Clock()
    hand.clock = clock
    hand.connect()
    assert hand.observe().time_s == pytest.approx(0.01) == clock.now_s
    clock.sleep(0.055)
    assert hand.observe().time_s == pytest.approx(0.06)
    hand.close()


@pytest.mark.parametrize("seed", [1570558271])
def test_fingers_that_close_do_not_press_hard(policy: Policy, seed: int) -> None:
    """Of a hand whose thumb is stiff along its normal, what the drives lag behind presses on the object."""
    found = deploy(policy, ReferenceHand(seed=seed), read_pinch(None), marble_targets("still", 0.3), **WIDTH)
    assert found.lost_s is None


def test_what_is_odd_stops_the_hand(policy: Policy) -> None:
    pinch, targets = read_pinch(None), marble_targets("still", 3.0)
    with pytest.raises(InputError, match="expected 16 taxels, for a tactile policy"):
        deploy(policy, Blind(seed=1), pinch, targets, **WIDTH)
    with pytest.raises((WorkError, HandError), match="stopped"):
        deploy(policy, Jumping(seed=1), pinch, targets, **WIDTH)
    with pytest.raises(WorkError, match="got none"):
        deploy(policy, Empty(seed=1), pinch, targets, **WIDTH)


def test_observation_is_stacked_as_described(policy: Policy) -> None:
    parts = [{"name": "desired", "size": 2, "steps_ago": 1}, {"name": "desired", "size": 2, "steps_ago": 0}]
    seen = PolicyObservation(parts, {"desired": 2}, "p.onnx")
    assert seen.next({"desired": [1, 2]}).tolist() == [1, 2, 1, 2]
    assert seen.next({"desired": [3, np.nan]}).tolist() == [1, 2, 3, 0]
    with pytest.raises(InputError, match="another hand or task"):
        PolicyObservation(
            policy.description.observation, {"image": 9, "desired": 6, "target": 2, "movement": 2}, "p"
        )


def test_letters_stay_on_the_patch() -> None:
    way = letters("dlr")
    assert len(way) > 320 and np.abs(way).max() <= 5e-3
    assert np.linalg.norm(np.diff(way, axis=0), axis=1).max() < 3e-4
    with pytest.raises(InputError, match="letters A to Z"):
        letters("12")


def hold_still(out: Path, *more: str) -> int:
    """Runs the command that holds the marble still for a second; returns its exit status."""
    command = ("deploy", "marble", "marble-tactile-1", "--trajectory", "still", "--duration-s", 1)
    return run(*command, "--out", out, *more)


def test_verb_writes_a_session_that_replays(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    out = tmp_path / "rolled"
    assert hold_still(out, "--effect", "hysteresis=1", "--json") == 0
    told = json.loads(capsys.readouterr().out)
    assert told["held"] and told["steps"] == 10
    assert (out / "run.png").is_file() and (out / "deploy.json").is_file()
    assert run("dataset", "check", out / "session") == 0
    replay = create_driver("replay", dataset=str(out / "session"))
    replay.connect()
    assert np.isfinite(replay.observe().q_rad).all()


@pytest.mark.usefixtures("no_picture")
@pytest.mark.parametrize(
    ("act", "status", "said"),
    [
        ("interrupt", 130, "interrupted. The hand was stopped."),
        ("nan", 1, "ended early. The hand was stopped."),
    ],
)
def test_a_run_that_ends_early_is_kept(
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
    act: str,
    status: int,
    said: str,
) -> None:
    out, acts, steps = tmp_path / "rolled", Policy.__call__, iter(range(100))

    def ends(self: Policy, observation: np.ndarray) -> np.ndarray:
        if next(steps) < 4:
            return acts(self, observation)
        if act == "interrupt":
            raise KeyboardInterrupt
        return np.full(6, np.nan)

    monkeypatch.setattr(Policy, "__call__", ends)
    assert hold_still(out) == status
    err = capsys.readouterr().err
    assert f"{said} The run so far is saved in {out / 'session'}." in err
    assert ("finite actions" in err) == (act == "nan")
    kept = json.loads((out / "deploy.json").read_text())
    assert kept["finished"] is False and kept["steps"] == 4
    found = read_dataset(out / "session").frames
    assert found is not None and (found.phase == HOLD).sum() == 40
    assert [p.name for p in tmp_path.iterdir()] == ["rolled"]
    with pytest.raises(InputError, match="ended early"):
        read_run_file(out)


def full(*_: object, **more: object) -> None:
    raise OSError(errno.ENOSPC, "No space left on device")


def test_a_disk_without_room_is_reported_before_the_hand_moves(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    connected: list[ReferenceHand] = []
    monkeypatch.setattr(ReferenceHand, "connect", connected.append)
    monkeypatch.setattr(os, "fsync", full)
    assert hold_still(tmp_path / "rolled") == 1 and not connected
    err = capsys.readouterr().err
    assert f"{tmp_path / 'rolled'}: No space left on device. Free some space" in err and "ended" not in err
    assert not [*tmp_path.iterdir()]


@pytest.mark.usefixtures("no_picture")
def test_a_run_that_finds_the_disk_full_is_kept_elsewhere(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    out, elsewhere, write = tmp_path / "full" / "rolled", tmp_path / "elsewhere", record.write_dataset
    for folder in (out.parent, elsewhere):
        folder.mkdir()
    monkeypatch.setattr(tempfile, "tempdir", str(elsewhere))
    monkeypatch.setattr(
        record,
        "write_dataset",
        lambda data, path: (full if out.parent in path.parents else write)(data, path),
    )
    assert hold_still(out) == 1
    err = capsys.readouterr().err
    (kept,) = elsewhere.glob("*/rolled")
    assert "No space left on device" in err
    assert f"The hand was stopped. The run so far is saved in {kept / 'session'}." in err
    assert json.loads((kept / "deploy.json").read_text())["steps"] == 10
    assert read_dataset(kept / "session").frames is not None
    assert not [*out.parent.iterdir()]


def test_an_interrupt_while_the_picture_is_drawn_loses_nothing(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    def interrupt(*_: object, **more: object) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr("skincal.report.hand.deploy_figure", interrupt)
    out = tmp_path / "rolled"
    assert hold_still(out) == 130
    assert "The run so far is saved" in capsys.readouterr().err
    assert json.loads((out / "deploy.json").read_text())["steps"] == 10


def test_verb_refuses_a_policy_of_another_task(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert run("deploy", "bolt", "marble-tactile-1", "--out", tmp_path / "x") == 2
    assert "expected a policy for bolt" in capsys.readouterr().err


@pytest.mark.parametrize("speed", [50.0, 0.0, -0.3, "fast"])
def test_verb_refuses_a_policy_that_is_faster_than_the_hand(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], speed: object
) -> None:
    model = onnx.load(policy_path("marble-desired-1"))
    (told,) = [p for p in model.metadata_props if p.key == "skincal"]
    told.value = json.dumps({**json.loads(told.value), "environment": {"speed_rad_per_s": speed}})
    onnx.save(model, tmp_path / "p.onnx")
    command = ("deploy", "marble", tmp_path / "p.onnx", "--driver", "reference")
    assert run(*command, "--out", tmp_path / "o") == 2
    assert f"got one of {speed} rad/s" in capsys.readouterr().err


def test_a_driver_of_another_hand_is_refused(policy: Policy) -> None:
    """Limits, forces and the order of the joints would be those of the wrong hand."""
    own = ReferenceHand(seed=1).description
    others = {
        "max_force_n": replace(own, max_force_n=0.6),
        "limits.upper_rad": replace(own, limits=replace(own.limits, upper_rad=own.limits.upper_rad - 1e-9)),
        "joints": replace(own, joints=own.joints[::-1]),
        "digest": replace(own, digest="00" * 32),
    }
    for name, other in others.items():

        class Other(ReferenceHand):
            description = other

            def connect(self) -> None:
                raise AssertionError("connected")

        with pytest.raises(InputError, match=rf"other values of {name}\. .*--hand FOLDER"):
            deploy(policy, Other(seed=1), read_pinch(None), marble_targets("still", 3.0), **WIDTH)
