"""Plan files: TOML or CSV, read strictly, with all faults reported at once."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, fields
from pathlib import Path
from typing import Annotated, Any, cast

import numpy as np

from skincal.bounded import UnreadableError, parse_csv, parse_toml, read_text
from skincal.collect.plan import Kind, Plan, PlannedPress
from skincal.collect.posture import Mount
from skincal.collect.protocols import FullProtocol
from skincal.dataset.columns import TAXEL
from skincal.dataset.findings import Findings, did_you_mean
from skincal.dataset.keys import Key, Length
from skincal.dataset.schema import Table, read_table
from skincal.dataset.schema_errors import Violation, report
from skincal.errors import input_error, readable
from skincal.files import reason, whole_file
from skincal.units import rad

FORMAT = "skincal-plan/1"

SITE = ("u_m", "v_m")
COLUMNS = tuple(field.name for field in fields(PlannedPress))
OTHER_SITES = ("beta_deg", "x_m", "y_m")
LARGEST_FORCE_N = 100.0

MOST_PRESSES, MOST_COLUMNS = 20_000, 100
"""Largest number of presses of a plan (a session of a week); and largest size of a table that lists them."""

_DEFAULT = FullProtocol()


@dataclass(frozen=True, kw_only=True)
class _Press(Table, unknown="refuse"):
    """One press; its site is given by (u, v), or by (beta, y), on a plane (x, y)."""

    u_m: float | None = None
    v_m: float | None = None
    beta_deg: float | None = None
    x_m: float | None = None
    y_m: float | None = None
    force_n: Annotated[float, Key(f"a force [N] above 0, up to {LARGEST_FORCE_N:g}", 1e-3, LARGEST_FORCE_N)]
    speed_m_per_s: Annotated[float, Key("a speed [m/s], 0.0005 to 0.1", 5e-4, 0.1)] = _DEFAULT.speeds_m_per_s[
        -1
    ]
    hold_s: Annotated[float, Key("a time [s], 0.1 to 60", 0.1, 60.0)] = _DEFAULT.holds_s[0]
    pose: str = _DEFAULT.poses[0]
    kind: Kind = "regular"
    indenter_radius_m: Annotated[float | None, Length("a radius [m]", 1e-4, 0.1)] = None

    def site_keys(self, mount: Mount) -> tuple[str, str]:
        """Return the keys that give the site: of the position on the surface if there is any."""
        if all(getattr(self, key) is None for key in OTHER_SITES):
            return SITE
        return ("x_m" if mount.pose_is_plane else "beta_deg"), "y_m"

    def site(self, mount: Mount) -> tuple[float, float]:
        """Return the site in patch coordinates [m]; NaN where it is not given."""
        keys = self.site_keys(mount)
        first, second = (np.nan if (v := getattr(self, key)) is None else v for key in keys)
        if keys == SITE:
            return first, second
        return mount.site_at(rad(first) if keys[0] == "beta_deg" else first, second)

    def site_violations(self, mount: Mount) -> Iterator[Violation]:
        """Yield what is missing or too much of the site, and a site far from the patch."""
        keys, reach = self.site_keys(mount), mount.reach_m
        expected = f"a length [m] within ±{reach:g} of the patch's centre"
        for key in (*SITE, *OTHER_SITES):
            value = getattr(self, key)
            if key in keys and value is None:
                yield key, expected, "nothing", f"Add {key} = …"
            elif key not in keys and value is not None:
                yield key, f"no such key: the site is given by {' and '.join(keys)}", value, "Remove it."
        given = [getattr(self, key) for key in keys]
        for key, offset in zip(keys, self.site(mount), strict=True):
            if None not in given and not abs(offset) <= reach:
                yield key, expected, ", ".join(f"{value:g}" for value in given)


@dataclass(frozen=True, kw_only=True)
class _TomlPlan(Table, unknown="refuse"):
    press: tuple[_Press, ...]
    name: str = ""
    poses: Mapping[str, Annotated[tuple[float, ...], Key("a list of angles [rad], one for each joint")]] = (
        field(default_factory=dict[str, tuple[float, ...]])
    )


@dataclass(frozen=True)
class _CsvPlan(Table):
    line: tuple[_Press, ...]


def read_plan(path: Path, mount: Mount) -> Plan:
    """Read a plan.

    A TOML file has ``format = "skincal-plan/1"``, one ``[[press]]`` per press, optionally ``[poses]``; a CSV file has
    one row per press. A press has its site (``u_m``, ``v_m``, or ``beta_deg``, ``y_m``, on a plane ``x_m``, ``y_m``)
    and ``force_n``; pace, pose and kind default to those of the full protocol.

    Raises:
        InputError: the file has faults; all are reported.
    """
    findings, is_csv = Findings(), path.suffix.lower() == ".csv"
    if path.suffix.lower() not in (".toml", ".csv"):
        got = "a folder" if path.is_dir() else f'"{path.suffix}"'
        raise input_error(str(path), "a plan in .toml or .csv", got)
    try:
        values = {"line": _read_csv(path, findings)} if is_csv else parse_toml(read_text(path))
    except OSError as error:
        raise input_error(str(path), "a plan", reason(error)) from None
    except UnreadableError as error:
        raise input_error(path.name, f"a readable {path.suffix} file", error) from None
    key, first = ("line", 2) if is_csv else ("press", 0)
    rows: object = values.get(key)
    if isinstance(rows, list) and (count := len(cast("list[object]", rows))) > MOST_PRESSES:
        findings.error(path.name, f"at most {MOST_PRESSES} presses", count, "Cut it into several plans.")
        findings.raise_errors()
    if is_csv:
        file = _TomlPlan(press=read_table(_CsvPlan, values, findings, path.name, first=first).line)
    else:
        file = read_table(_TomlPlan, values, findings, path.name, FORMAT, first)
    for i, press in enumerate(file.press):
        report(press.site_violations(mount), findings, path.name, first, within=(key, i))
    if not file.press:
        findings.error(path.name, "at least one press", "none")
    _check_poses(findings, path.name, file)
    findings.raise_errors()
    others = [name for name in COLUMNS if name not in SITE]
    presses = (
        PlannedPress(*press.site(mount), **{name: getattr(press, name) for name in others})
        for press in file.press
    )
    return Plan(file.name or path.stem, tuple(presses), dict(file.poses))


def write_plan(plan: Plan, path: Path, *, force: bool = False) -> None:
    """Write a plan, TOML or CSV by the suffix; numbers are read back exactly.

    Args:
        plan: the plan.
        path: the file, ``.toml`` or ``.csv``. A CSV file holds no angles of poses.
        force: whether to replace an existing file.

    Raises:
        InputError: the suffix is not supported, or the file exists and ``force`` is not given.
    """
    text = {".toml": plan_as_toml, ".csv": _as_csv}.get(path.suffix.lower())
    if text is None:
        raise input_error(str(path), "a plan's name in .toml or .csv", f'"{path.suffix}"')
    mark = FORMAT if path.suffix.lower() == ".toml" else ",".join(COLUMNS)
    with whole_file(path, force=force, mark=mark) as temporary:
        temporary.write_text(text(plan), encoding="utf-8")


def plan_as_toml(plan: Plan) -> str:
    """Return the content of a plan's TOML file."""
    import tomli_w

    content: dict[str, Any] = {"format": FORMAT, "name": plan.name}
    if plan.poses:
        content["poses"] = {name: list(angles) for name, angles in plan.poses.items()}
    content["press"] = [_given(press) for press in plan.presses]
    return readable(tomli_w.dumps(content))


