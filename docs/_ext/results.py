"""Results of benchmarks as tables, or the words "not measured" where there are none.

``{results} FILE.json`` shows any file in the folder of results, ``{coverage} FILE.json`` that of the coverage study,
``{speed} FILE.json`` that of the model's speed, ``{against} FILE.json`` that of its meshes against embree alone,
``{scaling} FILE.json`` the cost of an image against sizes, drawn, ``{cost} FILE.json`` what many fits cost,
``{blind} FILE.json`` that of the blind test of the diagnosis.
"""

from __future__ import annotations

import json
import math
import sys
from collections.abc import Mapping
from pathlib import Path
from typing import Any, ClassVar

from docutils import nodes
from docutils.parsers.rst import directives
from sphinx.application import Sphinx
from sphinx.util.docutils import SphinxDirective


def tables(content: Any, title: str = "") -> list[str]:
    """A JSON value as Markdown: numbers by name in one table, lists of objects and objects of objects each in one."""
    if not isinstance(content, Mapping):
        content = {"": content}
    plain = {key: value for key, value in content.items() if not _is_table(value)}
    lines = [f"**{_words(title)}**", ""] if title else []
    if plain:
        lines += [
            "| | |",
            "|---|---|",
            *(f"| {_words(key)} | {_cell(value)} |" for key, value in plain.items()),
            "",
        ]
    for key, value in content.items():
        if _is_table(value):
            lines += [f"**{_words(key)}**", "", *_table(value), ""]
    return lines


def _is_table(value: Any) -> bool:
    rows = list(value.values()) if isinstance(value, Mapping) else value
    return isinstance(rows, list) and bool(rows) and all(isinstance(row, Mapping) for row in rows)


def _table(value: Any) -> list[str]:
    rows = [{"": key, **row} for key, row in value.items()] if isinstance(value, Mapping) else value
    columns = list(dict.fromkeys(key for row in rows for key in row))
    head = ["| " + " | ".join(_words(column) for column in columns) + " |", "|" + "---|" * len(columns)]
    return head + ["| " + " | ".join(_cell(row.get(column, "")) for column in columns) + " |" for row in rows]


def _words(name: Any) -> str:
    return str(name).replace("_", " ")


def _cell(value: Any) -> str:
    if isinstance(value, bool) or value is None:
        return {True: "yes", False: "no", None: "–"}[value]
    if isinstance(value, float):
        return f"{value:.3g}"
    if isinstance(value, list):
        return ", ".join(_cell(item) for item in value)
    if isinstance(value, Mapping):
        return ", ".join(f"{_words(key)}: {_cell(item)}" for key, item in value.items())
    return str(value).replace("|", "\\|")


PARAMETERS = {
    "across_m": "β, as arc",
    "y_m": "y",
    "alpha_rad": "α",
    "elasticity_pa_per_m": "E",
    "scale_per_n": "S",
}
LAWS = {"foundation": "The contact law of the model", "layer": "An elastic layer, which the model is not"}


def coverage(content: Mapping[str, Any]) -> list[str]:
    """The coverage study as Markdown: a sentence and a table for each contact law."""
    lines = []
    for law, title in LAWS.items():
        if law in content["laws"]:
            lines += _law(title, content["laws"][law])
    steps = content.get("study", {}).get("options", {}).get("steps")
    if steps:
        lines += [
            f"The grid, which only gives starting points, had steps of {1e3 * steps['across_m']:g} mm of arc, "
            f"{1e3 * steps['y_m']:g} mm, {math.degrees(steps['alpha_rad']):g}° and {steps['elasticities']} "
            "elasticities.",
            "",
        ]
    return lines


def _law(title: str, found: Mapping[str, Any]) -> list[str]:
    failed = f", {found['failed']} of them without a result" if found["failed"] else ""
    return [
        f"**{title}**: {found['sessions']} sessions{failed}, intervals of {100 * found['level']:g} %.",
        "",
        "| | held the truth | 95 % interval of that | median width | RMS error of the best |",
        "|---|---|---|---|---|",
        *(_coverage_row(name, figures) for name, figures in found.get("parameters", {}).items()),
        "",
    ]


