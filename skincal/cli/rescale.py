"""``skincal rescale``: how much sensitivity the skin has lost since it was calibrated."""

from __future__ import annotations

from dataclasses import asdict, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

from skincal.cli import options
from skincal.cli.deploy import MARKER, SESSION, targets_of
from skincal.cli.options import argument, example, option
from skincal.cli.terminal import answer, warn
from skincal.errors import input_error, quoted
from skincal.tasks import Task

if TYPE_CHECKING:
    from skincal.calibration import Calibration
    from skincal.deploy.wear import Feel, Wear

EPILOG = example(
    "skincal deploy bolt bolt-tactile-1 --driver my-hand --duration-s 12 --out rolled",
    "skincal rescale cal rolled --out rescaled",
)

_BOUNDS = {
    "frequency_hz": (0.05, 1.0),
    "duration_s": (0.5, 3600.0),
    "speed_rad_per_s": (0.0, 10.0),
    "orientation_deg": (-180.0, 180.0),
}
"""Bounds on the numbers that `deploy` was given."""


def rescale(
    cal: options.Calibration,
    rolled: Annotated[Path, argument("ROLLED", "Output of `skincal deploy` on it now.")],
    out: Annotated[Path | None, option("Folder for the calibration with the factor in its scale.")] = None,
    hands: Annotated[int, option("Simulated hands, drawn from the calibration.", min=3, max=10_000)] = 19,
    seed: options.Seed = 0,
    as_json: options.Json = False,
    force: options.Force = False,
) -> None:
    """Find one overall factor for lost sensitivity, from rolling an object on the hand and in simulation.

    The same policy rolls the same object on simulated hands drawn from the calibration. Where taxels have lost unlike
    amounts, or the response to force has changed, one factor is not enough: that is reported, and `diagnose` finds
    more.
    """
    from skincal.calibration import read_calibration, write_calibration
    from skincal.deploy.wear import wear
    from skincal.files import refuse_existing

    if out is not None:
        refuse_existing(out, cal, rolled, force=force, marker="calibration.toml")
    calibration = read_calibration(cal)
    warn(calibration.warnings)
    run = read_deployed(rolled)
    found = wear(_rolled(rolled, run), _simulated(calibration, run, hands, seed))
    if out is not None:
        write_calibration(_scaled(calibration, found), out, force=force)
    answer(as_json, {**asdict(found), "enough": found.enough, "calibration": out}, *_lines(found, cal, out))


def read_deployed(rolled: Path) -> dict[str, Any]:
    """Return what a run was: the file that `deploy` writes next to the session.

    Raises:
        InputError: it is no run that `deploy` can have made, or its trajectory lies outside the working folder.
    """
    from skincal.bounded import parse_json, read_text
    from skincal.files import reason

    try:
        run = parse_json(read_text(rolled / MARKER, within=rolled))
        _check_run(run)
        return {name: run[name] for name in ("task", "policy", "steps", "rest_counts", "asked")}
    except (OSError, ArithmeticError, LookupError, TypeError, ValueError) as error:
        got = reason(error) if isinstance(error, OSError) else quoted(error)
        expected = "the output of `skincal deploy` of this version or a later one"
        raise input_error(str(rolled / MARKER), expected, got) from error


def _check_run(run: Any) -> None:
    import numpy as np

    from skincal.files import check_input

    settings = run["asked"]
    Task(run["task"])
    if run.get("finished") is False:
        raise ValueError("a run that ended early, which the simulated ones would not")
    beyond = [
        name
        for name, (low, high) in _BOUNDS.items()
        if settings[name] is not None and not low <= settings[name] <= high
    ]
    if beyond or not 0 < run["steps"] < 1e5:
        raise ValueError(f"{', '.join(beyond) or 'steps'} beyond all bounds")
    texts = [run["policy"], settings["trajectory"], settings["write"] or ""]
    if not all(isinstance(text, str) and len(text) < 1000 for text in texts):
        raise TypeError("policy, trajectory or write that is no name")
    rest_counts = np.array(run["rest_counts"], dtype=np.float64)
    if rest_counts.ndim != 1 or not np.isfinite(rest_counts).all():
        raise ValueError("rest_counts that are no image")
    if settings["trajectory"] not in ("circle", "still"):
        check_input(settings["trajectory"], within=Path.cwd())


