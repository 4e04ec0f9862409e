"""``skincal dataset``: check a dataset, or show its content."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from skincal.cli.common import (
    DatasetArgument,
    ForceOption,
    JsonOption,
    example,
    findings_json,
    print_json,
    problems_json,
    say,
    warn,
)

if TYPE_CHECKING:
    from rich.table import Table

    from skincal.dataset import Dataset
    from skincal.dataset.summary import Summary

app = typer.Typer(
    no_args_is_help=True,
    help="Check a dataset, or show its content.",
    epilog=example("skincal dataset check data/paper-like"),
)


@app.command(
    short_help="Check every file and report all problems.",
    epilog=example("skincal dataset check data/paper-like", "skincal dataset check data/paper-like --json"),
)
def check(dataset: DatasetArgument, as_json: JsonOption = False) -> None:
    """Check every file of a dataset, and report every problem with file, column and row.

    A note states a limit of good data. Exit status 0: usable, perhaps with warnings; 2: not usable.
    """
    from skincal.dataset import check_dataset
    from skincal.dataset.uniform_pressure import notes_on
    from skincal.errors import InputError

    found = check_dataset(dataset)
    warn(found.warnings)
    notes = () if found.dataset is None else notes_on(found.dataset)
    _note(notes)
    if as_json:
        found_out = {
            "errors": problems_json(found.errors),
            "warnings": problems_json(found.warnings),
            "notes": notes,
            "findings": findings_json((*found.errors, *found.warnings)),
        }
        print_json({"dataset": dataset, "ok": not found.errors, **found_out})
    if found.errors:
        # The user asked for all of them, however many.
        say(f"skincal: error: {InputError(found.errors)}")
        raise typer.Exit(InputError.exit_status)
    if not as_json and found.dataset is not None:
        frames = found.dataset.frames
        count = "no frames" if frames is None else f"{len(frames)} frames"
        typer.echo(f"{dataset}: good, {len(found.dataset.presses)} presses, {count}")


@app.command(
    short_help="Show the content: a summary and a picture.",
    epilog=example("skincal dataset show data/paper-like --out paper.png"),
)
def show(
    dataset: DatasetArgument,
    out: Annotated[
        Path | None,
        typer.Option("--out", help="Picture to write (PNG, PDF or SVG) [default: NAME.png here]"),
    ] = None,
    threshold: Annotated[
        float | None,
        typer.Option(
            "--threshold",
            min=0.0,
            help="Counts above rest that make a taxel active [default: 5; by the noise where all values are smaller]",
        ),
    ] = None,
    as_json: JsonOption = False,
    force: ForceOption = False,
) -> None:
    """Show the content of a dataset: a summary, and a picture of the presses, forces and images."""
    from skincal.dataset import read_dataset
    from skincal.dataset.rest import active_threshold
    from skincal.dataset.summary import summarise
    from skincal.dataset.uniform_pressure import notes_on
    from skincal.files import refuse_existing, whole_file
    from skincal.report.dataset import dataset_figure
    from skincal.report.style import PICTURE_MARK, checked_suffix, save

    picture = checked_suffix(out or Path(f"{dataset.resolve().name}.png"))
    refuse_existing(picture, dataset, force=force, mark=PICTURE_MARK)
    data = read_dataset(dataset)
    threshold = active_threshold(data) if threshold is None else threshold
    summary = summarise(data, threshold)
    with whole_file(picture, force=force, mark=PICTURE_MARK) as temporary:
        save(dataset_figure(data, threshold), temporary)
    warn(data.warnings)
    notes = notes_on(data)
    _note(notes)
    if as_json:
        print_json({"dataset": dataset, **_as_json(data, summary), "notes": notes, "picture": picture})
        return
    from rich.console import Console
    from rich.text import Text

    console = Console()
    # A table title would be wrapped at the width of the table.
    console.print(Text(str(dataset), "italic"), soft_wrap=True)
    console.print(_table(data, summary))
    say(f"picture: {picture}")


def _note(notes: tuple[str, ...]) -> None:
    for note in notes:
        say(f"skincal: note: {note}")


def _as_json(data: Dataset, summary: Summary) -> dict[str, Any]:
    sensor = data.meta.sensor
    low, median, high = summary.force_n
    return {
        "sha256": data.sha256,
        "source": data.meta.source,
        "assumed": data.meta.assumed,
        "sensor": {"rows": sensor.rows, "cols": sensor.cols},
        "surface": data.meta.surface.kind,
        "indenter": data.meta.indenter.kind,
        "presses": summary.presses,
        "sites": summary.sites,
        "frames": summary.frames,
        "phases": summary.phases,
        "session_s": summary.session_s,
        "force_n": {"min": low, "median": median, "max": high},
        "active_taxels": {
            "threshold_counts": summary.threshold_counts,
            "presses_by_number": summary.active,
            "presses_with_two": summary.usable,
        },
        "silent_taxels": summary.silent,
        "dead_taxels": summary.dead,
        "labels": summary.labels,
        "columns": summary.columns,
        "warnings": problems_json(data.warnings),
        "findings": findings_json(data.warnings),
    }


def _table(data: Dataset, summary: Summary) -> Table:
    from rich.table import Table
    from rich.text import Text

    # Text from the file is not markup.
    table = Table(show_header=False, box=None, padding=(0, 2, 0, 0))
    table.add_column(style="bold", no_wrap=True)
    table.add_column()
    for name, text in _lines(data, summary):
        table.add_row(name, Text(text))
    return table


def _lines(data: Dataset, summary: Summary) -> list[tuple[str, str]]:
    meta, sensor = data.meta, data.meta.sensor
    low, median, high = summary.force_n
    lines = [
        ("source", meta.source or "not said"),
        (
            "sensor",
            f"{sensor.rows} x {sensor.cols} taxels on a {_shape(meta.surface.kind, meta.surface.radius_m)}",
        ),
        ("indenter", _shape(meta.indenter.kind, meta.indenter.radius_m)),
        ("presses", str(summary.presses) + ("" if summary.sites is None else f" at {summary.sites} targets")),
        ("force", f"{low:.3g} to {high:.3g} N, median {median:.3g} N"),
        (
            "answered",
            f"{summary.usable} presses by two taxels or more (over {summary.threshold_counts:.3g} {sensor.unit_label})",
        ),
    ]
    if summary.frames:
        phases = ", ".join(f"{count} {phase}" for phase, count in summary.phases.items())
        lines.append(("frames", f"{summary.frames}: {phases}"))
    if summary.session_s is not None:
        lines.append(("session", f"{summary.session_s:.4g} s"))
    lines += [(name, _counts(values)) for name, values in summary.labels.items()]
    for name, taxels in (("silent", summary.silent), ("dead", summary.dead)):
        if taxels:
            shown = ", ".join(taxels[:8]) + (f" and {len(taxels) - 8} more" if len(taxels) > 8 else "")
            lines.append((f"{name} taxels", shown))
    if meta.assumed:
        lines.append(("assumed", ", ".join(meta.assumed)))
    return lines


def _shape(kind: str, radius_m: float | None) -> str:
    return kind if radius_m is None else f"{kind} of radius {radius_m * 1e3:g} mm"


def _counts(values: Any) -> str:
    shown = list(values.items())[:8]
    more = f" and {len(values) - 8} more" if len(values) > 8 else ""
    return ", ".join(f"{value}: {count}" for value, count in shown) + more
