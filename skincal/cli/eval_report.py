"""What ``skincal eval`` tells: as JSON, and as a table."""

from __future__ import annotations

from dataclasses import asdict
from typing import TYPE_CHECKING, Any

from skincal.train.settings import Task

if TYPE_CHECKING:
    from rich.table import Table

    from skincal.report.evaluation import Evaluated
    from skincal.train.evaluate import Trial


_PREDICTED = ["will be held", "error on your hand [mm]"]


def as_json(found: list[Evaluated], trial: Trial, *, on: str, predicted: bool) -> dict[str, Any]:
    """The contract's content, and what else is known."""
    entries = [_entry(one, trial, predicted=predicted) for one in found]
    return {"task": str(trial.task), "on": on, "policies": entries}


def _entry(one: Evaluated, trial: Trial, *, predicted: bool) -> dict[str, Any]:
    from skincal.train.fare import fare
    from skincal.train.scores import rolling

    score = one.score
    entry: dict[str, Any] = {
        "file": one.policy.file,
        "policy": str(one.policy.description.policy),
        "episodes": score.episodes,
        "drops": score.drops,
        "time_s": [round(float(t), 6) for t in score.time_s],
        "error_m": score.error_m,
        "error_settled_m": score.error_settled_m,
        "error_end_m": score.error_end_m,
        "success": score.success,
        "error_low_m": score.error_low_m,
        "error_high_m": score.error_high_m,
        "error_settled_interval_m": score.error_settled_interval_m,
        "reward": score.reward,
    }
    if predicted:
        entry["prediction"] = asdict(fare(one.runs))
    if trial.task is Task.bolt:
        whole = rolling(one.runs)
        entry |= {"direction_right": whole.direction_right, "held_to_end": whole.held_to_end}
        entry |= {"held_s": whole.held_s, "angle_error_rad": whole.angle_error_rad}
        entry["by_orientation_deg"] = {
            name: {
                "direction_right": part.direction_right,
                "held_to_end": part.held_to_end,
                "drops": part.drops,
                "episodes": part.episodes,
                "held_s": part.held_s,
                "angle_error_rad": part.angle_error_rad,
            }
            for name, part in whole.by_orientation_deg.items()
        }
    return entry


def table_of(found: list[Evaluated], trial: Trial, *, predicted: bool) -> Table:
    """One row a policy."""
    from rich.markup import escape
    from rich.table import Table

    from skincal.train.fare import fare
    from skincal.train.scores import rolling

    bolt = trial.task is Task.bolt
    titles = ["policy", "sees", "held", "error settled [mm]", "at the end [mm]"]
    table = Table(box=None, padding=(0, 2, 0, 0))
    more = [*(["direction right", "angle error [°]"] if bolt else []), *(_PREDICTED if predicted else [])]
    for title in [*titles, *more]:
        table.add_column(escape(title))
    for one in found:
        score = one.score
        low, high = (1e3 * end for end in score.error_settled_interval_m)
        row = [
            escape(one.name),
            str(one.policy.description.policy),
            f"{score.episodes - score.drops} of {score.episodes}",
            f"{1e3 * score.error_settled_m:.2f} ({low:.2f} … {high:.2f})",
            f"{1e3 * score.error_end_m:.2f}",
        ]
        if bolt:
            whole = rolling(one.runs)
            row += [f"{whole.direction_right:.0%}", f"{57.29578 * whole.angle_error_rad:.1f}"]
        if predicted:
            one_hand = fare(one.runs)
            low, high = (1e3 * end for end in one_hand.error_interval_m)
            least, most = one_hand.success_interval
            row += [f"{least:.0%} … {most:.0%}", f"{low:.2f} … {high:.2f} ({one_hand.level:.0%})"]
        table.add_row(*row)
    return table
