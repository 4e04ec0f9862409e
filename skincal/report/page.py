"""Self-contained pages and other texts from templates, and their figures as files."""

from __future__ import annotations

import base64
import re
import tomllib
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache, lru_cache
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from jinja2 import Environment, PackageLoader, StrictUndefined, select_autoescape
from markupsafe import Markup, escape
from numpy.typing import ArrayLike

from skincal.calibration import Calibration
from skincal.dataset import Dataset
from skincal.errors import readable
from skincal.files import real
from skincal.units import in_unit

if TYPE_CHECKING:
    from matplotlib.figure import Figure

PAGE = "report.html"


@dataclass(frozen=True)
class Picture:
    """A figure of a page: its caption, with code in backticks, its file next to the page, its content as base64."""

    title: str
    caption: str
    file: str
    data: str


@cache
def _captions() -> dict[str, dict[str, str]]:
    file = Path(__file__).parent / "templates" / "captions.toml"
    return tomllib.loads(file.read_text(encoding="utf-8"))


def picture(figure: Figure, stem: str, folder: Path, unit: str | None = None) -> Picture:
    """Write a figure into a folder; return it for a page, with its title and caption of ``captions.toml``."""
    from skincal.report.style import png_bytes, relabel

    relabel(figure, unit)
    content, words = png_bytes(figure), _captions()[stem]
    (folder / f"{stem}.png").write_bytes(content)
    data = base64.b64encode(content).decode("ascii")
    caption = in_unit(" ".join(words["caption"].split()), unit)
    return Picture(words["title"], caption, f"{stem}.png", data)


def write_page(
    template: str, folder: Path, dataset: Dataset, calibration: Calibration, **values: Any
) -> None:
    """Write ``report.html`` into a folder."""
    folder_name = real(dataset.folder).name if dataset.folder else "dataset"
    own = {
        "name": escape(calibration.provenance.dataset or folder_name),
        "source": escape(dataset.meta.source),
        "provenance": _provenance(calibration),
        "findings": sorted(calibration.findings, key=lambda finding: finding.severity != "warning"),
        "calibration": calibration,
    }
    page = rendered(template, dataset.meta.sensor.unit, **(own | values))
    (folder / PAGE).write_text(page, encoding="utf-8")


def rendered(template: str, unit: str | None = None, **values: Any) -> str:
    """Return a text from a template of ``skincal/report/templates``; all its variables must be given.

    ``unit`` of the taxel values replaces counts in values that are texts; None: counts.
    """
    return readable(_environment(unit).get_template(template).render(**values))


def macro(template: str, name: str, *values: Any) -> str:
    """Return the text of a macro of a template."""
    return str(getattr(_environment(None).get_template(template).module, name)(*values)).strip()


@lru_cache(maxsize=8)
def _environment(unit: str | None) -> Environment:
    environment = Environment(
        loader=PackageLoader("skincal.report"),
        autoescape=select_autoescape(["html"]),
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
        finalize=lambda value: in_unit(value, unit) if type(value) is str else value,
    )
    environment.globals["counts"] = unit or "counts"
    environment.filters |= {"code": with_code, "capital": capital, "span": span, "listed": listed}
    return environment


def percent(part: float) -> str:
    """Return a part of 1 as text."""
    return f"{100 * part:g} %"


def with_code(text: str) -> Markup:
    """Return escaped text, with the parts between backticks set as code."""
    return Markup(re.sub("`([^`]*)`", r"<code>\1</code>", str(escape(text))))


def capital(text: str) -> str:
    """Return a text with a capital first letter."""
    return text[:1].upper() + text[1:]


def listed(words: Sequence[str]) -> str:
    """Return words as a list in a sentence: a, b and c."""
    return words[0] if len(words) == 1 else ", ".join(words[:-1]) + " and " + words[-1]


def span(numbers: ArrayLike) -> str:
    """Return a number, or the least and the largest of several."""
    values = np.atleast_1d(np.asarray(numbers, dtype=np.float64))
    low, high = f"{values.min():.4g}", f"{values.max():.4g}"
    return (low if low == high else f"{low} to {high}").replace("-", "−")


def _provenance(calibration: Calibration) -> list[tuple[str, str]]:
    of = calibration.provenance
    rows = [
        ("dataset", of.dataset),
        ("its SHA-256", of.dataset_sha256),
        ("skincal", of.version),
        ("command", of.command),
        ("seed", "" if of.seed is None else str(of.seed)),
        ("time", "" if of.time is None else of.time.isoformat(sep=" ")),
        ("options", ", ".join(f"{name} = {_plain(value)}" for name, value in of.options.items())),
    ]
    return [(name, words) for name, words in rows if words]


def _plain(value: object) -> str:
    if isinstance(value, float):
        return f"{value:.6g}"
    if isinstance(value, dict):
        return "{" + ", ".join(f"{k} = {_plain(v)}" for k, v in value.items()) + "}"
    if isinstance(value, list | tuple):
        return "[" + ", ".join(_plain(v) for v in value) + "]"
    return str(value)
