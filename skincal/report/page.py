"""Self-contained pages, and their figures as files."""

from __future__ import annotations

import base64
import re
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from jinja2 import Environment, PackageLoader, StrictUndefined, select_autoescape
from markupsafe import Markup, escape
from matplotlib.figure import Figure

from skincal.report.style import png_bytes, relabel
from skincal.units import in_unit


@dataclass(frozen=True)
class Picture:
    """A figure of a page.

    Attributes:
        title: title above it.
        caption: explanation; text between backticks is code.
        file: its file name next to the page.
        data: its content as base64.
    """

    title: str
    caption: str
    file: str
    data: str


def picture(
    figure: Figure, stem: str, title: str, caption: str, folder: Path, unit: str | None = None
) -> Picture:
    """Write a figure into a folder; return it for a page.

    Args:
        figure: the figure; its texts may speak of counts.
        stem: name of its file without the suffix.
        title: title above it.
        caption: explanation.
        folder: an existing folder.
        unit: unit of the taxel values; None: counts.
    """
    relabel(figure, unit)
    content, file = png_bytes(figure), f"{stem}.png"
    (folder / file).write_bytes(content)
    return Picture(title, in_unit(caption, unit), file, base64.b64encode(content).decode("ascii"))


def rendered(template: str, unit: str | None = None, **values: Any) -> str:
    """Return a page from a template of ``skincal/report/templates``; all its variables must be given.

    Args:
        template: name of the template.
        unit: unit of the taxel values, which replaces counts in values that are texts; None: counts.
        values: variables of the template.
    """
    environment = Environment(
        loader=PackageLoader("skincal.report"),
        autoescape=select_autoescape(["html"]),
        undefined=StrictUndefined,
        trim_blocks=True,
        finalize=lambda value: in_unit(value, unit) if type(value) is str else value,
    )
    environment.filters["code"] = with_code
    return environment.get_template(template).render(counts=unit or "counts", **values)


def with_code(text: str) -> Markup:
    """Return escaped text, with the parts between backticks set as code."""
    return Markup(re.sub("`([^`]*)`", r"<code>\1</code>", str(escape(text))))