def _coverage_row(name: str, figures: Mapping[str, Any]) -> str:
    low, high = (100 * share for share in figures["coverage_95"])
    width, error = (_cell(figures[key]) for key in ("median_width", "rms_error"))
    return (
        f"| {PARAMETERS.get(name, name)} | {100 * figures['coverage']:.0f} % | {low:.0f} to {high:.0f} % "
        f"| {width} {figures['unit']} | {error} {figures['unit']} |"
    )


def speed(content: Mapping[str, Any]) -> list[str]:
    """Speed of the model against the plain method as Markdown."""
    lines = [
        f"{content['cpu']}, one core, {content['tactile_points']} tactile points, {content['presses']} presses in a "
        "batch. Milliseconds of processor time an image, and how many times faster than the plain method.",
        "",
        "| | plain method | skincal, in a batch | skincal, one by one |",
        "|---|---|---|---|",
    ]
    for case in content["cases"]:
        seconds, times = case["seconds_an_image"], case["times_faster"]
        ours = [
            f"{1e3 * seconds[way]:.3f} ms, {times[way]['plain']:.0f} ×"
            for way in ("ours_batch", "ours_single")
        ]
        lines.append(f"| {case['case']} | {1e3 * seconds['plain']:.1f} ms | {' | '.join(ours)} |")
    return [*lines, ""]


def against(content: Mapping[str, Any]) -> list[str]:
    """Speed of meshes against embree's bare query as Markdown."""
    lines = ["| | embree alone | skincal, in a batch | skincal, one by one |", "|---|---|---|---|"]
    for case in content["cases"]:
        seconds = case["seconds_an_image"]
        if least := seconds.get("bare_query"):
            ours = [
                f"{1e6 * seconds[way]:.0f} µs, {seconds[way] / least:.2f} times that"
                for way in ("ours_batch", "ours_single")
            ]
            lines.append(f"| {case['case']} | {1e6 * least:.0f} µs | {' | '.join(ours)} |")
    return [*lines, ""]


SKINS, CORES = 1000, 100
"""For which the cost of fits is worked out."""


def cost(content: Mapping[str, Any]) -> list[str]:
    """What many fits cost, from the time of one."""
    one, wall = content["processor time [s]"], content["whole process, report included [s]"]
    kept = one / (wall * content["cores"])
    hours = SKINS * one / 3600
    return [
        f"A fit of {content['presses']} presses over {content['combinations']} combinations takes {one:.0f} s of "
        f"processor time, in which {content['cores']} cores are busy for {100 * kept:.0f} % of the whole. {SKINS} "
        f"skins are {hours:.0f} core hours: {60 * hours / CORES:.0f} minutes on {CORES} cores, if each core fits "
        "skins of its own, which needs no traffic between them.",
        "",
    ]


class Results(SphinxDirective):
    """The tables of one file in the folder of results."""

    required_arguments = 1
    option_spec: ClassVar = {"keys": directives.unchanged}

    def run(self) -> list[nodes.Node]:
        """The tables; ``keys`` picks some of them."""
        path = Path(self.config.results_folder, self.arguments[0])
        if not path.is_file():
            return self.parse_text_to_nodes(
                f"**Not measured**: there is no `benchmarks/results/{path.name}`."
            )
        self.env.note_dependency(path)
        content = json.loads(path.read_text(encoding="utf-8"))
        if keys := self.options.get("keys", "").split():
            content = {key: content[key] for key in keys}
        return self.parse_text_to_nodes("\n".join(self.lines(content)))

    def lines(self, content: Any) -> list[str]:
        """The content as Markdown."""
        return tables(content)


class Coverage(Results):
    """The tables of the coverage study."""

    def lines(self, content: Any) -> list[str]:
        """The content as Markdown."""
        return coverage(content)


PICTURED = {
    "power": "How often an effect is seen, and named by its class, over its strength, with intervals of 95 %.",
    "confusion": "What was named first for what was hidden, as counts of sessions; lines part the classes.",
}
"""Tables of the blind test that a page shows as pictures, and what they say."""


