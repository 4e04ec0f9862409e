"""``skincal export-dr``: randomization ranges from a calibration."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

from skincal.cli import options
from skincal.cli.options import Pair, example, option
from skincal.cli.terminal import answer, problems_json, say, table, warn
from skincal.tasks import PresetName

PUBLISHED_TOP = 255.0
"""Largest count of the converter of the published skins, which have 8 bits."""

EPILOG = example(
    "skincal export-dr cal --out ranges.toml",
    "skincal export-dr cal --out ranges.yaml --preset icra26 --joint",
)

_PRESET = "Published ranges for what the calibration does not know."
_JOINT = "Also write the joint posterior draws: these parameters are drawn together."
_ASSUME = "S [counts per N] to assume where the calibration leaves it open; required there."


def export_dr(
    cal: options.Calibration,
    out: Annotated[Path, option("File to write: .toml, .json or .yaml.")],
    preset: Annotated[PresetName, option(_PRESET)] = "iros24",
    joint: Annotated[bool, option(_JOINT, "--joint")] = False,
    draws: Annotated[int, option("With --joint: write at most this many draws.", min=1, max=10_000)] = 500,
    assume_scale: Annotated[Pair | None, option(_ASSUME, metavar="LOW HIGH")] = None,
    as_json: options.Json = False,
    force: options.Force = False,
) -> None:
    """Write the ranges that a policy should be trained over.

    What the calibration knows comes from it (`source = "calibrated"`), the rest from a preset (`"assumed"`).
    """
    from skincal.calibration import read_calibration
    from skincal.files import refuse_existing
    from skincal.ranges import from_calibration, narrowing, write_ranges
    from skincal.ranges import preset as published
    from skincal.ranges.files import FORMAT, file_format

    file_format(out)
    refuse_existing(out, cal, force=force, mark=FORMAT)
    calibration = read_calibration(cal)
    ranges = from_calibration(calibration, preset, joint=joint, draws=draws, assumed_scale=assume_scale)
    write_ranges(ranges, out, force=force)
    warn((*calibration.warnings, *ranges.warnings))
    for finding in calibration.findings:  # they hold for the ranges too
        if finding.severity != "info":
            say(f"skincal: {finding.severity} of the calibration: {finding.text} {finding.advice}".rstrip())
    sensor = calibration.sensor
    same = sensor.unit in (None, "counts") and sensor.value_max == PUBLISHED_TOP
    rows = narrowing(ranges, published(preset), same_converter=same)
    content = {
        "ranges": out,
        "preset": preset,
        "calibrated": {row.path: {**row.parameter.figures(), "of_preset": row.ratio} for row in rows},
        "assumed": [path for path, parameter in ranges.items() if parameter.source == "assumed"],
        "joint_draws": len(ranges.joint) if ranges.joint else 0,
        "findings": [finding.code for finding in calibration.findings],
        "warnings": problems_json(ranges.warnings),
    }
    cells: list[tuple[str, ...]] = []
    for row in rows:
        before = "–" if row.published is None else str(row.published)
        ratio = "–" if row.ratio != row.ratio else f"{row.ratio:.0%}"
        cells.append((row.path.removeprefix("skin."), str(row.parameter), before, ratio))
    known = len(ranges.calibrated())
    cloud = f", {len(ranges.joint)} draws of the valley" if ranges.joint else ""
    shown = (
        [] if as_json else [table(("calibrated", "range", preset, "width /\npreset's"), cells, right=True)]
    )
    summary = f"{out}: {known} parameters calibrated, {len(ranges) - known} assumed from {preset}{cloud}"
    answer(as_json, content, *shown, summary)
