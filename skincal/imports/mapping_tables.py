"""The other tables of a mapping file: ``[frame]``, ``[series]``, ``[csv]``, ``[bag]``, ``[topics]``, ``[joints]``."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any, cast

import numpy as np

from skincal.dataset.findings import Findings
from skincal.imports.mapping import BagFormat, CsvFormat, CutRules, JoinedFile, Placement, TopicRules
from skincal.imports.mapping_columns import TIME_KEYS, read_quantities
from skincal.imports.strict import StrictTable

FRAME_KEYS = ("matrix", "rotation_deg", "quaternion_xyzw", "translation_m", "project")
SERIES_KEYS = (
    "by", "on_n", "off_n", "band", "settle_s", "min_hold_s", "slope_n_per_s", "window_s", "start_at_zero",
    "own_clocks", "gap_s", "slides", "still_m",
)  # fmt: skip
LAYOUT_KEYS = (
    "delimiter", "decimal", "encoding", "comment", "skip_rows", "skip_after_header", "header", "missing",
    "layout", "block_rows", "rate_hz", "order",
)  # fmt: skip
CSV_KEYS = ("rows", "files", *LAYOUT_KEYS, "drop_incomplete")
JOINED_KEYS = ("file", "time", "resample", "max_age_s", "offset_s", "within_s", *LAYOUT_KEYS)
TOPIC_KEYS = ("clock", "resample", "max_age_s", "lag_s")
BAG_KEYS = ("files", "clock", "resample", "max_age_s", "definitions")
JOINT_KEYS = ("topic", "names")

ESTIMATE = "estimate"
"""Value of an offset of clocks that is to be found by correlation."""

Matrix = tuple[tuple[float, float, float], ...]


def read_placement(table: StrictTable) -> Placement:
    """``[frame]``."""
    given = [key for key in FRAME_KEYS[:3] if table.has(key)]
    if len(given) > 1:
        table.error(given[1], "one form of the rotation", " and ".join(given), "Remove the others.")
    matrix = _rotation(table)
    if not np.allclose(np.asarray(matrix) @ np.asarray(matrix).T, np.eye(3), atol=1e-3):
        table.error("matrix", "a rotation: rows of length 1, at right angles", "something else")
    elif np.linalg.det(np.asarray(matrix)) < 0:
        table.error(
            "matrix", "a rotation", "a reflection (determinant -1)", "Is an axis of the source left-handed?"
        )
    shift = table.numbers("translation_m", "three numbers [m]", (3,), (0.0, 0.0, 0.0))
    if max(abs(value) for value in shift) > 10:
        table.error(
            "translation_m", "at most 10 m", list(shift), "It looks like millimetres; divide by 1000."
        )
    return Placement(matrix, shift, table.flag("project", default=False))


def _rotation(table: StrictTable) -> Matrix:
    if table.has("rotation_deg"):
        x, y, z = table.numbers("rotation_deg", "three angles about x, y, z [deg]", (3,), (0.0, 0.0, 0.0))
        return _nested(_about(2, z) @ _about(1, y) @ _about(0, x))
    if table.has("quaternion_xyzw"):
        x, y, z, w = table.numbers("quaternion_xyzw", "four numbers x, y, z, w", (4,), (0.0, 0.0, 0.0, 1.0))
        if abs(math.hypot(x, y, z, w) - 1) > 1e-3:
            table.error("quaternion_xyzw", "a quaternion of length 1", [x, y, z, w])
            return Placement().rotation
        return _nested(_of_quaternion(np.array([x, y, z, w]) / math.hypot(x, y, z, w)))
    return table.numbers("matrix", "three rows of three numbers", (3, 3), Placement().rotation)


def _about(axis: int, angle_deg: float) -> Any:
    cos, sin = math.cos(math.radians(angle_deg)), math.sin(math.radians(angle_deg))
    i, j = (axis + 1) % 3, (axis + 2) % 3
    turn = np.eye(3)
    turn[i, i] = turn[j, j] = cos
    turn[i, j], turn[j, i] = -sin, sin
    return turn


def _of_quaternion(q: Any) -> Any:
    x, y, z, w = q
    cross = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    return np.eye(3) + 2 * w * cross + 2 * cross @ cross


def _nested(matrix: Any) -> Matrix:
    return tuple((float(a), float(b), float(c)) for a, b, c in matrix)


def read_cut(table: StrictTable, *, numbered: bool, constant_force: bool = False) -> CutRules:
    """Return ``[series]``.

    Args:
        table: the table.
        numbered: whether a column of the source numbers the presses.
        constant_force: whether the force was not measured, so that it does not show contacts.
    """
    d = CutRules()
    usual = "press" if numbered else "taxels" if constant_force else "force"
    by = table.choice("by", ("force", "taxels", "plateaus", "press"), default=usual)
    if numbered and by in ("force", "taxels", "plateaus"):
        table.error("by", '"press" where [columns.press] is mapped', f'"{by}"', "Remove one of them.")
    if by == "press" and not numbered:
        table.error("by", "a column press in [columns]", "none")
    on = table.bounded("on_n", "a force [N], 0 or more", d.on_n)
    rules = CutRules(
        by=by or "force",
        on_n=on,
        off_n=table.bounded("off_n", "a force [N]", on / 2, low=-math.inf),
        band=table.bounded("band", "a share of the force, like 0.1", d.band),
        settle_s=table.bounded("settle_s", "a time [s], 0 or more", d.settle_s),
        min_hold_s=table.bounded("min_hold_s", "a time [s], 0 or more", d.min_hold_s),
        slope_n_per_s=table.bounded("slope_n_per_s", "a change of force [N/s], 0 or more", d.slope_n_per_s),
        window_s=table.bounded("window_s", "a time [s], 0 or more", d.window_s),
        start_at_zero=table.flag("start_at_zero", default=d.start_at_zero),
        own_clocks=table.flag("own_clocks", default=d.own_clocks),
        gap_s=table.bounded("gap_s", "a time [s], 0 or more", d.gap_s),
        slides=table.choice("slides", ("cut", "keep", "refuse"), default=d.slides) or d.slides,
        still_m=table.bounded("still_m", "a length [m], 0 or more", 0.0) if table.has("still_m") else None,
    )
    if rules.off_n > rules.on_n:
        table.error("off_n", f"at most on_n = {rules.on_n:g}", f"{rules.off_n:g}")
    if rules.band >= 0.5:
        table.error("band", "a share below 0.5", f"{rules.band:g}", "It looks like percent; divide by 100.")
    return rules


def read_csv_format(table: StrictTable, files: StrictTable, findings: Findings) -> CsvFormat:
    """Return ``[csv]`` and ``[files]``."""
    joined = tuple(
        _joined(files.table(name, JOINED_KEYS, findings), name, findings) for name in files.items()
    )
    return replace(
        _layout(table),
        rows=table.choice("rows", ("presses", "series")) or "presses",
        files=table.texts("files", "names of files", default=()),
        drop_incomplete=table.flag("drop_incomplete", default=False),
        joined=joined,
    )


def _joined(table: StrictTable, name: str, findings: Findings) -> JoinedFile:
    """Return one table of ``[files]``."""
    form = _layout(table)
    time = None
    if table.has("time"):
        entry = table.table("time", ("column", "columns", "unit", "scale", "offset", *TIME_KEYS), findings)
        time = read_quantities(entry, "time_s", "csv")[0]
    elif form.rate_hz is None:
        table.error(
            "time", 'its stamps, like { column = "t", unit = "s" }', "nothing", "Add time, or rate_hz."
        )
    found = table.raw("offset_s")
    estimated = found == ESTIMATE
    if isinstance(found, str) and not estimated:
        table.error("offset_s", f'a time [s], or "{ESTIMATE}"', f'"{found}"')
        estimated = True
    offset_s = None if estimated else table.bounded("offset_s", "a time [s]", 0.0, low=-math.inf)
    return JoinedFile(
        name=name,
        place=table.label,
        file=table.text("file", "the name of the file, or a pattern like gauge_*.csv"),
        form=form,
        time=time,
        resample=table.choice("resample", ("previous", "linear"), default="linear") or "linear",
        max_age_s=table.bounded("max_age_s", "a time [s], 0 or more", 0.0)
        if table.has("max_age_s")
        else None,
        offset_s=offset_s,
        within_s=table.bounded("within_s", "a time [s], 0 or more", math.inf),
    )


def _layout(table: StrictTable) -> CsvFormat:
    """Return the layout of the text of a file."""
    d = CsvFormat("series")
    found = CsvFormat(
        rows="series",
        layout=table.choice("layout", ("table", "blocks", "labelled"), default=d.layout) or d.layout,
        block_rows=_whole(table, "block_rows"),
        rate_hz=table.bounded("rate_hz", "rows a second [Hz], more than 0", 1.0, low=1e-6)
        if table.has("rate_hz")
        else None,
        order=table.choice("order", ("file", "time"), default=d.order) or d.order,
        delimiter=table.text("delimiter", "a character", default=d.delimiter),
        decimal=table.choice("decimal", (".", ","), default=d.decimal) or d.decimal,
        encoding=table.text("encoding", "an encoding", default=d.encoding),
        comment=table.text("comment", "the start of comment lines", default=d.comment),
        skip_rows=_whole(table, "skip_rows"),
        skip_after_header=_whole(table, "skip_after_header"),
        header=table.flag("header", default=d.header),
        missing=("", *table.texts("missing", "texts that mean no value", default=d.missing[1:])),
    )
    if len(found.delimiter) != 1 and found.delimiter != "whitespace":
        table.error("delimiter", 'one character, like ";" or "\\t", or "whitespace"', f'"{found.delimiter}"')
    if found.delimiter == found.decimal:
        table.error("decimal", "another character than the delimiter", f'"{found.decimal}"')
    try:
        "".encode(found.encoding)  # refuses codecs that are not of text like unknown ones
    except (LookupError, ValueError):
        table.error("encoding", "an encoding like utf-8, utf-16 or latin-1", f'"{found.encoding}"')
    return found


def _whole(table: StrictTable, key: str) -> int:
    return table.whole(key, "a whole number, 0 or more", low=0) if table.has(key) else 0


def read_bag_format(top: StrictTable, findings: Findings) -> BagFormat:
    """Return ``[bag]``, ``[topics]`` and ``[joints]``."""
    bag = top.table("bag", BAG_KEYS, findings)
    default = _topic_rules(bag, TopicRules("header"), needed=True)
    topics = top.table("topics", (), findings, strict=False)
    joints = top.table("joints", JOINT_KEYS, findings)
    definitions = bag.raw("definitions")
    if definitions is not None and not isinstance(definitions, dict):
        bag.error("definitions", 'a table like { "my_msgs/msg/Skin" = "Skin.msg" }', definitions)
        definitions = None
    types = cast("dict[str, str]", definitions or {})
    for name, file in types.items():
        if name.count("/") not in (1, 2) or not isinstance(file, str):  # pyright: ignore[reportUnnecessaryIsInstance]
            bag.error("definitions", 'a type like "my_msgs/msg/Skin" and a file', f"{name} = {file}")
    return BagFormat(
        default=default,
        files=bag.texts("files", "names of bags", default=()),
        topics={
            name: _topic_rules(topics.table(name, TOPIC_KEYS, findings), default, needed=False)
            for name in topics.items()
        },
        definitions=types,
        joints_topic=joints.text("topic", "the topic's name") if top.has("joints") else "",
        joints=joints.texts("names", "names of joints", default=()),
    )


def _topic_rules(table: StrictTable, default: TopicRules, *, needed: bool) -> TopicRules:
    return TopicRules(
        clock=table.choice("clock", ("header", "receive"), default=None if needed else default.clock)
        or default.clock,
        resample=table.choice("resample", ("previous", "linear"), default=default.resample)
        or default.resample,
        max_age_s=table.bounded("max_age_s", "a time [s], 0 or more", default.max_age_s),
        lag_s=0.0 if needed else table.bounded("lag_s", "a time [s]", 0.0, low=-math.inf),
    )
