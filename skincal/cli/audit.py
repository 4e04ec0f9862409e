"""``skincal audit``: which effects the presses of a dataset, or of a plan, can show."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

from skincal.cli import options
from skincal.cli.options import argument, example, option
from skincal.cli.terminal import MOST_LISTED, answer, picked, warn
from skincal.errors import first_of, input_error

if TYPE_CHECKING:
    from skincal.diagnosis.audit import AuditReport

EPILOG = example("skincal audit data/paper-like", "skincal audit run-plan.toml --out audit --json")

PICTURE = "audit.png"

_SOURCE = "Folder of a dataset, or a plan (TOML, CSV) that has not been collected yet."
_CALIBRATION = (
    "Folder of a calibration of this sensor: pose, E, S, position uncertainty. Without it these are assumed."
)


def audit(
    source: Annotated[Path, argument("DATASET_OR_PLAN", _SOURCE)],
    calibration: Annotated[Path | None, option(_CALIBRATION, metavar="CAL")] = None,
    hand: Annotated[
        str | None, option("For a plan: the hand that would press, its name or hand.toml.")
    ] = None,
    out: Annotated[Path | None, option(f"Folder for a picture, {PICTURE}.")] = None,
    seed: options.Seed = 0,
    as_json: options.Json = False,
    force: options.Force = False,
) -> None:
    """Show which effects the presses can reveal, how strong they must be, and which look the same.

    Nothing is fitted. Of the measured counts, only the noise and, without --calibration, the scale are used. The audit
    looks at the place, time and force of each press, and at the recorded covariates. Strength 1 of an effect is a
    typical, clearly visible case of it.
    """
    from skincal.files import refuse_existing, whole_folder

    if out is not None:
        refuse_existing(out, source, calibration, hand, force=force, marker=PICTURE)
    report, unit = _audited(source, calibration, hand, seed)
    picture = None if out is None else out / PICTURE
    if out is not None:
        from skincal.report.diagnosis_figures import audit_figure
        from skincal.report.style import save

        with whole_folder(out, force=force, marker=PICTURE) as folder:
            save(audit_figure(report), folder / PICTURE)
    then = f"picture: {picture}" if picture else ""
    answer(as_json, _as_json(report, picture), *_lines(report, unit), then=then)


def _audited(source: Path, calibration: Path | None, hand: str | None, seed: int) -> tuple[AuditReport, str]:
    """Return the report, and the unit of the taxel values."""
    import numpy as np

    from skincal.calibration import read_calibration
    from skincal.collect import Mount, read_plan
    from skincal.dataset import read_dataset
    from skincal.diagnosis.audit import audit_dataset, audit_plan
    from skincal.robot import hand_named

    cal = None if calibration is None else read_calibration(calibration)
    rng = np.random.default_rng(seed)
    of_dataset = source.is_dir() or source.name in ("dataset.toml", "presses.csv")
    if source.suffix.lower() in (".toml", ".csv") and not of_dataset:
        description = hand_named() if hand is None else hand_named(hand)
        plan = read_plan(source, Mount.of(description.meta))
        return audit_plan(plan, description, cal, rng), "counts"
    if hand is not None:
        raise input_error("--hand", "a plan", f"the dataset {source}", "Leave --hand out.")
    dataset = read_dataset(source)
    warn((*dataset.warnings, *(() if cal is None else cal.warnings)))
    return audit_dataset(dataset, cal, rng), dataset.meta.sensor.unit_label


def _as_json(report: AuditReport, picture: Path | None) -> dict[str, Any]:
    return {
        **picked(report, "presses observations taxels"),
        "frames": report.has_frames,
        **picked(report, "planned calibrated left_out visible cannot_see"),
        "effects": report.rows,
        "noise": vars(report.floor),
        **picked(report.options, "false_alarm power alike position_sigma_m force_sigma shape_sigma"),
        "picture": picture,
    }


def _lines(report: AuditReport, unit: str) -> list[str]:
    """Return the audit for a person, line by line."""
    what = "planned presses" if report.planned else "presses"
    of = "frames in bins" if report.has_frames else "hold means"
    floor, settings = report.floor, report.options
    known = (floor.frame_from, floor.frame_interval), (floor.mean_from, floor.mean_interval)
    frame, mean = (f"({source}; {low:.3g} to {high:.3g})" for source, (low, high) in known)
    frame_counts = f"{floor.frame_counts:.3g}"
    unit = "count" if (frame_counts, unit) == ("1", "counts") else unit
    lines = [
        f"{report.presses} {what}, {report.observations} images ({of}) of {report.taxels} taxels",
        f"noise of a frame {frame_counts} {unit} {frame}, of a hold mean {floor.mean_counts:.3g} {mean}",
    ]
    if report.left_out:
        presses = first_of(report.left_out, MOST_LISTED)
        lines.append(f"left out, because their force is an outlier: presses {presses}")
    if not report.calibrated:
        lines.append("pose, E and S are assumed; --calibration CAL takes those of a fit")
    lines += ["", f"{'visible':<17}{'smallest strength':>18}   looks the same as"]
    for name in report.visible:
        one = report.effects[name]
        least = f"{one.smallest_strength:.2g}" if one.smallest_strength >= 0.01 else "< 0.01"
        lines.append(f"{name:<17}{least:>18}   {', '.join(one.consistent_with[1:]) or '–'}")
    if report.cannot_see:
        lines += ["", "not visible      why"]
    for name in report.cannot_see:
        least = report.effects[name].smallest_strength
        beyond = f" (seen from strength {least:.2g})" if least < 10 else ""
        lines.append(f"{name:<17}{report.reasons[name]}{beyond}")
    return [
        *lines,
        "",
        f"Strength 1 is a typical case. The smallest strength is detected in {100 * settings.power:.0f} % of cases at "
        f"{100 * settings.false_alarm:.0f} % false",
        "alarms over all effects, if the base model fits to the noise; if its contact law does not, more is needed.",
    ]
