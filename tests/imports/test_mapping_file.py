"""Mapping files that are wrong: every violation at once, with what was meant."""

from __future__ import annotations

import tomllib
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from skincal.dataset.schema import keys_of
from skincal.errors import InputError
from skincal.imports import template
from skincal.imports.mapping_file import (
    BagTable,
    BagTaxels,
    CsvFormat,
    CsvSource,
    CsvTaxels,
    Frame,
    JoinedFormat,
    TopicTable,
)
from skincal.imports.read_mapping import read_mapping
from skincal.imports.targets import FACTORS, unit_of
from tests.imports.foreign import PRESS_ROWS, RIG, SERIES, mapping, write_mapping
from tests.imports.ros import BAG


def problems(folder: Path, content: dict[str, Any], source: str = "csv") -> list[str]:
    with pytest.raises(InputError) as caught:
        read_mapping(write_mapping(folder, content), source)
    return [str(problem) for problem in caught.value.problems]


def test_everything_at_once(tmp_path: Path):
    content = mapping(
        PRESS_ROWS,
        csv={"delimeter": ";"},
        columns={"force_n": {"unit": "mm"}, "temprature_c": "T", "position": None, "branch": {"value": 3}},
        taxels={"columns": "s{k}"},
        sensor={"rows": 0},
        frame={"matrix": [[1, 0, 0], [0, 1, 0], [0, 0, -1]]},
    )
    found = problems(tmp_path, content)
    for text in (
        "[sensor] rows: expected a whole number, 1 to 16384; got 0",
        "[csv] delimeter: expected one of delimiter, decimal",
        'Did you mean "delimiter"?',
        '[columns.force_n] unit: expected a unit of force: N, kN, cN, mN, uN, gf, kgf, lbf, ozf, dyn; got "mm". '
        "mm is a unit of length.",
        '[columns] temprature_c: expected a known column; got an unknown one. Did you mean "temperature_c"?',
        "[columns]: expected the column x_m (or position); got nothing. Add [columns.position].",
        "[columns.branch] value: expected a text; got 3",
        "Use {r} and {c}, or {j};",
        "expected a rotation; got a reflection (determinant -1)",
    ):
        assert any(text in problem for problem in found), text
    assert all(problem.startswith("map.toml") for problem in found)


