"""``skincal export-dr``: randomization ranges from a calibration."""

from __future__ import annotations

from enum import StrEnum
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from skincal.cli.common import CalibrationArgument, ForceOption, JsonOption, example, print_json, say, warn

if TYPE_CHECKING:
    from rich.table import Table

    from skincal.calibration import Calibration
    from skincal.ranges import Narrowing, Ranges


class Preset(StrEnum):
    """The presets, listed here so that help need not import them."""

    iros24 = "iros24"
    icra26 = "icra26"


PUBLISHED_TOP = 255.0
"""Largest count of the converter of the published skins, which have 8 bits."""

EPILOG = example(
    "skincal export-dr cal --out ranges.toml",
    "skincal export-dr cal --out ranges.yaml --preset icra26 --joint",
)


def export_dr(
    cal: CalibrationArgument,
    out: Annotated[
        Path,
        typer.Option("--out", help="File to write: .toml, .json or .yaml."),
    ],
    preset: Annotated[
        Preset, typer.Option("--preset", help="Published ranges for what the calibration does not know.")
    ] = Preset.iros24,
    joint: Annotated[
        bool,
        typer.Option(
            "--joint", help="Also write the joint posterior draws: these parameters are drawn together."
        ),
    ] = False,
    draws: Annotated[
        int, typer.Option("--draws", min=1, help="With --joint: write at most this many draws.")
    ] = 500,
    assume_scale: Annotated[
        tuple[float, float] | None,
        typer.Option(
            "--assume-scale",
            metavar="LOW HIGH",
            help="S [counts per N] to assume where the calibration leaves it open; required there.",
        ),
    ] = None,
    as_json: JsonOption = False,
    force: ForceOption = False,
) -> None:
    """Write the ranges that a policy should be trained over.

    What the calibration knows comes from it (`source = "calibrated"`), the rest from a preset (`"assumed"`).
    """
    from skincal.calibration import read_calibration
    from skincal.files import refuse_existing
    from skincal.ranges import from_calibration, narrowing, write_ranges
    from skincal.ranges import preset as published
    from skincal.ranges.files import file_format
    from skincal.ranges.plain import FORMAT

    file_format(out)
    refuse_existing(out, cal, force=force, mark=FORMAT)
    calibration = read_calibration(cal)
    ranges = from_calibration(calibration, preset.value, joint=joint, draws=draws, assumed_scale=assume_scale)
    write_ranges(ranges, out, force=force)
    warn((*calibration.warnings, *ranges.warnings))
    _say_findings(calibration)
    sensor = calibration.sensor
    same = sensor.unit in (None, "counts") and sensor.value_max == PUBLISHED_TOP
    rows = narrowing(ranges, published(preset.value), same_converter=same)
    if as_json:
        print_json(_as_json(out, preset.value, calibration, ranges, rows))
        return
    from rich.console import Console

    Console().print(_table(preset.value, rows))
    typer.echo(_summary(out, ranges, preset.value))


def _say_findings(calibration: Calibration) -> None:
    """Print the findings of the fit, which hold for the ranges too."""
    for finding in calibration.findings:
        if finding.severity != "info":
            advice = f" {finding.advice}" if finding.advice else ""
            say(f"skincal: {finding.severity} of the calibration: {finding.text}{advice}")


def _summary(out: Path, ranges: Ranges, preset: str) -> str:
    known = len(ranges.calibrated())
    cloud = f", {len(ranges.joint)} draws of the valley" if ranges.joint else ""
    return f"{out}: {known} parameters calibrated, {len(ranges) - known} assumed from {preset}{cloud}"


def _as_json(
    out: Path, preset: str, calibration: Calibration, ranges: Ranges, rows: tuple[Narrowing, ...]
) -> dict[str, Any]:
    return {
        "ranges": out,
        "preset": preset,
        "calibrated": {row.path: {**row.parameter.figures(), "of_preset": row.ratio} for row in rows},
        "assumed": [path for path, parameter in ranges.items() if parameter.source == "assumed"],
        "joint_draws": len(ranges.joint) if ranges.joint else 0,
        "findings": [finding.code for finding in calibration.findings],
        "warnings": [
            {"place": p.place, "expected": p.expected, "got": p.got, "fix": p.fix} for p in ranges.warnings
        ],
    }


def _table(preset: str, rows: tuple[Narrowing, ...]) -> Table:
    from rich.table import Table

    table = Table(box=None, padding=(0, 2, 0, 0))
    table.add_column("calibrated", no_wrap=True)
    for title in ("range", preset, "width of it"):
        table.add_column(title)
    for row in rows:
        before = "–" if row.published is None else str(row.published)
        ratio = "–" if row.ratio != row.ratio else f"{row.ratio:.0%}"
        table.add_row(row.path.removeprefix("skin."), str(row.parameter), before, ratio)
    return table
