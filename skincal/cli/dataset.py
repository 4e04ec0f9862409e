"""``skincal dataset``: check a dataset, or show its content."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from skincal.cli import options
from skincal.cli.options import example, option
from skincal.cli.terminal import (
    MOST_LISTED,
    answer,
    findings_json,
    note,
    picked,
    print_json,
    problems_json,
    say,
    table,
    warn,
)
from skincal.errors import first_of

if TYPE_CHECKING:
    from skincal.dataset import Dataset
    from skincal.dataset.rest import Summary

app = typer.Typer(
    no_args_is_help=True,
    help="Check a dataset, or show its content.",
    epilog=example("skincal dataset check data/paper-like"),
)

_OUT = "Picture to write (PNG, PDF or SVG) [default: NAME.png here]"
_THRESHOLD = (
    "Counts above rest that make a taxel active [default: 5; by the noise where all values are smaller]"
)


@app.command(
    short_help="Check every file and report all problems.",
    epilog=example("skincal dataset check data/paper-like", "skincal dataset check data/paper-like --json"),
)
def check(dataset: options.Dataset, as_json: options.Json = False) -> None:
    """Check every file of a dataset, and report every problem with file, column and row.

    A note states a limit of good data. Exit status 0: usable, perhaps with warnings; 2: not usable.
    """
    from skincal.dataset import check_dataset
    from skincal.dataset.uniform_pressure import notes_on
    from skincal.errors import InputError

    found = check_dataset(dataset)
    warn(found.warnings)
    notes = () if found.dataset is None else notes_on(found.dataset)
    note(notes)
    if as_json:
        print_json(
            {
                "dataset": dataset,
                "ok": not found.errors,
                "errors": problems_json(found.errors),
                "warnings": problems_json(found.warnings),
                "notes": notes,
                "findings": findings_json((*found.errors, *found.warnings)),
            }
        )
    if found.errors:
        # The user asked for all of them, however many.
        say(f"skincal: error: {InputError(found.errors)}")
        raise typer.Exit(InputError.exit_status)
    if not as_json and found.dataset is not None:
        frames = found.dataset.frames
        count = "no frames" if frames is None else f"{len(frames)} frames"
        doubtful = any(warning.code and warning.severity == "warning" for warning in found.warnings)
        verdict = "doubtful, see the warnings" if doubtful else "good"
        typer.echo(f"{dataset}: {verdict}, {len(found.dataset.presses)} presses, {count}")


@app.command(
    short_help="Show the content: a summary and a picture.",
    epilog=example("skincal dataset show data/paper-like --out paper.png"),
)
def show(
    dataset: options.Dataset,
    out: Annotated[Path | None, option(_OUT)] = None,
    threshold: Annotated[float | None, option(_THRESHOLD, min=0.0)] = None,
    as_json: options.Json = False,
    force: options.Force = False,
) -> None:
    """Show the content of a dataset: a summary, and a picture of the presses, forces and images."""
    from rich.text import Text

    from skincal.dataset import read_dataset
    from skincal.dataset.rest import active_threshold, summarise
    from skincal.dataset.uniform_pressure import notes_on
    from skincal.files import real, refuse_existing
    from skincal.report.dataset import dataset_figure
    from skincal.report.style import PICTURE_MARK, checked_suffix, save_whole

    picture = checked_suffix(out or Path(f"{real(dataset).name}.png"))
    refuse_existing(picture, dataset, force=force, mark=PICTURE_MARK)
    data = read_dataset(dataset)
    threshold = active_threshold(data) if threshold is None else threshold
    summary = summarise(data, threshold)
    save_whole(dataset_figure(data, threshold), picture, force=force)
    warn(data.warnings)
    notes = notes_on(data)
    note(notes)
    content = {"dataset": dataset, **_as_json(data, summary), "notes": notes, "picture": picture}
    # Text from the file is not markup.
    rows = [(f"[bold]{name}[/]", Text(text)) for name, text in _lines(data, summary)]
    # A title of the table would be wrapped at the width of the table.
    shown = table(("", ""), rows, show_header=False)
    answer(as_json, content, str(dataset), shown, then=f"picture: {picture}")


def _as_json(data: Dataset, summary: Summary) -> dict[str, Any]:
    sensor = data.meta.sensor
    low, median, high = summary.force_n
    return {
        "sha256": data.sha256,
        "source": data.meta.source,
        "assumed": data.meta.assumed,
        "sensor": picked(sensor, "rows cols"),
        "surface": data.meta.surface.kind,
        "indenter": data.meta.indenter.kind,
        **picked(summary, "presses sites frames phases session_s"),
        "force_n": {"min": low, "median": median, "max": high},
        "active_taxels": {
            "threshold_counts": summary.threshold_counts,
            "presses_by_number": summary.active,
            "presses_with_two": summary.usable,
        },
        "silent_taxels": summary.silent,
        "dead_taxels": summary.dead,
        **picked(summary, "labels columns"),
        "warnings": problems_json(data.warnings),
        "findings": findings_json(data.warnings),
    }


def _lines(data: Dataset, summary: Summary) -> list[tuple[str, str]]:
    meta, sensor = data.meta, data.meta.sensor
    low, median, high = summary.force_n
    above = f"before a fit's correction for clipping, over {summary.threshold_counts:.3g} {sensor.unit_label}"
    lines = [
        ("source", meta.source or "not said"),
        ("sensor", f"{sensor.rows} x {sensor.cols} taxels on a {meta.surface}"),
        ("indenter", str(meta.indenter)),
        ("presses", str(summary.presses) + ("" if summary.sites is None else f" at {summary.sites} targets")),
        ("force", f"{low:.3g} to {high:.3g} N, median {median:.3g} N"),
        ("answered", f"{summary.usable} presses by two taxels or more ({above})"),
    ]
    if summary.frames:
        phases = ", ".join(f"{count} {phase}" for phase, count in summary.phases.items())
        lines.append(("frames", f"{summary.frames}: {phases}"))
    if summary.session_s is not None:
        lines.append(("session", f"{summary.session_s:.4g} s"))
    for name, values in summary.labels.items():
        counts = [f"{value}: {count}" for value, count in values.items()]
        lines.append((name, first_of(counts, MOST_LISTED)))
    for name, taxels in (("silent", summary.silent), ("dead", summary.dead)):
        if taxels:
            lines.append((f"{name} taxels", first_of(taxels, MOST_LISTED)))
    return [*lines, *([("assumed", ", ".join(meta.assumed))] if meta.assumed else [])]