OF_PRESSES: list[tuple[dict[str, Any], str]] = [
    ({"columns": {"force_n": {"unit": "mn"}}}, 'got "mn". Did you mean "mN"?'),
    ({"columns": {"force_n": {"unit": None}}}, "[columns.force_n] unit: expected a unit of force"),
    ({"columns": {"force_n": {"sign": 2}}}, "expected 1 or -1; got 2"),
    ({"columns": {"force_n": {"column": None, "colum": "F"}}}, 'an unknown key. Did you mean "column"?'),
    ({"columns": {"force_n": {"value": 1.0}}}, "expected a source or a constant value; got both"),
    ({"columns": {"x_m": "X"}}, "x_m: expected each column once; got it occurs alone and in a vector"),
    ({"columns": {"position": {"columns": ["X", "Y"]}}}, "expected 3 names; got 2"),
    ({"columns": {"time_s": "t"}}, "one that only the other kind of rows has"),
    ({"columns": {"taxel_0_0": "t"}}, "Write a pattern or a list there."),
    ({"columns": {"force_n": 3}}, "expected a table like"),
    ({"columns": {"pose": {"column": "p", "words": ["a"]}}}, "expected a table like { loading"),
    ({"taxels": None}, "[taxels]: expected a table [taxels]; got nothing"),
    ({"taxels": {"columns": ["a", "b"]}}, "expected the names of 16 columns (rows x cols); got 2 entries"),
    ({"taxels": {"columns": ["a"] * 16}}, "expected each column once; got a"),
    ({"taxels": {"columns": [["a", "b"]]}}, "expected 4 rows of 4 columns"),
    ({"taxels": {"first": "one"}}, "the first number of rows, columns or taxels"),
    ({"taxels": {"colums": "x"}}, 'Did you mean "columns"?'),
    ({"sensor": {"rows": 2**62, "cols": "x"}}, "[sensor] rows: expected a whole number, 1 to 16384"),
    ({"sensor": {"rows": 2**14, "cols": 2**14}}, "[sensor] rows: expected at most 16384 taxels"),
    ({"frame": {"rotation_deg": [1, 2]}}, "expected three angles about x, y, z [deg]; got [1, 2]"),
    ({"frame": {"quaternion_xyzw": [1, 1, 0, 0]}}, "expected a quaternion of length 1"),
    ({"frame": {"translation_m": [0, 23, 0]}}, "It looks like millimetres"),
    (
        {"frame": {"rotation_deg": [0, 0, 1], "quaternion_xyzw": [0, 0, 0, 1]}},
        "expected one form of the rotation",
    ),
    ({"series": {"on_n": 1.0}}, "no such table if each row is a press"),
    ({"csv": {"rows": "press"}}, 'Did you mean "presses"?'),
    ({"csv": {"encoding": "utf-7000"}}, "an encoding like utf-8"),
    ({"csv": {"delimiter": ","}}, "expected another character than the delimiter"),
    ({"csv": {"delimiter": "::"}}, 'expected one character, like ";"'),
    ({"csv": {"skip_rows": -1}}, "expected a whole number, 0 or more; got -1"),
    ({"indenter": {"radius_m": 6}}, "divide by 1000"),
    ({"format": "skincal-dataset/1"}, 'expected "skincal-import/1"'),
    ({"colums": {}}, 'Did you mean "columns"?'),
    ({"created": "yesterday"}, "a date and time like"),
]
OF_SERIES: list[tuple[dict[str, Any], str]] = [
    ({"series": {"off_n": 0.5, "on_n": 0.2}}, "off_n: expected at most on_n = 0.2; got 0.5"),
    ({"series": {"band": 10}}, "It looks like percent"),
    ({"series": {"by": "press"}}, "expected a column press in [columns]; got none"),
    ({"series": {"by": "plateau"}}, 'Did you mean "plateaus"?'),
    ({"columns": {"press": "n"}, "series": {"by": "force"}}, '"press" where [columns.press] is mapped'),
    ({"columns": {"phase": "p"}}, "[columns.phase]: expected also a column press"),
    ({"columns": {"time_s": None}}, "expected the column time_s; got nothing"),
    ({"columns": {"t_hold_s": "t"}}, "one that only the other kind of rows has"),
]
OF_BAGS: list[tuple[dict[str, Any], str]] = [
    ({"bag": {"clock": None}}, '[bag] clock: expected one of "header", "receive"; got nothing'),
    ({"topics": {"/skin": {"lag": 1}}}, 'Did you mean "lag_s"?'),
    ({"topics": {"/skin": {"clock": "reciever"}}}, 'Did you mean "receive"?'),
    ({"bag": {"definitions": {"Skin": "a.msg"}}}, 'expected a type like "my_msgs/msg/Skin" and a file'),
    ({"taxels": {"elements": [0, 1, 1]}}, "expected 16 different indices of the array"),
    ({"columns": {"force_n": {"topic": None}}}, "[columns.force_n] topic: expected the topic's name"),
    ({"columns": {"time_s": {"value": 0, "unit": "s"}}}, "the clock of the taxels' topic is used"),
    ({"columns": {"force_n": "F"}}, "expected a table like"),
    ({"joints": {"topic": None}}, "[joints] topic: expected the topic's name; got nothing"),
]
"""Changes of a mapping, and what is said of them."""


@pytest.mark.parametrize(
    ("part", "source", "changes", "text"),
    [
        *((PRESS_ROWS, "csv", *case) for case in OF_PRESSES),
        *((SERIES, "csv", *case) for case in OF_SERIES),
        *((BAG, "bag", *case) for case in OF_BAGS),
    ],
)
def test_one_violation(tmp_path: Path, part: dict, source: str, changes: dict, text: str):
    found = problems(tmp_path, mapping(part, **changes), source)
    assert any(text in problem for problem in found), found


