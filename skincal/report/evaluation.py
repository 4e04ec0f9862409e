"""The output of training and evaluation: curves, figures of all policies side by side, runs as a table, films."""

from __future__ import annotations

import csv
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from PIL import Image

from skincal.dataset.dataset import layout_of
from skincal.envs.trajectories import POLICY_HZ
from skincal.files import real, whole_file
from skincal.model import TaxelLayout
from skincal.model.arrays import FloatArray
from skincal.ranges import Ranges
from skincal.report import style
from skincal.report.page import percent
from skincal.robot import bundled_hand
from skincal.train import Policy
from skincal.train.evaluate import Trial, environment_for, episode
from skincal.train.scores import LEVEL, Runs, Score


@dataclass(frozen=True, eq=False)
class Evaluated:
    """A policy with a unique name for figures, its episodes and their score."""

    name: str
    policy: Policy
    runs: Runs
    score: Score


def names_of(policies: Sequence[Policy]) -> list[str]:
    """Return a unique name per policy: its file's, or for ``policy.onnx`` its folder's, with a number if needed."""
    paths = [real(policy.file) for policy in policies]
    names = [path.parent.name if path.stem == "policy" else path.stem for path in paths]
    number = Counter(names)
    seen: Counter[str] = Counter()
    for i, name in enumerate(names):
        if number[name] > 1:
            seen[name] += 1
            names[i] = f"{name}-{seen[name]}"
    return names


def write_figures(found: Sequence[Evaluated], trial: Trial, folder: Path) -> None:
    """Write ``runs.png`` and ``error.png``."""
    layout = layout_of(bundled_hand().meta.sensor, None)  # of the hand that the tasks use
    runs, scores = {one.name: one.runs for one in found}, {one.name: one.score for one in found}
    style.save(runs_figure(runs, layout, f"{trial.task}: the first runs of each policy"), folder / "runs.png")
    title = f"{trial.task}: mean of {trial.episodes} runs, {percent(LEVEL)} interval"
    style.save(error_figure(scores, title), folder / "error.png")


def write_runs(found: Sequence[Evaluated], path: Path) -> None:
    """Write every step of every run as CSV."""
    head = ["policy", "run", "time_s", "error_m", "u_m", "v_m", "target_u_m", "target_v_m", "angle_error_rad"]
    with path.open("w", encoding="utf-8", newline="") as file:
        writer = csv.writer(file, lineterminator="\n")
        writer.writerow(head)
        for one in found:
            runs = one.runs
            for i in range(len(runs)):
                for t, time_s in enumerate(runs.time_s):
                    if runs.error_m[i, t] != runs.error_m[i, t]:
                        break
                    place = *runs.object_m[i, t], *runs.target_m[i, t]
                    numbers = time_s, runs.error_m[i, t], *place, runs.angle_error_rad[i, t]
                    writer.writerow([one.name, i, *(f"{v:.6g}" for v in numbers)])


EXAMPLES = 3


@style.styled
def runs_figure(runs: Mapping[str, Runs], layout: TaxelLayout, title: str = "") -> Figure:
    """Draw three runs of each policy by name, over the taxels and the target's path."""
    figure = style.new_figure(3.4 * len(runs) + 0.6, 4.2, title)
    all_axes = figure.subplots(1, len(runs), sharex=True, sharey=True, squeeze=False)[0]
    for axes, (name, some) in zip(all_axes, runs.items(), strict=True):
        style.draw_outlines(axes, layout, "none")
        _draw_runs(axes, some)
        axes.set_aspect("equal", adjustable="box")
        axes.set(title=style.as_it_is(name), xlabel="u [mm]")
    all_axes[0].set_ylabel("v [mm]")
    figure.legend(*all_axes[0].get_legend_handles_labels(), loc="outside lower left", ncols=4)
    return figure