def _rolled(rolled: Path, run: dict[str, Any]) -> Feel:
    import numpy as np

    from skincal.dataset import HOLD, read_dataset
    from skincal.deploy.wear import feel

    frames = read_dataset(rolled / SESSION).frames
    if frames is None:
        raise input_error(str(rolled / SESSION), "frames of the run", "none")
    acting = np.asarray(frames.phase) == HOLD
    images = np.asarray(frames.counts, dtype=np.float64)[acting]
    if images.shape[1] != len(run["rest_counts"]):
        raise input_error(str(rolled), f"rest_counts of {images.shape[1]} taxels", len(run["rest_counts"]))
    return feel(images - np.array(run["rest_counts"]), np.asarray(frames.force_n)[acting])


def _simulated(calibration: Calibration, run: dict[str, Any], hands: int, seed: int) -> list[Feel]:
    """Return the same run on hands drawn from the calibration."""
    import numpy as np

    from skincal.deploy import deploy
    from skincal.deploy.wear import feel
    from skincal.envs.pinch import read_pinch
    from skincal.envs.reference_hand import ReferenceHand
    from skincal.errors import WorkError
    from skincal.progress import stage_bars
    from skincal.ranges import from_calibration
    from skincal.train import policy_path, read_policy

    ranges = from_calibration(calibration, joint=calibration.draws is not None)
    policy, pinch, task = read_policy(policy_path(run["policy"])), read_pinch(None), Task(run["task"])
    settings = run["asked"]
    asked = (settings[name] for name in ("trajectory", "write", "frequency_hz", "duration_s"))
    targets = targets_of(task, *asked)[: int(run["steps"]) + 1]
    found: list[Feel] = []
    with stage_bars() as progress:
        for number in range(hands):
            progress("simulated hands", number, hands)
            hand = ReferenceHand(
                task=task.value,
                seed=int(np.random.SeedSequence([seed, number]).generate_state(1)[0] >> 1),
                ranges=ranges,
                orientation_deg=settings["orientation_deg"],
            )
            sizes = {"object_width_m": hand.object_width_m, "speed_rad_per_s": settings["speed_rad_per_s"]}
            try:
                done = deploy(policy, hand, pinch, targets, **sizes)
            except WorkError:
                continue  # A hand that the guard stops has rolled nothing.
            if done.lost_s is None:
                record = done.record
                acting = np.array([phase == "acting" for phase in record.phases])
                found.append(feel(record.centroids_m[acting], record.grip_n[acting]))
    return found


def _scaled(calibration: Calibration, found: Wear) -> Calibration:
    """Return the calibration with the factor in its scale.

    The factor says how the hand answers relative to what the draws say of it, so that it is known about as well as the
    scale itself: the interval of the scale is multiplied, not widened.
    """
    import numpy as np

    model, draws, factor = calibration.model, calibration.draws, found.factor
    each = model.scale_per_taxel_per_n
    scaled = replace(
        model,
        scale_per_n=factor * model.scale_per_n,
        scale_per_taxel_per_n=None if each is None else tuple(factor * s for s in each),
    )
    low, high = calibration.intervals["scale_per_n"]
    intervals = {**calibration.intervals, "scale_per_n": (low * factor, high * factor)}
    if draws is not None and "scale_per_n" in draws:
        draws = {**draws, "scale_per_n": np.asarray(draws["scale_per_n"]) * factor}
    return replace(calibration, model=scaled, intervals=intervals, draws=draws, grid=None)


def _lines(found: Wear, cal: Path, out: Path | None) -> list[str]:
    low, high = found.interval
    what = "the response to force has changed"
    if found.p_shares <= found.p_growth:
        what = f"the taxels' shares have changed, most that of taxel {found.worst_taxel}"
    fix = f"one factor is not enough: {what}. Press anew, and look with: skincal diagnose PRESSES {cal}"
    return [
        f"sensitivity: {found.factor:.2f} of what it was ({low:.2f} to {high:.2f}, {found.level:.0%}; "
        f"{found.hands} simulated hands)",
        "nothing shows that one factor is not enough" if found.enough else fix,
        *([] if out is None else [f"calibration: {out}"]),
    ]
