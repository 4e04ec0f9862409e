"""``skincal rescale``: how much sensitivity the skin has lost since it was calibrated."""

from __future__ import annotations

from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from skincal.cli import options
from skincal.cli.options import argument, example, option
from skincal.cli.terminal import answer, warn

if TYPE_CHECKING:
    from skincal.deploy.wear import Wear

EPILOG = example(
    "skincal deploy bolt bolt-tactile-1 --driver my-hand --duration-s 12 --out rolled",
    "skincal rescale cal rolled --out rescaled",
)


def rescale(
    cal: options.Calibration,
    rolled: Annotated[Path, argument("ROLLED", "Output of `skincal deploy` on it now.")],
    out: Annotated[Path | None, option("Folder for the calibration with the factor in its scale.")] = None,
    # By default the fewest for a two-sided rank test at 10 %, one in twenty at each end.
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
    from skincal.deploy.record import read_run_file
    from skincal.deploy.wear import (
        estimate_wear,
        recorded_sensitivity,
        rescale_calibration,
        simulated_sensitivities,
    )
    from skincal.files import refuse_existing
    from skincal.progress import stage_bars

    if out is not None:
        refuse_existing(out, cal, rolled, force=force, marker="calibration.toml")
    calibration = read_calibration(cal)
    warn(calibration.warnings)
    run = read_run_file(rolled)
    hand = recorded_sensitivity(rolled, run, calibration)
    with stage_bars() as progress:
        found = estimate_wear(hand, simulated_sensitivities(calibration, run, hands, seed, progress))
    if out is not None:
        write_calibration(rescale_calibration(calibration, found.factor), out, force=force)
    answer(
        as_json,
        {**asdict(found), "enough": found.is_one_factor_enough, "calibration": out},
        *_lines(found, cal, out),
    )


def _lines(found: Wear, cal: Path, out: Path | None) -> list[str]:
    low, high = found.interval
    what = "the response to force has changed"
    if found.p_shares <= found.p_growth:
        what = f"the taxels' shares have changed, most that of taxel {found.worst_taxel}"
    fix = f"one factor is not enough: {what}. Press anew, and look with: skincal diagnose PRESSES {cal}"
    return [
        f"sensitivity: {found.factor:.2f} of what it was ({low:.2f} to {high:.2f}, {found.level:.0%}; "
        f"{found.hands} simulated hands)",
        "nothing shows that one factor is not enough" if found.is_one_factor_enough else fix,
        *([] if out is None else [f"calibration: {out}"]),
    ]
