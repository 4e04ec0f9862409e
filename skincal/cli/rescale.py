"""``skincal rescale``: how much sensitivity the skin has lost since it was calibrated."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from skincal.cli.common import (
    CalibrationArgument,
    ForceOption,
    JsonOption,
    SeedOption,
    example,
    print_json,
    warn,
)
from skincal.errors import InputError, Problem

if TYPE_CHECKING:
    from skincal.calibration import Calibration
    from skincal.deploy.wear import Feel, Wear

EPILOG = example(
    "skincal deploy bolt bolt-tactile-1 --driver my-hand --duration-s 12 --out rolled",
    "skincal rescale cal rolled --out rescaled",
)
CALIBRATION_MARK = "calibration.toml"


def rescale(
    cal: CalibrationArgument,
    rolled: Annotated[
        Path,
        typer.Argument(metavar="ROLLED", help="Output of `skincal deploy` on it now."),
    ],
    out: Annotated[
        Path | None, typer.Option("--out", help="Folder for the calibration with the factor in its scale.")
    ] = None,
    hands: Annotated[
        int, typer.Option("--hands", min=3, help="Simulated hands, drawn from the calibration.")
    ] = 19,
    seed: SeedOption = 0,
    as_json: JsonOption = False,
    force: ForceOption = False,
) -> None:
    """Find one overall factor for lost sensitivity, from rolling an object on the hand and in simulation.

    The same policy rolls the same object on simulated hands drawn from the calibration. Where taxels have lost unlike
    amounts, or the response to force has changed, one factor is not enough: that is told, and `diagnose` finds more.
    """
    from skincal.calibration import read_calibration, write_calibration
    from skincal.deploy.wear import wear
    from skincal.files import refuse_existing

    if out is not None:
        refuse_existing(out, cal, rolled, force=force, marker=CALIBRATION_MARK)
    calibration = read_calibration(cal)
    warn(calibration.warnings)
    told = _told(rolled)
    now = _rolled(rolled, told)
    found = wear(now, _simulated(calibration, told, hands, seed))
    if out is not None:
        write_calibration(_scaled(calibration, found), out, force=force)
    content = _as_json(found, out)
    if as_json:
        print_json(content)
        return
    _say(found, cal, out)


def _told(rolled: Path) -> dict[str, Any]:
    """What the run was: the file that `deploy` leaves beside the session."""
    from skincal.bounded import parse_json, read_text
    from skincal.cli.deploy import MARKER
    from skincal.files import reason

    try:
        told = parse_json(read_text(rolled / MARKER, within=rolled))
        _check_told(told)
        return {name: told[name] for name in ("task", "policy", "steps", "rest_counts", "asked")}
    except (OSError, ArithmeticError, LookupError, TypeError, ValueError) as error:
        got = reason(error) if isinstance(error, OSError) else f"{type(error).__name__} {error}"
        expected = "the output of `skincal deploy` of this version or a later one"
        raise InputError([Problem(str(rolled / MARKER), expected, got)]) from error


_ASKED = {
    "frequency_hz": (0.05, 1.0),
    "duration_s": (0.5, 3600.0),
    "speed_rad_per_s": (0.0, 10.0),
    "orientation_deg": (-180.0, 180.0),
}
"""Bounds on the numbers that `deploy` was given."""


def _check_told(told: Any) -> None:
    """Check that a run is one that `deploy` can have made.

    Raises:
        OSError: its trajectory is a file outside the working folder.
        LookupError, TypeError, ValueError: it is none.
    """
    import numpy as np

    from skincal.cli.deploy import Task
    from skincal.files import check_input

    asked = told["asked"]
    Task(told["task"])
    beyond = [
        name
        for name, (low, high) in _ASKED.items()
        if asked[name] is not None and not low <= asked[name] <= high
    ]
    texts = [told["policy"], asked["trajectory"], asked["write"] or ""]
    rest_counts = np.array(told["rest_counts"], dtype=np.float64)
    if beyond or not 0 < told["steps"] < 1e5:
        raise ValueError(f"{', '.join(beyond) or 'steps'} beyond all bounds")
    if not all(isinstance(text, str) and len(text) < 1000 for text in texts):
        raise TypeError("policy, trajectory or write that is no name")
    if rest_counts.ndim != 1 or not np.isfinite(rest_counts).all():
        raise ValueError("rest_counts that are no image")
    if asked["trajectory"] not in ("circle", "still"):
        check_input(asked["trajectory"], within=Path.cwd())


def _rolled(rolled: Path, told: dict[str, Any]) -> Feel:
    import numpy as np

    from skincal.cli.deploy import SESSION
    from skincal.dataset import HOLD, read_dataset
    from skincal.deploy.wear import feel

    frames = read_dataset(rolled / SESSION).frames
    if frames is None:
        raise InputError([Problem(str(rolled / SESSION), "frames of the run", "none")])
    acting = np.asarray(frames.phase) == HOLD
    images = np.asarray(frames.counts, dtype=np.float64)[acting]
    if images.shape[1] != len(told["rest_counts"]):
        got = str(len(told["rest_counts"]))
        raise InputError([Problem(str(rolled), f"rest_counts of {images.shape[1]} taxels", got)])
    return feel(images - np.array(told["rest_counts"]), np.asarray(frames.force_n)[acting])


def _simulated(calibration: Calibration, told: dict[str, Any], hands: int, seed: int) -> list[Feel]:
    """The same run on hands drawn from the calibration."""
    import numpy as np

    from skincal.cli.deploy import Task, targets_of
    from skincal.deploy import deploy
    from skincal.deploy.wear import feel
    from skincal.envs.pinch import read_pinch
    from skincal.envs.reference_hand import ReferenceHand
    from skincal.errors import WorkError
    from skincal.progress import progress
    from skincal.ranges import from_calibration
    from skincal.train import policy_path, read_policy

    ranges = from_calibration(calibration, joint=calibration.draws is not None)
    policy, pinch, asked = read_policy(policy_path(told["policy"])), read_pinch(None), told["asked"]
    task = Task(told["task"])
    targets = targets_of(
        task, asked["trajectory"], asked["write"], asked["frequency_hz"], asked["duration_s"]
    )[: int(told["steps"]) + 1]
    found: list[Feel] = []
    with progress() as bars:
        bar = bars.add_task("simulated hands", total=hands)
        for number in range(hands):
            hand = ReferenceHand(
                task=task.value,
                seed=int(np.random.SeedSequence([seed, number]).generate_state(1)[0] >> 1),
                ranges=ranges,
                orientation_deg=asked["orientation_deg"],
            )
            try:
                run = deploy(
                    policy, hand, pinch, targets,
                    object_width_m=hand.object_width_m, speed_rad_per_s=asked["speed_rad_per_s"],
                )  # fmt: skip
                if run.lost_s is None:
                    record = run.record
                    acting = np.array([phase == "acting" for phase in record.phases])
                    found.append(feel(record.centroids_m[acting], record.force_n[acting]))
            except WorkError:
                pass  # A hand that the guard stops has rolled nothing.
            bars.update(bar, completed=number + 1)
    return found


def _scaled(calibration: Calibration, found: Wear) -> Calibration:
    """The calibration with the factor in its scale, and the factor's interval in that of the scale.

    The factor says how the hand answers against what the cloud of draws says of it, so that it is known about as well
    as the scale itself: the interval of the scale is multiplied, not widened.
    """
    import numpy as np

    model, draws = calibration.model, calibration.draws
    each = model.scale_per_taxel_per_n
    scaled = replace(
        model,
        scale_per_n=found.factor * model.scale_per_n,
        scale_per_taxel_per_n=None if each is None else tuple(found.factor * s for s in each),
    )
    low, high = calibration.intervals["scale_per_n"]
    intervals = {**calibration.intervals, "scale_per_n": (low * found.factor, high * found.factor)}
    if draws is not None and "scale_per_n" in draws:
        draws = {**draws, "scale_per_n": np.asarray(draws["scale_per_n"]) * found.factor}
    return replace(calibration, model=scaled, intervals=intervals, draws=draws, grid=None)


def _as_json(found: Wear, out: Path | None) -> dict[str, Any]:
    return {
        "factor": found.factor,
        "interval": found.interval,
        "level": found.level,
        "hands": found.hands,
        "enough": found.enough,
        "p_shares": found.p_shares,
        "p_growth": found.p_growth,
        "worst_taxel": found.worst_taxel,
        "calibration": out,
    }


def _say(found: Wear, cal: Path, out: Path | None) -> None:
    low, high = found.interval
    typer.echo(
        f"sensitivity: {found.factor:.2f} of what it was ({low:.2f} to {high:.2f}, {found.level:.0%}; "
        f"{found.hands} simulated hands)"
    )
    if found.enough:
        typer.echo("nothing shows that one factor is not enough")
    else:
        what = (
            f"the taxels' shares have changed, most that of taxel {found.worst_taxel}"
            if found.p_shares <= found.p_growth
            else "the response to force has changed"
        )
        typer.echo(
            f"one factor is not enough: {what}. Press anew, and look with: skincal diagnose PRESSES {cal}"
        )
    if out is not None:
        typer.echo(f"calibration: {out}")