def test_the_other_verb_is_named(tmp_path: Path):
    assert "Use `skincal import rosbag`" in problems(tmp_path, mapping(BAG))[0]
    assert "Use `skincal import csv`" in problems(tmp_path, mapping(SERIES), "bag")[0]


def test_no_toml_and_no_file(tmp_path: Path):
    (tmp_path / "m.toml").write_text("format = ")
    with pytest.raises(InputError, match=r"m\.toml: expected TOML"):
        read_mapping(tmp_path / "m.toml", "csv")
    with pytest.raises(InputError, match=r"no such file$"):
        read_mapping(tmp_path / "n.toml", "csv")


@pytest.mark.parametrize("kind", ["csv", "rosbag"])
def test_template_names_every_key_that_there_is(tmp_path: Path, kind: str):
    """The template is valid as it stands and shows every key."""
    text = template(kind)
    tomllib.loads(text)
    (tmp_path / "m.toml").write_text(text, encoding="utf-8")
    found = read_mapping(tmp_path / "m.toml", "csv" if kind == "csv" else "bag")
    assert isinstance(found.source, CsvFormat) == (kind == "csv")
    tables = (CsvTaxels, CsvSource, JoinedFormat) if kind == "csv" else (BagTaxels, BagTable, TopicTable)
    keys = {key for table in (Frame, *tables) for key in keys_of(table)}
    assert [key for key in sorted(keys) if key not in text] == []


@pytest.mark.parametrize(
    ("kind", "name", "value", "si"),
    [
        ("length", "inch", 1.0, 0.0254),
        ("length", "um", 1.0, 1e-6),
        ("force", "gf", 1000.0, 9.80665),
        ("force", "kgf", 1.0, 9.80665),
        ("force", "lbf", 1.0, 4.4482216152605),
        ("force", "oz", 16.0, 4.4482216152605),
        ("force", "kp", 1.0, 9.80665),
        ("force", "dyn", 1e5, 1.0),
        ("angle", "deg", 180.0, np.pi),
        ("time", "ns", 5e9, 5.0),
        ("temperature", "K", 273.15, 0.0),
        ("temperature", "F", 212.0, 100.0),
        ("speed", "mm/min", 60.0, 1e-3),
        ("torque", "N mm", 1000.0, 1.0),
    ],
)
def test_units(kind: str, name: str, value: float, si: float):
    unit = unit_of(kind, name)
    assert unit is not None
    assert value * unit.factor + unit.offset == pytest.approx(si, rel=1e-12, abs=1e-12)


def test_first_unit_of_each_kind_is_that_of_the_dataset():
    assert [next(iter(units.items()))[1] for units in FACTORS.values()] == [1.0] * len(FACTORS)


ODD: list[Any] = [0, -1, 1.5, True, "", "x", [], [1, "a"], {}, {"a": 1}, float("nan"), float("inf")]


def paths(content: dict[str, Any], before: tuple[str, ...] = ()) -> list[tuple[str, ...]]:
    """Every key of a mapping, also of tables inside it."""
    found: list[tuple[str, ...]] = []
    for key, value in content.items():
        found.append((*before, key))
        found += paths(value, (*before, key)) if isinstance(value, dict) else []
    return found


@pytest.mark.parametrize(("part", "source"), [(PRESS_ROWS, "csv"), (SERIES, "csv"), (BAG, "bag")])
def test_odd_values_are_read_or_refused(tmp_path: Path, part: dict, source: str):
    extra = {"series": {"by": "force"}, "frame": {"rotation_deg": [0, 0, 0], "project": False}}
    content = mapping(part, extra if part is not PRESS_ROWS else {"frame": extra["frame"]})
    common = set(paths(RIG)) if part is not PRESS_ROWS else set()
    for path in paths(content):
        for odd in ODD if path not in common else ():
            changed = mapping(content)
            inside = changed
            for key in path[:-1]:
                inside = inside[key]
            inside[path[-1]] = odd
            try:
                read_mapping(write_mapping(tmp_path, changed), source)
            except InputError as error:
                assert error.problems, (path, odd)
