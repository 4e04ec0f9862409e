"""What docstrings take for granted: short names in cross references, bars as in |x|, sentences with a colon."""

from __future__ import annotations

import re
from typing import Any

from docutils import nodes
from sphinx.addnodes import pending_xref
from sphinx.application import Sphinx
from sphinx.environment import BuildEnvironment
from sphinx.util.nodes import make_refnode

_VALUES = ("attribute", "data", "property")


def resolve(
    app: Sphinx, env: BuildEnvironment, node: pending_xref, content: nodes.TextElement
) -> nodes.reference | None:
    """A link to the one object whose full name ends in the target; None where there is none, or more than one."""
    if node.get("refdomain") != "py":
        return None
    objects = env.domains.python_domain.objects
    names = [name for name in objects if name.endswith("." + node["reftarget"])]
    package = ".".join((node.get("py:module") or "").split(".")[:2])
    nearest = [name for name in names if name.startswith(package + ".")] or names
    if len(nearest) != 1:
        return None
    entry = objects[nearest[0]]
    return make_refnode(app.builder, node["refdoc"], entry.docname, entry.node_id, content, nearest[0])


def keep_bars(_app: Sphinx, _what: str, _name: str, _object: Any, _options: Any, lines: list[str]) -> None:
    """Bars are those of mathematics, not the marks of a substitution."""
    for number, line in enumerate(lines):
        if "``" not in line:
            lines[number] = line.replace("|", "\\|")


def keep_alias(
    _app: Sphinx,
    _what: str,
    _name: str,
    _object: Any,
    _options: Any,
    signature: str | None,
    result: str | None,
) -> tuple[str | None, ...]:
    """Names of types in a signature without the wrapping that keeps autodoc from unfolding them, and without bounds."""
    return tuple(
        part and _without_bounds(re.sub(r"TypeAliasForwardRef\('(\w+)'\)", r"\1", part))
        for part in (signature, result)
    )


def _without_bounds(text: str) -> str:
    """Return a signature with ``Annotated[int, Key(...)]`` as ``int``."""
    while found := re.search(r"~?(?:typing|types)\.Annotated\[", text):
        depth, comma, end = 0, 0, found.end()
        for end in range(found.end(), len(text)):
            comma = comma or (end if text[end] == "," and not depth else 0)
            depth += (text[end] in "[(") - (text[end] in "])")
            if depth < 0:
                break
        text = text[: found.start()] + text[found.end() : comma or end] + text[end + 1 :]
    return text


_plain: dict[str, list[str]] = {}


def keep_sentence(_app: Sphinx, what: str, name: str, _object: Any, _options: Any, lines: list[str]) -> None:
    """Before napoleon: the docstring of a value is a sentence, in which a colon does not end a type."""
    if what in _VALUES:
        _plain[name] = list(lines)


def restore_sentence(
    _app: Sphinx, what: str, name: str, _object: Any, _options: Any, lines: list[str]
) -> None:
    """After napoleon: the sentence again."""
    if what in _VALUES:
        lines[:] = _plain.pop(name, lines)


def setup(app: Sphinx) -> dict[str, bool]:
    """Registers them."""
    app.connect("missing-reference", resolve)
    app.connect("autodoc-process-signature", keep_alias)
    app.connect("autodoc-process-docstring", keep_bars, priority=300)
    app.connect("autodoc-process-docstring", keep_sentence, priority=400)
    app.connect("autodoc-process-docstring", restore_sentence, priority=600)
    return {"parallel_read_safe": True, "parallel_write_safe": True}
