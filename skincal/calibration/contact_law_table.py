"""``[contact_law]`` of ``calibration.toml``: an optional table, which programs that do not know it may leave out."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, Final, cast

from skincal.calibration.parts import LAW, FittedLaw, Interval
from skincal.calibration.values import number_list, shown
from skincal.dataset.findings import Findings
from skincal.dataset.toml_table import TomlTable
from skincal.model import ContactLaw

NAME: Final = "contact_law"
BOUNDS: Final[Mapping[str, Interval]] = {
    "exponent": (0.3, 3.0),
    "spread_m2": (-1e-6, 1e-6),
    "radius_scale": (0.5, 2.0),
    "reference_m": (1e-6, 1e-2),
}
"""Values of a contact law that make sense: it is small beside the foundation."""


def contact_law_from(top: TomlTable, findings: Findings, file: str) -> FittedLaw | None:
    """Return the contact law, if there is one; add errors for invalid values.

    Args:
        top: the file.
        findings: collects the errors.
        file: its name.
    """
    values = top.raw(NAME)
    if values is None:
        return None
    if not isinstance(values, dict):
        top.error(f"[{NAME}]", f"a table [{NAME}]", shown(values))
        return None
    table = TomlTable(findings, file, NAME, cast("dict[str, Any]", values), (*BOUNDS, "intervals"))
    neutral = ContactLaw()
    found = {
        name: table.number(name, f"a number, {low:g} to {high:g}", low=low, high=high)
        if table.has(name)
        else float(getattr(neutral, name))
        for name, (low, high) in BOUNDS.items()
    }
    inside = all(low <= found[name] <= high for name, (low, high) in BOUNDS.items())
    return FittedLaw(ContactLaw(**found) if inside else neutral, _intervals(table))


def _intervals(table: TomlTable) -> dict[str, Interval]:
    given = table.raw("intervals")
    if given is None:
        return {}
    if not isinstance(given, dict):
        table.error("intervals", "a table", shown(given))
        return {}
    found: dict[str, Interval] = {}
    for name, value in cast("dict[str, Any]", given).items():
        ends = number_list(value, infinite=True)
        if name not in LAW:
            table.error(f"intervals.{name}", f"one of {', '.join(LAW)}", "an unknown name")
        elif ends is None or len(ends) != 2 or ends[0] > ends[1]:
            table.error(f"intervals.{name}", "[low, high], in ascending order", shown(value))
        else:
            found[name] = (ends[0], ends[1])
    return found


def plain_contact_law(fitted: FittedLaw | None) -> dict[str, Any]:
    """Return the table as TOML writes it, in a dictionary by its name; an empty one without a law."""
    if fitted is None:
        return {}
    values = {name: float(getattr(fitted.law, name)) for name in BOUNDS}
    return {
        NAME: {
            **values,
            "intervals": {name: [float(v) for v in ends] for name, ends in fitted.intervals.items()},
        }
    }