def _as_csv(plan: Plan) -> str:
    rows = [",".join(COLUMNS)]
    for press in plan.presses:
        given = _given(press)
        rows.append(",".join(str(given.get(name, "")) for name in COLUMNS))
    return "\n".join(rows) + "\n"


def _given(press: PlannedPress) -> dict[str, Any]:
    return {name: value for name in COLUMNS if (value := getattr(press, name)) is not None}


def _read_csv(path: Path, findings: Findings) -> list[dict[str, Any]]:
    lines = parse_csv(read_text(path))
    header = [name.strip() for name in lines[0]][:MOST_COLUMNS] if lines else []
    while header and not any(header[-1:]) and all(len(c) == len(header) and not c[-1] for c in lines[1:]):
        # Spreadsheets end every line with a comma if a column was cleared.
        header, lines = header[:-1], [cells[:-1] for cells in lines]
    _check_header(path.name, header, findings)
    # Report a malformed column once, not once per line.
    findings.raise_errors()
    rows: list[dict[str, Any]] = []
    for i, cells in enumerate(lines[1:], start=2):
        if len(cells) != len(header):
            findings.error(f"{path.name}, line {i}", f"{len(header)} cells", f"{len(cells)}")
        else:
            rows.append({k: _cell(k, cell) for k, cell in zip(header, cells, strict=True) if cell != ""})
    findings.raise_errors()
    return rows


def _check_header(file: str, header: Sequence[str], findings: Findings) -> None:
    """Check that every column is known and unique, and that force and site are given, the site in one of its forms."""
    if any(TAXEL.fullmatch(name) for name in header):
        got = "presses that were made, with values of the taxels"
        fix = "A plan lists presses to make. For a dataset, use `skincal audit FOLDER`."
        findings.error(file, "a plan of presses", got, fix)
        return
    if len(header) == 1 and ";" in header[0]:
        findings.error(file, "cells separated by commas", "semicolons", "Separate them by commas.")
        return
    known_names = (*COLUMNS, *OTHER_SITES)
    for name in dict.fromkeys(header):
        place, count = f"{file}, column {name or '(without a name)'}", header.count(name)
        if count > 1:
            findings.error(place, "each column once", f"{count} of that name")
        elif name not in known_names:
            close = did_you_mean(name, [known for known in known_names if known not in header])
            fix = f'Did you mean "{close}"?' if close else "Remove it."
            findings.error(place, f"columns of a plan: {', '.join(known_names)}", "another one", fix)
    here = set(header) & set(OTHER_SITES)
    wanted = ("force_n",) if here else ("force_n", *SITE)
    if missing := [name for name in wanted if name not in header]:
        findings.error(f"{file}, first line", f"the columns {', '.join(wanted)}", f"no {', '.join(missing)}")


def _cell(name: str, cell: str) -> Any:
    if name in ("pose", "kind"):
        return cell
    try:
        return float(cell)
    except ValueError:
        return cell


def _check_poses(findings: Findings, file: str, plan: _TomlPlan) -> None:
    """Check that angles belong to poses that occur, and that all poses or none have them."""
    used, poses = {press.pose for press in plan.press}, plan.poses
    for name in sorted(set(poses) - used):
        findings.error(f"{file}, poses.{name}", "a pose of some press", f"none of {', '.join(sorted(used))}")
    if poses and (missing := sorted(used - set(poses))):
        findings.error(f"{file}, [poses]", "angles for every pose, or none", f"none for {', '.join(missing)}")
