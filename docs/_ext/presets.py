"""``{presets}``: every parameter that may be randomized, with its published ranges, read from the program itself."""

from __future__ import annotations

from docutils import nodes
from sphinx.application import Sphinx
from sphinx.util.docutils import SphinxDirective

from skincal.ranges import NAMES, PRESETS, Parameter, Ranges, preset


def shown(parameter: Parameter) -> str:
    """A range in a few characters."""
    return f"{parameter}{', each step' if parameter.mode == 'step' else ''}"


def _row(path: str, presets: list[Ranges]) -> str:
    name = NAMES[path]
    cells = [shown(ranges[path]) if path in ranges else "–" for ranges in presets]
    return f"| `{path}` | {name.unit} | {name.meaning} | {' | '.join(cells)} |"


class Presets(SphinxDirective):
    """The table of all parameters."""

    def run(self) -> list[nodes.Node]:
        """One row a parameter."""
        presets = [preset(name) for name in PRESETS]
        lines = [f"| parameter | unit | | {' | '.join(PRESETS)} |", "|---|---|---|" + "---|" * len(presets)]
        return self.parse_text_to_nodes("\n".join(lines + [_row(path, presets) for path in NAMES]))


def setup(app: Sphinx) -> dict[str, bool]:
    """Registers the directive."""
    app.add_directive("presets", Presets)
    return {"parallel_read_safe": True, "parallel_write_safe": True}