@style.styled
def error_figure(scores: Mapping[str, Score], title: str = "") -> Figure:
    """Draw the mean tracking error over time with its interval, and the number of runs that last."""
    figure = style.new_figure(6.4, 3.8, title)
    axes = figure.subplots()
    for (name, score), colour in zip(scores.items(), style.SEVERAL * len(scores), strict=False):
        label = f"{style.as_it_is(name)} ({score.episodes - score.drops} of {score.episodes} held)"
        axes.plot(score.time_s, 1e3 * score.error_m, color=colour, label=label)
        low, high = 1e3 * score.error_low_m, 1e3 * score.error_high_m
        axes.fill_between(score.time_s, low, high, color=colour, alpha=0.2, linewidth=0)
    axes.set(xlabel="time [s]", ylabel="tracking error [mm]")
    # Leave room above the curves for one line of the legend each.
    axes.set_ylim(0, axes.get_ylim()[1] * (1 + 0.09 * len(scores)))
    axes.set_xlim(left=0)
    axes.grid(axis="y")
    axes.legend(loc="upper left")
    return figure


def _draw_runs(axes: Axes, runs: Runs) -> None:
    """Draw the first runs, which are not selected."""
    axes.plot(*(1e3 * runs.target_m[0].T), color=style.BLACK, linewidth=1.0, label="target")
    for i, colour in zip(
        range(min(EXAMPLES, len(runs))), (style.BLUE, style.ORANGE, style.GREEN), strict=False
    ):
        way = 1e3 * runs.object_m[i]
        axes.plot(*way.T, color=colour, linewidth=1.2, label=f"run {i + 1}")
        held = np.isfinite(way).all(axis=1)
        if runs.dropped[i] and held.any():
            axes.plot(*way[held][-1], "x", color=colour, markersize=6)


FILM_COLOURS = 128


def write_film(policy: Policy, trial: Trial, path: Path, *, ranges: Ranges | None = None) -> None:
    """Write a GIF of the first run of a trial, in real time."""
    environment = environment_for(policy, trial, ranges, render_mode="rgb_array")
    try:
        frames = [Image.fromarray(environment.render()) for _ in episode(policy, environment, trial, 0)]  # type: ignore[arg-type]
    finally:
        environment.close()
    first, *rest = (frame.quantize(FILM_COLOURS, dither=Image.Dither.NONE) for frame in frames)
    with whole_file(path) as temporary:
        first.save(temporary, save_all=True, append_images=rest, duration=round(1e3 / POLICY_HZ), loop=0)


SMOOTH_STEPS = 10_000
"""Steps over which figures are averaged: a single round holds eight episodes."""


_PANELS = (
    ("reward", "reward of a step", 1.0),
    ("error_m", "tracking error [mm]", 1e3),
    ("drops", "episodes with a drop [%]", 1e2),
)


@style.styled
def curves_figure(curves: Mapping[str, Mapping[str, FloatArray]], title: str = "") -> Figure:
    """Draw learning curves: columns of each run by name (see :func:`skincal.train.read_curve`)."""
    figure = style.new_figure(10.5, 3.2, title)
    for axes, (column, label, factor) in zip(figure.subplots(1, 3), _PANELS, strict=True):
        for (name, curve), colour in zip(curves.items(), style.SEVERAL * len(curves), strict=False):
            steps, values = smoothed(curve["steps"], curve[column])
            look: Any = {"color": colour, "marker": "o" if len(steps) == 1 else ""}
            axes.plot(1e-3 * steps, factor * values, label=style.as_it_is(name), **look)
        axes.set(xlabel="environment steps [thousands]", title=label)
        axes.grid(axis="y")
        axes.set_ylim(bottom=0)
        if len(curves) > 1 and column == "reward":
            axes.legend(loc="lower right")
    return figure


def smoothed(steps: FloatArray, values: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return means over blocks of :data:`SMOOTH_STEPS`, without empty blocks."""
    block, finite = (steps - 1) // SMOOTH_STEPS, np.isfinite(values)
    blocks = np.unique(block[finite])
    at = np.array([steps[block == b].mean() for b in blocks])
    return at, np.array([values[(block == b) & finite].mean() for b in blocks])