def blind(content: Mapping[str, Any], pictures: Mapping[str, str]) -> list[str]:
    """The score of the blind test as Markdown, with what was run; pictures instead of the tables of these names."""
    from benchmarks.blind.markdown import sections

    sessions, missing = len(content.get("sessions", [])), sum(content.get("missing", {}).values())
    study = content.get("study", {})
    if "runs" in study:
        seeds = ", ".join(str(run["seed"]) for run in study["runs"])
        lines = [f"{sessions} sessions of the seeds {seeds} together.", ""]
    else:
        part = f" of {sessions + missing}; **the rest has not been run**" if missing else ""
        lines = [f"{sessions} sessions{part}, seed {study.get('seed', 'unknown')}.", ""]
    for name, text in sections(content["suites"]).items():
        if name in pictures:
            text = f"```{{figure}} {pictures[name]}\n:width: 100%\n\n{PICTURED[name]}\n```"
        lines += [*text.splitlines(), ""]
    return lines


class Blind(Results):
    """The tables of the blind test, and its pictures, drawn as the page is built."""

    def lines(self, content: Any) -> list[str]:
        """The content as Markdown."""
        sys.path.insert(0, str(Path(__file__).parents[2]))
        from benchmarks.blind.figures import figures
        from skincal.report.style import save

        made = Path("_build", "made", "blind")
        (Path(self.env.srcdir) / made).mkdir(parents=True, exist_ok=True)
        pictures: dict[str, str] = {}
        for name, figure in figures(content["suites"]).items():
            save(figure, Path(self.env.srcdir) / made / f"{name}.png")
            pictures[name] = f"/{made.as_posix()}/{name}.png"
        return blind(content, pictures)


class Speed(Results):
    """The table of the model's speed."""

    def lines(self, content: Any) -> list[str]:
        """The content as Markdown."""
        return speed(content)


class Against(Results):
    """The table of meshes against embree."""

    def lines(self, content: Any) -> list[str]:
        """The content as Markdown."""
        return against(content)


class Cost(Results):
    """What many fits cost."""

    def lines(self, content: Any) -> list[str]:
        """The content as Markdown."""
        return cost(content)


class Scaling(Results):
    """The cost of an image against sizes, as a picture with logarithmic axes and a table of slopes."""

    def lines(self, content: Any) -> list[str]:
        """The content as Markdown."""
        sys.path.insert(0, str(Path(__file__).parents[2]))
        from matplotlib.figure import Figure

        from skincal.report.style import save

        cost = content["cost"]
        figure = Figure(figsize=(10, 2.3 * -(-len(cost) // 3)), layout="constrained")
        axes = figure.subplots(-(-len(cost) // 3), 3, squeeze=False).ravel()
        for axis in axes[len(cost) :]:
            axis.set_visible(False)
        for axis, (name, found) in zip(axes, cost.items(), strict=False):
            sizes, us = zip(*((row[name], row["us an image"]) for row in found["points"]), strict=True)
            axis.loglog(sizes, us, marker="o")
            axis.set_title(f"slope {found['slope']:g}")
            axis.set_xlabel(name)
            axis.set_ylabel("µs an image")
        made = Path("_build", "made", "scaling.png")
        (Path(self.env.srcdir) / made).parent.mkdir(parents=True, exist_ok=True)
        save(figure, Path(self.env.srcdir) / made)
        rows = "; ".join(
            f"{name}: " + ", ".join(f"{row[name]:g}: {row['us an image']:g}" for row in found["points"])
            for name, found in cost.items()
        )
        return [f"```{{figure}} /{made.as_posix()}", ":width: 100%", "", f"µs an image. {rows}.", "```", ""]


def setup(app: Sphinx) -> dict[str, bool]:
    """Registers the directives."""
    app.add_config_value("results_folder", "", "env")
    app.add_directive("results", Results)
    app.add_directive("coverage", Coverage)
    app.add_directive("speed", Speed)
    app.add_directive("against", Against)
    app.add_directive("scaling", Scaling)
    app.add_directive("cost", Cost)
    app.add_directive("blind", Blind)
    return {"parallel_read_safe": True, "parallel_write_safe": True}
