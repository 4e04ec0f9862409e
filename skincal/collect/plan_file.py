"""Plan files: TOML or CSV, read strictly, with all faults reported at once."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import fields, replace
from pathlib import Path
from typing import Any, cast

import numpy as np

from skincal.bounded import UnreadableError, parse_csv, parse_toml, read_text
from skincal.collect.mount import Mount
from skincal.collect.plan import KINDS, Plan, PlannedPress
from skincal.collect.protocols import FullProtocol
from skincal.dataset.columns import TAXEL
from skincal.dataset.findings import Findings, did_you_mean
from skincal.dataset.toml_table import KEPT, TomlTable, is_number
from skincal.errors import InputError, Problem
from skincal.files import reason, whole_file
from skincal.units import rad

FORMAT = "skincal-plan/1"

SITE = ("u_m", "v_m")
COLUMNS = tuple(field.name for field in fields(PlannedPress))
OTHER_SITES = ("beta_deg", "x_m", "y_m")
LARGEST_FORCE_N = 100.0

MOST_PRESSES, MOST_COLUMNS = 20_000, 100
"""Largest number of presses of a plan (a session of a week); and largest size of a table that lists them."""


def read_plan(path: Path, mount: Mount) -> Plan:
    """Read a plan.

    A TOML file has ``format = "skincal-plan/1"``, one ``[[press]]`` per press, optionally ``[poses]``; a CSV file has
    one row per press. A press has its site (``u_m``, ``v_m``, or ``beta_deg``, ``y_m``, on a plane ``x_m``, ``y_m``)
    and ``force_n``; pace, pose and kind default to those of the full protocol.

    Args:
        path: the file, ``.toml`` or ``.csv``.
        mount: the surface with the patch at its nominal pose.

    Returns:
        The plan, named after the file.

    Raises:
        InputError: the file has faults; all are reported.
    """
    findings = Findings()
    read = {".toml": _read_toml, ".csv": _read_csv}.get(path.suffix.lower())
    if read is None:
        got = "a folder" if path.is_dir() else f'"{path.suffix}"'
        raise InputError([Problem(str(path), "a plan in .toml or .csv", got)])
    try:
        name, poses, rows = read(path, findings)
    except OSError as error:
        raise InputError([Problem(str(path), "a plan", reason(error))]) from None
    except UnreadableError as error:
        raise InputError([Problem(path.name, f"a readable {path.suffix} file", str(error))]) from None
    presses = [_press(TomlTable(findings, path.name, place, row, _known(row)), mount) for place, row in rows]
    if not rows:
        findings.error(path.name, "at least one press", "none")
    _check_poses(findings, path.name, poses, presses)
    # A plan moves a hand: an unknown key must not be ignored.
    findings.errors.extend(replace(one, fix=one.fix.replace(KEPT, "Remove it.")) for one in findings.warnings)
    findings.raise_errors()
    return Plan(name, tuple(presses), {key: tuple(map(float, angles)) for key, angles in poses.items()})


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
        raise InputError([Problem(str(path), "a plan's name in .toml or .csv", f'"{path.suffix}"')])
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
    return tomli_w.dumps(content)


def _as_csv(plan: Plan) -> str:
    rows = [",".join(COLUMNS)]
    for press in plan.presses:
        given = _given(press)
        rows.append(",".join(str(given.get(name, "")) for name in COLUMNS))
    return "\n".join(rows) + "\n"


def _given(press: PlannedPress) -> dict[str, Any]:
    return {name: value for name in COLUMNS if (value := getattr(press, name)) is not None}


Rows = list[tuple[str, Mapping[str, Any]]]
Poses = dict[str, Sequence[float]]


def _read_toml(path: Path, findings: Findings) -> tuple[str, Poses, Rows]:
    values = parse_toml(read_text(path))
    top = TomlTable(findings, path.name, "", values, ("format", "name", "poses", "press"))
    top.choice("format", (FORMAT,))
    name = top.text("name", "a name", default=path.stem)
    rows: Rows = []
    given: object = top.raw("press")
    if not isinstance(given, list):
        top.error(
            "press",
            "a table [[press]] for each press",
            "nothing" if given is None else str(given),
        )
    presses = cast("list[Any]", given) if isinstance(given, list) else []
    _check_count(path.name, len(presses), findings)
    for i, row in enumerate(presses[:MOST_PRESSES]):
        if isinstance(row, dict):
            rows.append((f"press {i}", cast("Mapping[str, Any]", row)))
        else:
            top.error(f"press {i}", "a table", row)
    return name, _poses(top), rows


def _check_count(file: str, presses: int, findings: Findings) -> None:
    if presses > MOST_PRESSES:
        findings.error(file, f"at most {MOST_PRESSES} presses", presses, "Cut it into several plans.")
        findings.raise_errors()


def _poses(top: TomlTable) -> Poses:
    given: object = top.raw("poses")
    if given is None:
        return {}
    if not isinstance(given, dict):
        top.error("poses", "a table with the angles [rad] of each pose", str(given))
        return {}
    poses: Poses = {}
    for name, angles in cast("dict[str, Any]", given).items():
        if isinstance(angles, list) and all(is_number(angle) for angle in cast("list[Any]", angles)):
            poses[name] = cast("list[float]", angles)
        else:
            got = str(cast("object", angles))
            top.error(f"poses.{name}", "a list of angles [rad], one per joint of the finger", got)
    return poses


def _read_csv(path: Path, findings: Findings) -> tuple[str, Poses, Rows]:
    lines = parse_csv(read_text(path, encoding="utf-8-sig"))
    _check_count(path.name, len(lines) - 1, findings)
    header = [name.strip() for name in lines[0]][:MOST_COLUMNS] if lines else []
    while (
        header and not header[-1] and all(len(cells) == len(header) and not cells[-1] for cells in lines[1:])
    ):
        # Spreadsheets end every line with a comma if a column was cleared.
        header, lines = header[:-1], [cells[:-1] for cells in lines]
    _check_header(path.name, header, findings)
    # Report a malformed column once, not once per line.
    findings.raise_errors()
    rows: Rows = []
    for i, cells in enumerate(lines[1:], start=2):
        if len(cells) != len(header):
            findings.error(f"{path.name}, line {i}", f"{len(header)} cells", f"{len(cells)}")
        else:
            given = {k: _cell(k, cell) for k, cell in zip(header, cells, strict=True) if cell != ""}
            rows.append((f"line {i}", given))
    return path.stem, {}, rows


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
    for name in dict.fromkeys(header):
        place, count = f"{file}, column {name or '(without a name)'}", header.count(name)
        if count > 1:
            findings.error(place, "each column once", f"{count} of that name")
        elif name not in (*COLUMNS, *OTHER_SITES):
            close = did_you_mean(name, [known for known in (*COLUMNS, *OTHER_SITES) if known not in header])
            fix = f'Did you mean "{close}"?' if close else "Remove it."
            findings.error(
                place, f"columns of a plan: {', '.join((*COLUMNS, *OTHER_SITES))}", "another one", fix
            )
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


def _known(row: Mapping[str, Any]) -> tuple[str, ...]:
    """Return the keys that a press may have, with one form of its site."""
    other = tuple(key for key in OTHER_SITES if key in row)
    return COLUMNS if not other else (*other, *(name for name in COLUMNS if name not in SITE))


def _press(table: TomlTable, mount: Mount) -> PlannedPress:
    default = FullProtocol()
    u, v = _site(table, mount)
    radius = None
    if table.has("indenter_radius_m"):
        radius = table.length_m("indenter_radius_m", "a radius [m]", low=1e-4, high=0.1)
    return PlannedPress(
        u,
        v,
        table.number(
            "force_n", f"a force [N] above 0, up to {LARGEST_FORCE_N:g}", low=1e-3, high=LARGEST_FORCE_N
        ),
        table.number(
            "speed_m_per_s",
            "a speed [m/s], 0.0005 to 0.1",
            default=default.speeds_m_per_s[-1],
            low=5e-4,
            high=0.1,
        ),
        table.number("hold_s", "a time [s], 0.1 to 60", default=default.holds_s[0], low=0.1, high=60.0),
        table.text("pose", "the name of a pose", default=default.poses[0]),
        table.choice("kind", KINDS, default="regular"),
        radius,
    )


def _site(table: TomlTable, mount: Mount) -> tuple[float, float]:
    """Return the site in patch coordinates, from any of its forms."""
    if not any(table.has(key) for key in OTHER_SITES):
        reach = mount.reach_m
        expected = f"a length [m] within ±{reach:g} of the patch's centre"
        u, v = (table.number(key, expected, low=-reach, high=reach) for key in SITE)
        return u, v
    for key in SITE:
        table.absent(key, "the site is given by " + " and ".join(k for k in OTHER_SITES if table.has(k)))
    across = "x_m" if mount.pose_is_plane else "beta_deg"
    table.absent(
        "beta_deg" if mount.pose_is_plane else "x_m", f"on this surface the site is {across} and y_m"
    )
    first = table.number(across, "the position of the press")
    y = table.number("y_m", "the position of the press along the finger [m]")
    site = mount.site_at(first if mount.pose_is_plane else rad(first), y)
    if np.isfinite([first, y]).all() and not np.max(np.abs(site)) <= mount.reach_m:
        table.error("y_m", f"a site within {mount.reach_m:g} m of the patch's centre", f"{first:g}, {y:g}")
    return site


def _check_poses(findings: Findings, file: str, poses: Poses, presses: Sequence[PlannedPress]) -> None:
    """Check that angles belong to poses that occur, and that all poses or none have them."""
    used = {press.pose for press in presses}
    for name in sorted(set(poses) - used):
        findings.error(f"{file}, poses.{name}", "a pose of some press", f"none of {', '.join(sorted(used))}")
    if poses and (missing := sorted(used - set(poses))):
        findings.error(f"{file}, [poses]", "angles for every pose, or none", f"none for {', '.join(missing)}")
