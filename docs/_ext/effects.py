"""``{effect} NAME`` and ``{effects}``: what the registry of effects says of one effect, and of all.

``{signature} NAME`` draws what it does, ``{seen} NAME`` and ``{seen}`` show what sessions tell of it.
"""

from __future__ import annotations

import inspect
import json
import sys
from pathlib import Path
from typing import Any

from docutils import nodes
from docutils.parsers.rst.directives.images import Figure
from docutils.statemachine import StringList
from sphinx.application import Sphinx
from sphinx.environment import BuildEnvironment
from sphinx.util.docutils import SphinxDirective

from skincal.effects import COVARIATES, EFFECTS, Effect, EffectParameter

MADE = Path("_build", "made", "effects")

_STAGES = ("pose and force", "contact", "spread", "memory", "transfer", "crosstalk", "converter")


def equation(effect: Effect) -> list[str]:
    """What the effect's module says of it, after its first line."""
    text = inspect.getdoc(sys.modules[type(effect).__module__]) or ""
    first, _, rest = text.partition("\n\n")
    if not rest:  # all in one line: "Taxels differ in gain: y_j = ..."
        rest = first
    lines: list[str] = []
    inside = False
    for line in rest.split("\n"):
        block = line.startswith("    ")
        if block != inside and (block or line):
            lines.append("```text" if block else "```")
            inside = block
        lines.append(line[4:] if block else line)
    return [*lines, "```"] if inside else lines


def _row(p: EffectParameter) -> str:
    neutral = f"{p.neutral:g}" if p.role == "strength" else f"{p.role}, {p.neutral:g}"
    unit = "" if p.unit == "-" else p.unit
    shape = "" if p.shape == "scalar" else f", {p.shape.replace('-', ' ')}"
    return f"| `{p.name}` | {unit} | {neutral} | {p.low:g} … {p.high:g} | {p.description}{shape} |"


def _recorded(effect: Effect) -> list[str]:
    """Covariates of an effect that a dataset records, not those that are worked out of others."""
    return [name for name in effect.all_covariates if COVARIATES[name].cure]


class OneEffect(SphinxDirective):
    """One effect: meaning, equation, parameters, what it needs, source."""

    required_arguments = 1

    def run(self) -> list[nodes.Node]:
        """The text."""
        effect = EFFECTS[self.arguments[0]]
        needs = ", ".join(f"`{COVARIATES[name].attribute}`" for name in _recorded(effect)) or "none"
        lines = [
            f"*{effect.meaning[0].upper()}{effect.meaning[1:]}.*",
            "",
            *equation(effect),
            "",
            "| parameter | unit | neutral | bounds | |",
            "|---|---|---|---|---|",
            *(_row(p) for p in effect.parameters),
            "",
            f"Stage: {_STAGES[effect.stage]}. Covariates: {needs}. "
            f"It {'remembers earlier samples' if effect.has_memory else 'has no memory'}.",
            "",
            f"Source: {effect.source}",
        ]
        return self.parse_text_to_nodes("\n".join(lines))


class AllEffects(SphinxDirective):
    """The table of all effects in the order of the chain."""

    def run(self) -> list[nodes.Node]:
        """One row an effect."""
        rows = [
            f"| {_STAGES[e.stage]} | {{doc}}`{e.name} <{e.name}>` | {e.meaning} | {', '.join(_recorded(e))} |"
            for e in EFFECTS.values()
        ]
        head = ["| stage | effect | what is meant | covariates |", "|---|---|---|---|"]
        return self.parse_text_to_nodes("\n".join(head + rows))


class SignatureOf(Figure):
    """``{signature} NAME``: the picture of an effect, drawn from the model as the page is built."""

    def run(self) -> list[nodes.Node]:
        """The figure."""
        from signatures import STRENGTH, signature_figure

        from skincal.report.style import save

        env: BuildEnvironment = self.state.document.settings.env
        name = self.arguments[0]
        kept = MADE / f"{name}.png"
        (Path(env.srcdir) / kept).parent.mkdir(parents=True, exist_ok=True)
        save(signature_figure(name), Path(env.srcdir) / kept)
        self.arguments[0] = "/" + kept.as_posix()
        self.options["alt"] = f"What {name} does to presses"
        self.options["width"] = "100%"
        self.content = StringList(
            [
                f"The model with the effect at {STRENGTH:g} times its typical strength, and without it. Left: where it "
                "shows best; right: the image of 4 by 4 taxels where it changes most, + is where the press is."
            ],
            source=f"signature {name}",
        )
        return super().run()


SESSIONS = {
    "paper_static": "{n} static presses, as in the paper: hold means, no times, no covariates",
    "paper_with_frames": "the paper's {n} presses with frames, times and tangential forces",
    "full": "a full session: {n} presses, frames, repeats, two speeds, two poses, two indenters",
}


class Seen(SphinxDirective):
    """``{seen} NAME``: what three kinds of sessions tell of an effect, as measured; ``{seen}``: of all effects."""

    optional_arguments = 1

    def run(self) -> list[nodes.Node]:
        """A table."""
        path = Path(self.config.results_folder, "effects_seen.json")
        if not path.is_file():
            return self.parse_text_to_nodes(
                f"**Not measured**: there is no `benchmarks/results/{path.name}`."
            )
        self.env.note_dependency(path)
        sessions = json.loads(path.read_text(encoding="utf-8"))["sessions"]
        lines = seen_of_one(sessions, self.arguments[0]) if self.arguments else seen_of_all(sessions)
        return self.parse_text_to_nodes("\n".join(lines))


def seen_of_one(sessions: dict[str, Any], name: str) -> list[str]:
    """What sessions tell of one effect, as Markdown."""
    lines = [
        "| presses | seen from strength | looks the same as | imitated best by (cosine) |",
        "|---|---|---|---|",
    ]
    for key, title in SESSIONS.items():
        one = sessions[key]["effects"][name]
        same = ", ".join(f"`{other}`" for other in one["consistent_with"][1:]) or "–"
        likest = ", ".join(f"`{other}` {cosine:.2f}" for other, cosine in one["imitated_by"].items()) or "–"
        lines.append(f"| {title.format(n=sessions[key]['presses'])} | {_smallest(one)} | {same} | {likest} |")
    return lines


def seen_of_all(sessions: dict[str, Any]) -> list[str]:
    """From which strength on sessions show each effect, as Markdown."""
    titles = ("static", "with frames", "full session", "looks the same there as")
    lines = ["| effect | " + " | ".join(titles) + " |", "|---" * (len(titles) + 1) + "|"]
    for name in EFFECTS:
        rows = [sessions[key]["effects"][name] for key in SESSIONS]
        same = ", ".join(f"`{other}`" for other in rows[-1]["consistent_with"][1:]) or "–"
        cells = [_number(row) for row in rows]
        lines.append(f"| {{doc}}`{name} <{name}>` | {' | '.join(cells)} | {same} |")
    return lines


def _number(one: dict[str, Any]) -> str:
    value = one["smallest_strength"]
    return "never" if value is None else f"{value:g}" if one["visible"] else f"no ({value:g})"


def _smallest(one: dict[str, Any]) -> str:
    return _number(one) if one["visible"] else f"{_number(one)}: {one['reason']}"


def setup(app: Sphinx) -> dict[str, bool]:
    """Registers the directives."""
    app.add_directive("effect", OneEffect)
    app.add_directive("effects", AllEffects)
    app.add_directive("signature", SignatureOf)
    app.add_directive("seen", Seen)
    return {"parallel_read_safe": True, "parallel_write_safe": True}
