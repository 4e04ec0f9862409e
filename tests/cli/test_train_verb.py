"""``skincal train`` and ``skincal eval`` as a user runs them."""

from __future__ import annotations

import json
import shutil
from pathlib import Path

import numpy as np
import pytest
from commands import run
from matplotlib.figure import Figure

pytest.importorskip("stable_baselines3", reason="needs skincal[train]")

from skincal.ranges import Parameter, preset, read_ranges, write_ranges
from skincal.ranges.files import digest
from skincal.train import Description, Network, PolicyKind, Task, read_policy, write_policy

ROUND = 60
"""Steps of a round with one environment."""


def train(out: Path, *arguments: object) -> int:
    return run("train", "marble", "--envs", 1, "--out", out, *arguments)


@pytest.fixture(scope="module")
def trained(tmp_path_factory: pytest.TempPathFactory) -> Path:
    out = tmp_path_factory.mktemp("runs") / "run"
    assert train(out, "--steps", ROUND, "--seed", 4) == 0
    return out


@pytest.fixture
def copied(trained: Path, tmp_path: Path) -> Path:
    """A run that a test may change."""
    return Path(shutil.copytree(trained, tmp_path / "run"))


@pytest.fixture
def no_picture(monkeypatch: pytest.MonkeyPatch) -> None:
    """The curve is drawn for the run of the module."""
    monkeypatch.setattr("skincal.report.evaluation.curves_figure", lambda *_: Figure())


def test_what_a_run_leaves_behind(trained):
    assert {path.name for path in trained.iterdir()} == {
        "run.toml", "ranges.toml", "curve.csv", "curve.png", "checkpoint", "policy.onnx", ".skincal.json",
    }  # fmt: skip
    about = read_policy(trained / "policy.onnx").description
    assert (about.task, about.policy, about.seed, about.steps) == ("marble", "tactile", 4, ROUND)
    assert about.size == 5 * (16 + 6) + 4
    assert about.observation[0] == {"name": "image", "size": 16, "steps_ago": 4}
    assert about.observation[-1] == {"name": "movement", "size": 2, "steps_ago": 0}
    assert about.actions == 6 and len(about.ranges_sha256) == 64 and "stable-baselines3" in about.versions
    assert about.environment["solver_iterations"] == 20 and about.environment["duration_s"] == 6.0


def test_a_run_stays_what_it_is_when_defaults_change(trained, tmp_path, monkeypatch):
    from skincal.envs import MarbleRollEnv, TaskOptions
    from skincal.train import maker, read_run

    monkeypatch.setattr(MarbleRollEnv, "default_options", classmethod(lambda _: TaskOptions(duration_s=1.0)))
    environment = maker(*read_run(trained))()
    assert environment.unwrapped.options == TaskOptions()  # type: ignore[attr-defined]
    environment.close()


@pytest.mark.usefixtures("no_picture")
def test_json_and_going_on(copied, run_json):
    answer = run_json("train", "marble", "--out", copied, "--resume", "--steps", 2 * ROUND)
    assert answer["steps"] == 2 * ROUND
    assert answer["policy"] == str(copied / "policy.onnx")
    assert answer["kind"] == "tactile"
    assert answer["last_error_m"] > 0
    assert len((copied / "curve.csv").read_text().splitlines()) == 3


@pytest.mark.usefixtures("no_picture")
def test_a_run_that_begins_anew_says_so(copied, capsys):
    shutil.rmtree(copied / "checkpoint")
    assert run("train", "marble", "--out", copied, "--resume", "--steps", ROUND) == 0
    assert "no checkpoint; the run starts over at step 0" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (("--resume", "--seed", 5), "expected 4, with which the run began; got 5. Leave it out."),
        (("--resume", "--policy", "desired"), "expected tactile, with which the run began; got desired"),
        ((), "an output that does not exist yet"),
    ],
)
def test_a_run_is_not_overwritten_or_changed(trained, capsys, arguments, said):
    before = (trained / "policy.onnx").read_bytes()
    assert run("train", "marble", "--out", trained, *arguments) == 2
    assert said in capsys.readouterr().err
    assert (trained / "policy.onnx").read_bytes() == before


def test_going_on_with_nothing(tmp_path, capsys):
    assert train(tmp_path / "no", "--resume") == 2
    assert "expected the description of the training run; got no such file" in capsys.readouterr().err


def test_ranges_that_lack_a_parameter(tmp_path, capsys):
    ranges = preset("iros24")
    less = type(ranges)({name: p for name, p in ranges.items() if name != "skin.scale_per_n"})
    write_ranges(less, tmp_path / "less.toml")
    assert train(tmp_path / "run", "--ranges", tmp_path / "less.toml") == 2
    assert "less.toml, [skin.scale_per_n]: expected " in capsys.readouterr().err
    assert not (tmp_path / "run").exists()


@pytest.mark.usefixtures("no_picture")
def test_ranges_of_ones_own_are_kept_with_the_run(tmp_path):
    ranges = preset("iros24").replace({"object.marble.radius_m": Parameter.constant(0.005)})
    write_ranges(ranges, tmp_path / "own.toml")
    assert (
        train(tmp_path / "run", "--ranges", tmp_path / "own.toml", "--steps", ROUND, "--policy", "desired")
        == 0
    )
    assert read_ranges(tmp_path / "run" / "ranges.toml") == ranges
    about = read_policy(tmp_path / "run" / "policy.onnx").description
    assert about.size == 5 * 6 + 4
    assert about.ranges_sha256 == digest(ranges) != digest(preset("iros24"))


