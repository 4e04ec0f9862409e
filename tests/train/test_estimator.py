"""Where the marble is, from images."""

from __future__ import annotations

import json
import subprocess
import sys
from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np
import pytest
from commands import run

from skincal.deploy import deploy, marble_targets
from skincal.deploy.estimate import estimate_error_m, estimate_positions
from skincal.deploy.record import Record
from skincal.envs.drawing import ranges_for
from skincal.envs.pinch import read_pinch
from skincal.envs.reference_hand import ReferenceHand
from skincal.errors import InputError
from skincal.hand.driver import HandState
from skincal.ranges import preset, write_ranges
from skincal.train import policy_path, read_policy
from skincal.train.estimator import (
    SPAN_M,
    Estimator,
    Quality,
    _gradient,
    features,
    learn,
    read_estimator,
    write_estimator,
)
from skincal.train.estimator_run import draw_touches, judge, train_estimator
from skincal.train.policy_file import estimator_path

PINCH = read_pinch(None)


@pytest.fixture(scope="module")
def small() -> Estimator:
    return train_estimator(ranges_for("marble", None), PINCH, seed=1, hands=20, epochs=3)


@pytest.fixture(scope="module")
def bundled() -> Estimator:
    return read_estimator(estimator_path("marble-estimator-1"))


def test_the_gradient_is_that_of_the_loss() -> None:
    rng = np.random.default_rng(0)
    parameters = [rng.normal(size=s) for s in ((4, 5), (5, 5), (5, 2), 5, 5, 2)]
    # Small targets near the outputs: the Huber loss is a square there.
    parameters[2] *= 1e-3
    parameters[5] *= 0.0
    x, y = rng.normal(size=(7, 4)), 1e-3 * rng.normal(size=(7, 2))

    def loss() -> float:
        h = np.maximum(np.maximum(x @ parameters[0] + parameters[3], 0) @ parameters[1] + parameters[4], 0)
        return float(((np.tanh(h @ parameters[2] + parameters[5]) - y) ** 2).sum() / 2 / len(x))

    for parameter, gradient in zip(parameters, _gradient(parameters, x, y), strict=True):
        at = (0,) * parameter.ndim
        before, parameter[at] = loss(), parameter[at] + 1e-6
        assert (loss() - before) / 1e-6 == pytest.approx(gradient[at], rel=1e-2, abs=1e-8)
        parameter[at] -= 1e-6


def test_places_are_learned_from_images_that_tell_them() -> None:
    rng = np.random.default_rng(0)
    centres = np.stack(np.meshgrid([-4e-3, 0, 4e-3], [-4e-3, 0, 4e-3]), axis=-1).reshape(-1, 2)

    def images(places: np.ndarray) -> np.ndarray:
        return 80 * np.exp(-((places[:, None] - centres) ** 2).sum(axis=2) / (2 * 3e-3**2))

    places = rng.uniform(-5e-3, 5e-3, (2000, 2))
    network = learn(images(places), places, rng, epochs=20)
    others = rng.uniform(-5e-3, 5e-3, (200, 2))
    found = SPAN_M * network(features(images(others)))
    assert np.median(np.linalg.norm(found - others, axis=1)) < 0.3e-3


def test_touches_are_felt_where_they_are_and_the_same_again() -> None:
    ranges = ranges_for("marble", None)
    one = draw_touches(ranges, PINCH, 3, 20, np.random.default_rng(2))
    again = draw_touches(ranges, PINCH, 3, 20, np.random.default_rng(2))
    np.testing.assert_array_equal(one.images_counts, again.images_counts)
    # 4 taxels of 2.5 mm with a pitch of 4 mm.
    assert one.half_m == pytest.approx([7.25e-3, 7.25e-3])
    # The brightest taxel is near the contact.
    bright = one.layout_centres_m[one.images_counts.argmax(axis=2)]
    assert np.median(np.linalg.norm(bright - one.places_m, axis=2)[one.inside]) < 2.5e-3


def test_bundled_estimator_is_as_good_as_it_says(bundled: Estimator) -> None:
    touches = draw_touches(ranges_for("marble", None), PINCH, 30, 40, np.random.default_rng(99))
    found = judge(bundled, touches, 30)
    assert found.median_m == pytest.approx(bundled.quality.median_m, rel=0.25)
    assert found.median_m < 0.9 * found.centroid_median_m
    np.testing.assert_allclose(bundled(np.full((2, 3, 16), np.nan)).shape, (2, 3, 2))


def test_a_file_is_read_as_it_was_written(small: Estimator, tmp_path: Path) -> None:
    write_estimator(small, tmp_path / "e.npz")
    found, images = read_estimator(tmp_path / "e.npz"), np.random.default_rng(0).uniform(0, 99, (5, 16))
    np.testing.assert_array_equal(found(images), small(images))
    assert found.quality == small.quality and found.seed == 1
    write_estimator(small, tmp_path / "e.npz", force=True)
    (tmp_path / "other.npz").write_bytes(b"mine")
    with pytest.raises(InputError):
        write_estimator(small, tmp_path / "other.npz", force=True)


@pytest.mark.parametrize("content", [b"", b"no archive", b"PK\x03\x04broken"])
def test_other_files_are_refused(content: bytes, tmp_path: Path) -> None:
    (tmp_path / "e.npz").write_bytes(content)
    with pytest.raises(InputError, match="expected an estimator"):
        read_estimator(tmp_path / "e.npz")
    np.savez(tmp_path / "a.npz", about=np.array([{"a": 1}], dtype=object))
    with pytest.raises(InputError, match="expected an estimator"):
        read_estimator(tmp_path / "a.npz")
    with pytest.raises(InputError, match="marble-estimator-1"):
        estimator_path(tmp_path / "none.npz")


