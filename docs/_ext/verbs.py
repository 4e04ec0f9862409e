"""``{verbs}``: every verb of the command line with its help, options and examples, read from the program itself."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import typer
from docutils import nodes
from sphinx.application import Sphinx
from sphinx.util.docutils import SphinxDirective

from skincal.cli.main import app as program


def verbs(group: Any, path: tuple[str, ...] = ("skincal",)) -> Iterator[tuple[str, Any]]:
    """Every command below a group, those of groups first: its full name and itself."""
    for name, command in sorted(group.commands.items(), key=lambda item: not hasattr(item[1], "commands")):
        if hasattr(command, "commands"):
            yield from verbs(command, (*path, name))
        else:
            yield " ".join((*path, name)), command


def described(name: str, command: Any) -> list[str]:
    """A verb as lines of Markdown."""
    arguments = [p for p in command.params if not p.opts[0].startswith("-")]
    required = [
        f"{p.opts[0]} {_value(p)}" for p in command.params if p.opts[0].startswith("-") and p.required
    ]
    usage = " ".join([name, *(p.metavar or p.name.upper() for p in arguments), *required, "[OPTIONS]"])
    lines = [f"### `{name}`", "", *_text(command.help), "", "```text", usage, "```", ""]
    lines += ["| option | default | |", "|---|---|---|"]
    lines += [_row(p) for p in command.params if p.name != "help"]
    examples = [line.strip() for line in (command.epilog or "").splitlines() if line.startswith("  ")]
    return [*lines, "", "```console", *(f"$ {example}" for example in examples), "```", ""]


def _text(text: str | None) -> list[str]:
    return [line.strip() for line in (text or "").strip().splitlines()]


def _row(parameter: Any) -> str:
    option = parameter.opts[0].startswith("-")
    name = (
        " / ".join([*parameter.opts, *parameter.secondary_opts])
        if option
        else parameter.metavar or parameter.name
    )
    shown = f"`{name}`" + (f" `{value}`" if option and (value := _value(parameter)) else "")
    return f"| {shown} | {_default(parameter)} | {(parameter.help or '').replace('|', chr(92) + '|')} |"


def _value(parameter: Any) -> str:
    """What stands after an option; nothing for a flag."""
    if getattr(parameter, "is_flag", False):
        return ""
    if parameter.nargs == 2:
        return "LOW HIGH"
    return {"out": "PATH"}.get(parameter.name, "VALUE")


def _default(parameter: Any) -> str:
    """The default as a person would type it."""
    if parameter.required:
        return "required"
    if isinstance(parameter.show_default, str):
        return parameter.show_default
    value = parameter.default
    if getattr(parameter, "is_flag", False):
        on, off = parameter.opts[0], (parameter.secondary_opts or [""])[0]
        return f"`{on if value else off}`" if off else ""
    return "" if value is None or parameter.show_default is False else f"`{getattr(value, 'value', value)}`"


class Verbs(SphinxDirective):
    """All verbs, one section each."""

    def run(self) -> list[nodes.Node]:
        """The sections."""
        lines = [
            line
            for name, command in verbs(typer.main.get_command(program))
            for line in described(name, command)
        ]
        return self.parse_text_to_nodes("\n".join(lines), allow_section_headings=True)


def setup(app: Sphinx) -> dict[str, bool]:
    """Registers the directive."""
    app.add_directive("verbs", Verbs)
    return {"parallel_read_safe": True, "parallel_write_safe": True}
