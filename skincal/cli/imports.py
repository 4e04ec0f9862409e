"""``skincal import``: turn recordings of other programs into datasets, by a mapping file."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from skincal.cli.common import (
    ForceOption,
    JsonOption,
    OutOption,
    example,
    findings_json,
    print_json,
    problems_json,
    say,
    warn,
)

if TYPE_CHECKING:
    from skincal.imports import Imported
    from skincal.imports.alignment import JoinedClock

app = typer.Typer(
    no_args_is_help=True,
    help="Make a dataset from recordings in other formats.",
    epilog=example("skincal import csv --template > mapping.toml"),
)


def _printer(kind: str) -> Callable[[bool], None]:
    """Return a callback that prints a commented mapping file and exits, whatever else the command line says."""

    def show(wanted: bool) -> None:
        if wanted:
            from skincal.imports import template

            typer.echo(template(kind), nl=False)
            raise typer.Exit()

    return show


def _topics(bag: Path | None) -> None:
    """Print the topics of a bag and exit."""
    if bag is not None:
        from skincal.imports import bag_topics

        for topic, (kind, count) in bag_topics(bag).items():
            typer.echo(f"{topic}  {kind}  {count} messages")
        raise typer.Exit()


def _files(metavar: str, what: str) -> typer.models.ArgumentInfo:
    help_ = f"{what}, in the order of the session [default: those that the mapping lists]."
    return typer.Argument(metavar=metavar, help=help_)


def _template(kind: str) -> typer.models.OptionInfo:
    help_ = "Print a mapping to start from, and exit."
    return typer.Option("--template", is_eager=True, callback=_printer(kind), help=help_)


MappingArgument = Annotated[
    Path,
    typer.Argument(metavar="MAPPING", help="Meaning of the source's columns (TOML)."),
]
TopicsOption = Annotated[
    Path | None,
    typer.Option(
        "--topics",
        is_eager=True,
        callback=_topics,
        metavar="BAG",
        help="Print the topics of a bag with their types, and exit.",
    ),
]


@app.command(
    "csv",
    short_help="From text files: presses row by row, or a time series.",
    epilog=example(
        "skincal import csv --template > mapping.toml",
        "skincal import csv mapping.toml presses.csv --out dataset",
    ),
)
def import_csv(
    mapping: MappingArgument,
    out: OutOption,
    files: Annotated[list[Path] | None, _files("FILES", "The recording's files")] = None,
    force: ForceOption = False,
    as_json: JsonOption = False,
    template: Annotated[bool, _template("csv")] = False,
) -> None:
    """Make a dataset from text files: presses row by row, or a time series that is cut into presses."""
    from skincal import imports

    _report_import(imports.import_csv(mapping, out, files or (), force=force), as_json)


@app.command(
    "template",
    short_help="Print a mapping to start from: for csv, rosbag, or a public data set.",
    epilog=example("skincal import template eflesh > mapping.toml"),
)
def import_template(
    name: Annotated[str, typer.Argument(metavar="NAME", help="csv, rosbag or eflesh.")],
) -> None:
    """Print a commented mapping file: a general one, or that of a public data set."""
    from skincal.imports import template

    typer.echo(template(name), nl=False)


@app.command(
    "rosbag",
    short_help="From ROS 1 or ROS 2 bags: their streams on one clock.",
    epilog=example(
        "skincal import rosbag --template > mapping.toml",
        "skincal import rosbag --topics session.bag",
        "skincal import rosbag mapping.toml session.bag --out dataset",
    ),
)
def import_rosbag(
    mapping: MappingArgument,
    out: OutOption,
    bags: Annotated[list[Path] | None, _files("BAGS", "ROS 1 files or ROS 2 folders")] = None,
    force: ForceOption = False,
    as_json: JsonOption = False,
    template: Annotated[bool, _template("rosbag")] = False,
    topics: TopicsOption = None,
) -> None:
    """Make a dataset from ROS 1 or ROS 2 bags: their streams on one clock, cut into presses."""
    from skincal import imports

    _report_import(imports.import_rosbag(mapping, out, bags or (), force=force), as_json)


def _draw_clocks(done: Imported) -> Path | None:
    """Draw the alignment of the clocks into the dataset's folder; return None where no clocks were aligned."""
    compared = [clock for clock in done.clocks if len(clock.time_s)]
    if not compared:
        return None
    from skincal.files import whole_file
    from skincal.report.clocks import clocks_figure
    from skincal.report.style import save

    picture = done.folder / "clocks.png"
    with whole_file(picture, force=True) as temporary:
        save(clocks_figure(compared), temporary)
    return picture


def _offset(clock: JoinedClock) -> str:
    if not clock.estimated:
        return f"{clock.offset_s:+.6g} s, as given"
    rate = f", drifting by {1e6 * clock.rate:+.0f} parts per million" if clock.rate else ""
    return (
        f"{clock.offset_s:+.6f} ± {clock.sigma_s:.2g} s{rate}, by the correlation of {clock.by} with the taxels "
        f"({clock.correlation:.3f})"
    )


def _clock_json(clock: JoinedClock) -> dict[str, Any]:
    return {
        "file": clock.name, "offset_s": clock.offset_s, "sigma_s": clock.sigma_s, "rate": clock.rate,
        "estimated": clock.estimated, "by": clock.by, "correlation": clock.correlation,
    }  # fmt: skip


def _report_import(done: Imported, as_json: bool) -> None:
    """Report what was read, left out and written."""
    for file in done.read:
        say(f"read {file.rows} rows of {file.file}")
    for clock in done.clocks:
        say(f"clock of {clock.name}: {_offset(clock)}")
    for note in done.notes:
        say(f"skincal: note: {note}")
    for dropped in done.dropped:
        say(f"left out {dropped}")
    picture = _draw_clocks(done)
    if picture is not None:
        say(f"picture of the clocks: {picture}")
    if done.assumed:
        say(f"assumed, not measured: {', '.join(done.assumed)}")
    warn(done.warnings)
    if as_json:
        print_json(
            {
                "dataset": done.folder,
                "presses": done.presses,
                "frames": done.frames,
                "read": [{"file": file.file, "rows": file.rows} for file in done.read],
                "dropped": [{"count": d.count, "what": d.what, "why": d.why} for d in done.dropped],
                "assumed": done.assumed,
                "notes": done.notes,
                "clocks": [_clock_json(clock) for clock in done.clocks],
                "picture": picture,
                "warnings": problems_json(done.warnings),
                "findings": findings_json(done.warnings),
            }
        )
        return
    frames = f", {done.frames} frames" if done.frames else ""
    typer.echo(f"{done.folder}: {done.presses} presses{frames}")