def test_evaluation_as_json(trained, tmp_path, run_json):
    """The contract's keys and shapes (section 6)."""
    policy = trained / "policy.onnx"
    out = tmp_path / "evaluation"
    answer = run_json("eval", "marble", policy, policy, "--episodes", 2, "--seed", 1, "--out", out)
    assert answer["task"] == "marble"
    first, second = answer["policies"]
    assert first == second
    assert (first["file"], first["policy"], first["episodes"]) == (str(policy), "tactile", 2)
    assert 0 <= first["drops"] <= 2
    assert first["time_s"] == pytest.approx(0.1 * np.arange(1, 81))
    assert len(first["error_m"]) == 80
    assert {"error_settled_m", "error_end_m"} <= set(first)
    assert first["error_m"][0] < 0.005
    assert {path.name for path in out.iterdir()} == {
        ".skincal.json",
        "eval.json",
        "runs.csv",
        "runs.png",
        "error.png",
    }
    assert json.loads((out / "eval.json").read_text()) == answer


def test_a_film_of_a_run(trained, tmp_path):
    from PIL import Image

    out = tmp_path / "evaluation"
    arguments = ["--episodes", 1, "--duration-s", 0.4, "--out", out, "--gif"]
    assert run("eval", "marble", trained / "policy.onnx", *arguments) == 0
    with Image.open(out / "run.gif") as film:
        assert film.n_frames == 4
        assert film.info["duration"] == 100
        first = np.asarray(film.convert("RGB")).copy()
        film.seek(3)
        assert not np.array_equal(first, np.asarray(film.convert("RGB")))


def test_evaluation_with_values_of_ones_own(trained, tmp_path, run_json):
    policy = trained / "policy.onnx"
    (tmp_path / "still.csv").write_text("u_m,v_m\n0.001,0.0\n")
    answers = []
    for radius in (0.005, 0.007, 0.007):
        options = ["--set", f"object.marble.radius_m={radius}", "--trajectory", tmp_path / "still.csv"]
        answer = run_json("eval", "marble", policy, "--episodes", 1, "--duration-s", 0.5, *options)
        answers.append(answer["policies"][0]["error_m"])
    assert len(answers[0]) == 5
    assert answers[0] != answers[1] == answers[2]


def test_evaluation_of_a_bolt(tmp_path, run_json):
    """A policy that does nothing holds the bolt and rolls it nowhere."""
    part = {"name": "policy", "size": 112}
    about = Description(Task.bolt, PolicyKind.tactile, (part,), 6, "", 0, 0, 0.0, "sb3")
    still = Network.build(np.zeros(112), np.ones(112), 10.0, [(np.zeros((112, 6)), np.zeros(6))])
    write_policy(still, about, tmp_path / "still.onnx")
    answer = run_json("eval", "bolt", tmp_path / "still.onnx", "--episodes", 4, "--duration-s", 0.3)
    (entry,) = answer["policies"]
    assert (entry["direction_right"], entry["held_to_end"], entry["drops"]) == (0.0, 1.0, 0)
    assert entry["held_s"] == pytest.approx(0.3)
    assert entry["angle_error_rad"] < 0.2
    assert list(entry["by_orientation_deg"]) == ["-45", "0", "45", "90"]
    assert set(entry["by_orientation_deg"]["0"]) >= {"direction_right", "held_to_end", "drops"}
    assert entry["by_orientation_deg"]["0"]["episodes"] == 1


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (("marble", "no.onnx"), "no.onnx: expected a policy file"),
        (
            ("marble", "bad.onnx"),
            "bad.onnx: expected a policy written by `skincal train` (.onnx); got no ONNX model",
        ),
        (
            ("marble", "bolt.onnx"),
            "bolt.onnx: expected a policy for marble; got one for bolt. skincal eval bolt",
        ),
        (
            ("marble", "small.onnx"),
            "expected a policy from {size} observed values to 6 actions; got one from 6 to 2",
        ),
        (("marble", "good.onnx", "--gif"), "--gif: expected --out"),
        (("marble", "good.onnx", "--set", "skin.y_m"), "--set: expected NAME=VALUE"),
        (("marble", "good.onnx", "--set", "skin.z_m=1"), "skin.z_m"),
        (("marble", "good.onnx", "--randomize", "skin.z_m"), "skin.z_m"),
        (
            ("marble", "good.onnx", "--trajectory", "no.csv"),
            "--trajectory no.csv: expected circle, random, still",
        ),
        (("pen", "good.onnx"), "marble"),
    ],
)
def test_evaluations_that_cannot_be(trained, tmp_path, monkeypatch, capsys, arguments, said):
    monkeypatch.chdir(tmp_path)
    Path("bad.onnx").write_bytes(b"no policy")
    Path("good.onnx").write_bytes((trained / "policy.onnx").read_bytes())
    for name, task in (("bolt.onnx", Task.bolt), ("small.onnx", Task.marble)):
        layers = [(np.ones((6, 2)), np.zeros(2))]
        about = Description(
            task, PolicyKind.tactile, ({"name": "policy", "size": 6},), 2, "", 0, 0, 0.0, "sb3"
        )
        write_policy(Network.build(np.zeros(6), np.ones(6), 10.0, layers), about, name)
    assert run("eval", *arguments, "--episodes", 1) == 2
    shown, said_so = capsys.readouterr()
    assert said.format(size=read_policy(trained / "policy.onnx").description.size) in said_so
    assert not shown
