"""The output of an evaluation: figures, and the runs as a table."""

from __future__ import annotations

import csv
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from skincal.dataset.model_objects import layout_of
from skincal.report.eval_marble import error_figure, runs_figure
from skincal.report.style import save
from skincal.robot import bundled_hand
from skincal.train import Policy
from skincal.train.evaluate import Trial
from skincal.train.scores import Runs, Score


@dataclass(frozen=True, eq=False)
class Evaluated:
    """A policy with a unique name for figures, its episodes and their score."""

    name: str
    policy: Policy
    runs: Runs
    score: Score


def names_of(policies: Sequence[Policy]) -> list[str]:
    """Return a unique name per policy: its file's, or for ``policy.onnx`` its folder's, with a number if needed."""
    paths = [Path(policy.file).resolve() for policy in policies]
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
    save(runs_figure(runs, layout, f"{trial.task}: the first runs of each policy"), folder / "runs.png")
    title = f"{trial.task}: mean of {trial.episodes} runs, 95 % interval"
    save(error_figure(scores, title), folder / "error.png")


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
