"""``skincal audit``: which effects the presses of a dataset, or of a plan, can show."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from skincal.cli.common import ForceOption, JsonOption, SeedOption, example, print_json, say, warn

if TYPE_CHECKING:
    from skincal.calibration import Calibration
    from skincal.diagnosis.audit import AuditReport
    from skincal.diagnosis.observed import NoiseFloor

EPILOG = example("skincal audit data/paper-like", "skincal audit run-plan.toml --out audit --json")

PICTURE = "audit.png"

MOST_NUMBERS = 8
"""Number of presses that a message lists by number."""


def audit(
    source: Annotated[
        Path,
        typer.Argument(
            metavar="DATASET_OR_PLAN",
            help="Folder of a dataset, or a plan (TOML, CSV) that has not been collected yet.",
        ),
    ],
    calibration: Annotated[
        Path | None,
        typer.Option(
            "--calibration",
            metavar="CAL",
            help="Folder of a calibration of this sensor: pose, E, S and position uncertainty. Without it these "
            "are assumed.",
        ),
    ] = None,
    hand: Annotated[
        str | None,
        typer.Option("--hand", help="For a plan: the hand that would press, its name or hand.toml."),
    ] = None,
    out: Annotated[
        Path | None,
        typer.Option("--out", help=f"Folder for a picture, {PICTURE}."),
    ] = None,
    seed: SeedOption = 0,
    as_json: JsonOption = False,
    force: ForceOption = False,
) -> None:
    """Show which effects the presses can reveal, how strong they must be, and which look the same.

    Nothing is fitted. Of the measured counts, only the noise and, without --calibration, the scale are used. The audit
    looks at the place, time and force of each press, and at the recorded covariates. Strength 1 of an effect is a
    typical, clearly visible case of it.
    """
    from skincal.files import refuse_existing

    if out is not None:
        inputs = [source, *(Path(one) for one in (calibration, hand) if one)]
        refuse_existing(out, *inputs, force=force, marker=PICTURE)
    report, unit = _audited(source, calibration, hand, seed)
    picture = None if out is None else _draw(report, out, force)
    if as_json:
        print_json(_as_json(report, picture))
        return
    typer.echo(_report_text(report, unit))
    if picture is not None:
        say(f"picture: {picture}")


def _audited(source: Path, calibration: Path | None, hand: str | None, seed: int) -> tuple[AuditReport, str]:
    """Return the report, and the unit of the taxel values."""
    import numpy as np

    from skincal.calibration import read_calibration
    from skincal.dataset import read_dataset
    from skincal.diagnosis.audit import audit_dataset
    from skincal.errors import InputError, Problem

    cal = None if calibration is None else read_calibration(calibration)
    rng = np.random.default_rng(seed)
    of_dataset = source.is_dir() or source.name in ("dataset.toml", "presses.csv")
    if source.suffix.lower() in (".toml", ".csv") and not of_dataset:
        return _of_plan(source, cal, hand, rng), "counts"
    if hand is not None:
        raise InputError([Problem("--hand", "a plan", f"the dataset {source}", "Leave --hand out.")])
    dataset = read_dataset(source)
    warn((*dataset.warnings, *(() if cal is None else cal.warnings)))
    return audit_dataset(dataset, cal, rng), dataset.meta.sensor.unit_label


def _of_plan(source: Path, calibration: Calibration | None, hand: str | None, rng: Any) -> AuditReport:
    from skincal.collect import Mount, read_plan
    from skincal.diagnosis.audit import audit_plan
    from skincal.hand.hands import hand_named

    description = hand_named() if hand is None else hand_named(hand)
    return audit_plan(read_plan(source, Mount.of(description.meta)), description, calibration, rng)


def _draw(report: AuditReport, out: Path, force: bool) -> Path:
    from skincal.files import whole_folder
    from skincal.report.audit import audit_figure
    from skincal.report.style import save

    with whole_folder(out, force=force, marker=PICTURE) as folder:
        save(audit_figure(report), folder / PICTURE)
    return out / PICTURE


def _as_json(report: AuditReport, picture: Path | None) -> dict[str, Any]:
    options = report.options
    return {
        "presses": report.presses,
        "observations": report.observations,
        "taxels": report.taxels,
        "frames": report.has_frames,
        "planned": report.planned,
        "calibrated": report.calibrated,
        "left_out": report.left_out,
        "visible": report.visible,
        "cannot_see": report.cannot_see,
        "effects": report.rows,
        "noise": vars(report.floor),
        "false_alarm": options.false_alarm,
        "power": options.power,
        "alike": options.alike,
        "position_sigma_m": options.position_sigma_m,
        "force_sigma": options.force_sigma,
        "shape_sigma": options.shape_sigma,
        "picture": picture,
    }


def _report_text(report: AuditReport, unit: str) -> str:
    of = "frames in bins" if report.has_frames else "hold means"
    what = "planned presses" if report.planned else "presses"
    lines = [
        f"{report.presses} {what}, {report.observations} images ({of}) of {report.taxels} taxels",
        _noise(report.floor, unit),
    ]
    if report.left_out:
        lines.append(f"left out, because their force is an outlier: presses {_numbers(report.left_out)}")
    if not report.calibrated:
        lines.append("pose, E and S are assumed; --calibration CAL takes those of a fit")
    lines += ["", f"{'visible':<17}{'smallest strength':>18}   looks the same as"]
    for name in report.visible:
        one = report.effects[name]
        same = ", ".join(one.consistent_with[1:]) or "–"
        lines.append(f"{name:<17}{_strength(one.smallest_strength):>18}   {same}")
    if report.cannot_see:
        lines += ["", "not visible      why"]
        lines += [f"{name:<17}{report.reasons[name]}{_beyond(report, name)}" for name in report.cannot_see]
    options = report.options
    lines += [
        "",
        f"Strength 1 is a typical case. The smallest strength is detected in {100 * options.power:.0f} % of cases at "
        f"{100 * options.false_alarm:.0f} % false",
        "alarms over all effects, if the base model fits to the noise; if its contact law does not, more is needed.",
    ]
    return "\n".join(lines)


def _numbers(presses: tuple[int, ...]) -> str:
    more = f" and {len(presses) - MOST_NUMBERS} more" if len(presses) > MOST_NUMBERS else ""
    return ", ".join(map(str, presses[:MOST_NUMBERS])) + more


def _strength(value: float) -> str:
    return f"{value:.2g}" if value >= 0.01 else "< 0.01"


def _beyond(report: AuditReport, name: str) -> str:
    """Return a note with the strength at which an effect that is not visible would be, or ''."""
    value = report.effects[name].smallest_strength
    return f" (seen from strength {value:.2g})" if value < 10 else ""


def _noise(floor: NoiseFloor, unit: str) -> str:
    low, high = floor.frame_interval
    mean_low, mean_high = floor.mean_interval
    return (
        f"noise of a frame {floor.frame_counts:.3g} {unit} ({low:.3g} to {high:.3g}, from {floor.frame_from}), "
        f"of a hold mean {floor.mean_counts:.3g} ({mean_low:.3g} to {mean_high:.3g}, from {floor.mean_from})"
    )
