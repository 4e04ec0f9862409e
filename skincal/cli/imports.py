"""``skincal import``: turn recordings of other programs into datasets, by a mapping file."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from skincal.cli import options
from skincal.cli.options import argument, example, option
from skincal.cli.terminal import answer, findings_json, note, picked, problems_json, say, warn

if TYPE_CHECKING:
    from skincal.imports import Imported
    from skincal.imports.alignment import JoinedClock

app = typer.Typer(
    no_args_is_help=True,
    help="Make a dataset from recordings in other formats.",
    epilog=example("skincal import csv --template > mapping.toml"),
)


def _print_template(context: typer.Context, wanted: bool) -> None:
    """Print the commented mapping file of a verb and exit, whatever else the command line says."""
    if wanted:
        import_template(context.info_name or "")
        raise typer.Exit()


def _print_topics(bag: Path | None) -> None:
    if bag is not None:
        from skincal.imports import bag_topics

        for topic, (kind, count) in bag_topics(bag).items():
            typer.echo(f"{topic}  {kind}  {count} messages")
        raise typer.Exit()


def _files(metavar: str, what: str) -> Any:
    return argument(metavar, f"{what}, in the order of the session [default: those that the mapping lists].")


_TEMPLATE = "Print a mapping to start from, and exit."
_TOPICS = "Print the topics of a bag with their types, and exit."
Template = Annotated[bool, option(_TEMPLATE, "--template", is_eager=True, callback=_print_template)]
MappingArgument = Annotated[Path, argument("MAPPING", "Meaning of the source's columns (TOML).")]
TopicsOption = Annotated[Path | None, option(_TOPICS, is_eager=True, callback=_print_topics, metavar="BAG")]


@app.command(
    "csv",
    short_help="From text or array files: presses row by row, or a time series.",
    epilog=example(
        "skincal import csv --template > mapping.toml",
        "skincal import csv mapping.toml presses.csv --out dataset",
    ),
)
def import_csv(
    mapping: MappingArgument,
    out: options.Out,
    files: Annotated[list[Path] | None, _files("FILES", "The recording's files")] = None,
    force: options.Force = False,
    as_json: options.Json = False,
    template: Template = False,
) -> None:
    """Make a dataset from text or array files: presses row by row, or a time series that is cut into presses."""
    from skincal import imports

    _report(imports.import_csv(mapping, out, files or (), force=force), as_json)


@app.command(
    "template",
    short_help="Print a mapping to start from: for csv, rosbag, or a public data set.",
    epilog=example("skincal import template eflesh > mapping.toml"),
)
def import_template(name: Annotated[str, argument("NAME", "csv, rosbag or eflesh.")]) -> None:
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
    out: options.Out,
    bags: Annotated[list[Path] | None, _files("BAGS", "ROS 1 files or ROS 2 folders")] = None,
    force: options.Force = False,
    as_json: options.Json = False,
    template: Template = False,
    topics: TopicsOption = None,
) -> None:
    """Make a dataset from ROS 1 or ROS 2 bags: their streams on one clock, cut into presses."""
    from skincal import imports

    _report(imports.import_rosbag(mapping, out, bags or (), force=force), as_json)


def _offset(clock: JoinedClock) -> str:
    if not clock.estimated:
        return f"{clock.offset_s:+.6g} s, as given"
    rate = f", drifting by {1e6 * clock.rate:+.0f} parts per million" if clock.rate else ""
    return (
        f"{clock.offset_s:+.6f} ± {clock.sigma_s:.2g} s{rate}, by the correlation of {clock.by} with the taxels "
        f"({clock.correlation:.3f})"
    )


def _report(done: Imported, as_json: bool) -> None:
    """Report what was read, left out and written, and draw the alignment of clocks into the dataset's folder."""
    for file in done.read:
        say(f"read {file.rows} rows of {file.file}")
    for clock in done.clocks:
        say(f"clock of {clock.name}: {_offset(clock)}")
    note(done.notes)
    for dropped in done.dropped:
        say(f"left out {dropped}")
    picture = None
    if compared := [clock for clock in done.clocks if len(clock.time_s)]:
        from skincal.report.dataset import clocks_figure
        from skincal.report.style import save_whole

        picture = done.folder / "clocks.png"
        save_whole(clocks_figure(compared), picture, force=True)
        say(f"picture of the clocks: {picture}")
    if done.assumed:
        say(f"assumed, not measured: {', '.join(done.assumed)}")
    warn(done.warnings)
    clocks = [
        {"file": c.name, **picked(c, "offset_s sigma_s rate estimated by correlation")} for c in done.clocks
    ]
    content = {
        "dataset": done.folder,
        **picked(done, "presses frames"),
        "read": [picked(file, "file rows") for file in done.read],
        "dropped": [picked(dropped, "count what why") for dropped in done.dropped],
        **picked(done, "assumed notes"),
        "clocks": clocks,
        "picture": picture,
        "warnings": problems_json(done.warnings),
        "findings": findings_json(done.warnings),
    }
    frames = f", {done.frames} frames" if done.frames else ""
    answer(as_json, content, f"{done.folder}: {done.presses} presses{frames}")
