"""``{effect} NAME`` and ``{effects}``: what the registry of effects says of one effect, and of all."""

from __future__ import annotations

import inspect
import sys

from docutils import nodes
from sphinx.application import Sphinx
from sphinx.util.docutils import SphinxDirective

from skincal.effects import COVARIATES, EFFECTS, Effect, EffectParameter

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
    neutral = f"{p.neutral:g}" if p.role == "strength" else f"form, {p.neutral:g}"
    unit = "" if p.unit == "-" else p.unit
    shape = "" if p.shape == "scalar" else f", {p.shape.replace('-', ' ')}"
    return f"| `{p.name}` | {unit} | {neutral} | {p.low:g} … {p.high:g} | {p.description}{shape} |"


class OneEffect(SphinxDirective):
    """One effect: meaning, equation, parameters, what it needs, source."""

    required_arguments = 1

    def run(self) -> list[nodes.Node]:
        """The text."""
        effect = EFFECTS[self.arguments[0]]
        needs = ", ".join(f"`{COVARIATES[name]}`" for name in effect.all_covariates) or "none"
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
            f"| {_STAGES[e.stage]} | {{doc}}`{e.name} <{e.name}>` | {e.meaning} | {', '.join(e.all_covariates)} |"
            for e in EFFECTS.values()
        ]
        head = ["| stage | effect | what is meant | covariates |", "|---|---|---|---|"]
        return self.parse_text_to_nodes("\n".join(head + rows))


def setup(app: Sphinx) -> dict[str, bool]:
    """Registers the directives."""
    app.add_directive("effect", OneEffect)
    app.add_directive("effects", AllEffects)
    return {"parallel_read_safe": True, "parallel_write_safe": True}
