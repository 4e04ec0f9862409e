"""Figures and tables of an evaluation, and of learning curves."""

from __future__ import annotations

import csv
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from published import LAYOUT

from skincal.report.evaluation import (
    Evaluated,
    curves_figure,
    error_figure,
    names_of,
    runs_figure,
    smoothed,
    write_figures,
    write_runs,
)
from skincal.train import Task
from skincal.train.evaluate import Trial
from skincal.train.scores import Runs, score


def some_runs(n: int = 4, t: int = 80) -> Runs:
    rng = np.random.default_rng(1)
    angle = np.linspace(0, 2 * np.pi, t)
    target = np.tile(5e-3 * np.stack([np.cos(angle), np.sin(angle)], axis=1), (n, 1, 1))
    place = target + 5e-4 * rng.normal(size=target.shape)
    error = np.linalg.norm(place - target, axis=2)
    error[1, 30:], place[1, 30:] = np.nan, np.nan
    dropped = np.arange(n) == 1
    parts = {"error_m": error, "object_m": place, "target_m": target, "rewards": np.ones(n)}
    return replace(Runs.empty(n, t, 10.0), dropped=dropped, **parts)


def evaluated(name: str = "tactile", folder: str = "run") -> Evaluated:
    runs = some_runs()
    policy = SimpleNamespace(file=f"{folder}/policy.onnx")
    return Evaluated(name, policy, runs, score(runs, np.random.default_rng(1)))  # type: ignore[arg-type]


def test_figures_are_written(tmp_path: Path):
    write_figures([evaluated("a"), evaluated("b")], Trial(Task.marble, episodes=4), tmp_path)
    assert {path.name for path in tmp_path.iterdir()} == {"runs.png", "error.png"}
    assert all(path.stat().st_size > 10_000 for path in tmp_path.iterdir())


def test_the_error_is_drawn_in_millimetres_with_its_interval():
    one = evaluated()
    axes = error_figure({"tactile": one.score}).axes[0]
    np.testing.assert_allclose(axes.lines[0].get_ydata(), 1e3 * one.score.error_m)
    assert len(axes.collections) == 1
    assert axes.get_legend().get_texts()[0].get_text() == "tactile (3 of 4 held)"


def test_three_runs_of_each_policy_are_drawn():
    figure = runs_figure({"a": some_runs(), "b": some_runs(2)}, LAYOUT)
    first, second = figure.axes
    assert [line.get_label() for line in first.lines if not line.get_label().startswith("_")] == [
        "target", "run 1", "run 2", "run 3",
    ]  # fmt: skip
    assert sum(line.get_marker() == "x" for line in first.lines) == 1  # where the second run lost it
    assert len([line for line in second.lines if line.get_marker() != "x"]) == 3
    assert len(first.patches) == 16


def test_runs_as_a_table(tmp_path):
    write_runs([evaluated("a")], tmp_path / "runs.csv")
    rows = list(csv.DictReader((tmp_path / "runs.csv").read_text().splitlines()))
    assert len(rows) == 3 * 80 + 30
    assert float(rows[5]["error_m"]) == pytest.approx(some_runs().error_m[0, 5], rel=1e-5)


def test_names(tmp_path):
    files = ["x/policy.onnx", "y/policy.onnx", "z/x.onnx", "marble-tactile.onnx"]
    policies = [SimpleNamespace(file=str(tmp_path / f)) for f in files]
    assert names_of(policies) == ["x-1", "y", "x-2", "marble-tactile"]  # type: ignore[arg-type]


def test_curves_are_smoothed_over_what_is_known():
    steps = 480.0 * np.arange(1, 101)
    values = np.where(np.arange(100) % 2, np.nan, 2.0)
    at, smooth = smoothed(steps, values)
    assert smooth == pytest.approx(2.0)
    assert len(at) == 5
    empty = {name: np.full(100, np.nan) for name in ("reward", "error_m", "drops")}
    figure = curves_figure({"a": {"steps": steps, **empty, "reward": values}})
    assert len(figure.axes) == 3
