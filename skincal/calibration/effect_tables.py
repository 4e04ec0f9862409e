"""``[[effects]]`` and ``[[findings]]`` of ``calibration.toml``: a strict reader, and a writer."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any, Final, cast

from skincal.calibration.effect_checks import check_effect, check_name
from skincal.calibration.parts import SEVERITIES, Effect, Finding, Numbers
from skincal.calibration.values import number_list, shown
from skincal.dataset.findings import Findings
from skincal.dataset.toml_table import TomlTable, is_number

_EFFECT: Final = ("name", "parameters", "intervals", "poses")
_FINDING: Final = ("code", "severity", "text", "advice", "mapping")

Range = tuple[Numbers, Numbers]


def plain_effect(effect: Effect) -> dict[str, Any]:
    """Return one entry of ``[[effects]]`` as TOML writes it."""
    plain: dict[str, Any] = {
        "name": effect.name,
        "parameters": {name: _plain(value) for name, value in effect.parameters.items()},
    }
    if effect.intervals:
        plain["intervals"] = {name: [_plain(v) for v in pair] for name, pair in effect.intervals.items()}
    if effect.poses:
        plain["poses"] = list(effect.poses)
    return plain | dict(effect.extra)


def _plain(numbers: Numbers) -> float | list[float]:
    return list(numbers) if isinstance(numbers, tuple) else numbers


def effects_from(top: TomlTable, findings: Findings, file: str, taxels: int) -> tuple[Effect, ...]:
    """Return the effects; add errors for invalid ones.

    Args:
        top: the file.
        findings: collects the errors.
        file: its name.
        taxels: number of taxels J; 0 if unknown.
    """
    found: list[Effect] = []
    for table, others in _entries(top, findings, file, "effects", _EFFECT):
        effect = _effect(table, others)
        if check_name(table, effect.name, [one.name for one in found]):
            check_effect(table, effect, taxels)
        found.append(effect)
    return tuple(found)


def findings_from(top: TomlTable, findings: Findings, file: str) -> tuple[Finding, ...]:
    """Return the findings of the fit; add errors for invalid ones."""
    return tuple(
        Finding(
            code=table.text("code", "a word"),
            severity=table.choice("severity", SEVERITIES),
            text=table.text("text", "the finding"),
            advice=table.text("advice", "what to do", default=""),
            mapping=table.text("mapping", "lines of a mapping file", default=""),
        )
        for table, _ in _entries(top, findings, file, "findings", _FINDING)
    )


def _entries(
    top: TomlTable, findings: Findings, file: str, name: str, known: tuple[str, ...]
) -> Iterator[tuple[TomlTable, dict[str, Any]]]:
    """Yield the tables of a list of tables, each named by its number, with their unknown keys."""
    entries = top.raw(name)
    if entries is None:
        return
    if not isinstance(entries, list) or not all(isinstance(e, dict) for e in cast("list[object]", entries)):
        top.error(name, f"tables [[{name}]]", shown(entries))
        return
    for number, entry in enumerate(cast("list[dict[str, Any]]", entries), start=1):
        # These tables are open, like that of the loss: further keys are kept without a warning.
        others = {key: value for key, value in entry.items() if key not in known}
        table = {key: value for key, value in entry.items() if key in known}
        yield TomlTable(findings, file, f"{name} {number}", table, known), others


def _effect(table: TomlTable, extra: Mapping[str, Any]) -> Effect:
    name = table.text("name", "the name of an effect")
    parameters = {
        key: numbers
        for key, value in _table(table, "parameters").items()
        if (numbers := _numbers(table, key, value)) is not None
    }
    intervals = {
        key: pair
        for key, value in _table(table, "intervals").items()
        if (pair := _range(table, key, value, parameters)) is not None
    }
    poses = table.names("poses", "names of hand poses, each once") if table.has("poses") else ()
    return Effect(name, parameters, intervals, extra, poses)


def _table(table: TomlTable, key: str) -> Mapping[str, Any]:
    value = table.raw(key)
    if value is None:
        return {}
    if isinstance(value, dict):
        return cast("dict[str, Any]", value)
    table.error(key, "a table", shown(value))
    return {}


def _numbers(table: TomlTable, key: str, value: object) -> Numbers | None:
    numbers = float(value) if is_number(value) else number_list(value)
    if numbers is None or numbers == ():
        table.error(f"parameters.{key}", "a number, or a list of numbers", shown(value))
        return None
    return numbers


def _range(table: TomlTable, key: str, value: object, parameters: Mapping[str, Numbers]) -> Range | None:
    where = f"intervals.{key}"
    if key not in parameters:
        table.error(where, f"one of the parameters: {', '.join(parameters) or 'none'}", "an unknown name")
        return None
    like = parameters[key]
    sides = [_side(side, like) for side in cast("list[object]", value)] if isinstance(value, list) else []
    known = [side for side in sides if side is not None]
    if len(sides) != 2 or len(known) != 2 or any(low > high for low, high in zip(*known, strict=True)):
        size = f", each a list of {len(like)} numbers" if isinstance(like, tuple) else ""
        table.error(where, f"[low, high], in ascending order{size}", shown(value))
        return None
    low, high = known
    return (low, high) if isinstance(like, tuple) else (low[0], high[0])


def _side(value: object, like: Numbers) -> tuple[float, ...] | None:
    """Return one end of an interval as numbers of the parameter's shape; None for anything else."""
    numbers = number_list(value if isinstance(like, tuple) else [value], infinite=True)
    size = len(like) if isinstance(like, tuple) else 1
    return numbers if numbers is not None and len(numbers) == size else None