def test_a_way_is_estimated_where_something_is_felt(bundled: Estimator) -> None:
    touches = draw_touches(ranges_for("marble", None), PINCH, 1, 30, np.random.default_rng(5))
    images = np.concatenate([np.zeros((5, 16)), touches.images_counts[0]])
    states = tuple(
        HandState(t, *(np.zeros(6),) * 4, taxels=image, taxel_time_s=np.full(16, t))
        for t, image in zip(np.arange(35) / 10, images, strict=True)
    )
    true = np.concatenate([np.full((5, 2), np.nan), touches.places_m[0]])
    record = Record(
        states=states, phases=("closing",) * 5 + ("acting",) * 30, places_m=true, acting=5,
        rest_counts=np.zeros(16), grip_n=np.ones(35),
    )  # fmt: skip
    places = estimate_positions(record, bundled, PINCH, 0.012)
    assert np.isnan(places[:5]).all() and np.isfinite(places[10:]).any()
    error = estimate_error_m(record, places)
    assert error is not None and error < 4e-3
    unseen = replace(record, places_m=np.full((35, 2), np.nan))
    assert estimate_error_m(unseen, places) is None


def test_a_way_follows_commands_late(bundled: Estimator) -> None:
    policy = read_policy(policy_path("marble-tactile-1"))
    found = deploy(
        policy, ReferenceHand(seed=1), PINCH, marble_targets("circle", 8.0),
        object_width_m=0.012, speed_rad_per_s=0.3,
    )  # fmt: skip
    error = estimate_error_m(found.record, estimate_positions(found.record, bundled, PINCH, 0.012))
    assert error is not None and error < 0.52e-3


def test_the_verb(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    from skincal.train import estimator_run

    monkeypatch.setattr(
        estimator_run, "train_estimator", partial(estimator_run.train_estimator, hands=12, epochs=1)
    )
    write_ranges(preset("icra26"), tmp_path / "ranges.toml")
    out = tmp_path / "e.npz"
    assert run("train", "estimator", "--ranges", tmp_path / "ranges.toml", "--out", out, "--json") == 0
    told = json.loads(capsys.readouterr().out)
    assert told["error_median_m"] > 0 and told["images"] > 10 and out.is_file()
    assert run("train", "estimator", "--out", out) == 2
    assert "--force" in capsys.readouterr().err
    assert run("train", "estimator", "--out", tmp_path / "f.npz", "--envs", 2) == 2
    assert "got --envs" in capsys.readouterr().err
    assert run("train", "estimator", "--out", tmp_path / "run") == 2
    assert "ends in .npz" in capsys.readouterr().err
    assert run("deploy", "bolt", "bolt-tactile-1", "--estimator", out, "--out", tmp_path / "x") == 2
    assert "expected the task marble" in capsys.readouterr().err


def test_an_estimator_of_another_sensor_is_refused(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    rng = np.random.default_rng(0)
    network = learn(rng.uniform(0, 50, (200, 9)), rng.uniform(-5e-3, 5e-3, (200, 2)), rng, epochs=1)
    write_estimator(Estimator(network, 9, "", 0, Quality(1, 1e-3, 1e-3, 1e-3)), tmp_path / "nine.npz")
    nine, out = tmp_path / "nine.npz", tmp_path / "x"
    assert run("deploy", "marble", "marble-tactile-1", "--estimator", nine, "--out", out) == 2
    assert "expected 16 taxels; got 9" in capsys.readouterr().err


def test_neither_a_learner_nor_gymnasium_is_needed() -> None:
    code = (
        "import sys; sys.modules.update(dict.fromkeys(('torch', 'stable_baselines3', 'gymnasium')));"
        "import skincal.train.estimator_run, skincal.deploy.estimate, skincal.deploy.wear"
    )
    assert subprocess.run([sys.executable, "-c", code], check=False).returncode == 0


@pytest.mark.parametrize(
    ("old", "new"),
    [
        (b'"layers": 3', b'"layers": Infinity'), (b'"layers": 3', b'"layers": ' + b"[" * 5000),
        (b'"taxels": 16', b'"taxels": 1000000000000'), (b'"layers": 3', b'"layers": 0'),
        (b'"seed": ', b'"seed": 1e999, "x": '),
    ],
    ids=["endless number", "endless nesting", "endless image", "no layers", "endless seed"],
)  # fmt: skip
def test_an_estimator_that_is_none_is_refused(tmp_path: Path, old: bytes, new: bytes) -> None:
    with np.load(estimator_path("marble-estimator-1")) as file:
        arrays = dict(file)
    about = arrays["about"].tobytes()
    assert old in about
    arrays["about"] = np.frombuffer(about.replace(old, new), np.uint8)
    np.savez(tmp_path / "e.npz", **arrays)
    with pytest.raises(InputError, match=r"e\.npz"):
        read_estimator(tmp_path / "e.npz")


def test_an_estimator_of_odd_numbers_is_refused(tmp_path: Path) -> None:
    with np.load(estimator_path("marble-estimator-1")) as file:
        arrays = dict(file)
    for name, array in (("bias_0", np.nan * arrays["bias_0"]), ("mean", np.zeros(2_000_000))):
        np.savez_compressed(tmp_path / "e.npz", **{**arrays, name: array})
        with pytest.raises(InputError, match=r"e\.npz"):
            read_estimator(tmp_path / "e.npz")
