"""``{modules} skincal.fitting``: every public module of a package, one section each."""

from __future__ import annotations

import importlib
import pkgutil

from docutils import nodes
from sphinx.application import Sphinx
from sphinx.util.docutils import SphinxDirective


def section(module: str) -> list[str]:
    """One module as Markdown."""
    return [f"## `{module}`", "", "```{eval-rst}", f".. automodule:: {module}", "   :members:", "```", ""]


class Modules(SphinxDirective):
    """All modules of a package, by name."""

    required_arguments = 1

    def run(self) -> list[nodes.Node]:
        """The sections."""
        package = importlib.import_module(self.arguments[0])
        names = sorted(m.name for m in pkgutil.iter_modules(package.__path__) if not m.name.startswith("_"))
        lines = [line for name in names for line in section(f"{package.__name__}.{name}")]
        return self.parse_text_to_nodes("\n".join(lines), allow_section_headings=True)


def setup(app: Sphinx) -> dict[str, bool]:
    """Registers the directive."""
    app.add_directive("modules", Modules)
    return {"parallel_read_safe": True, "parallel_write_safe": True}
