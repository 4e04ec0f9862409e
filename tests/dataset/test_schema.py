"""Tables of files as dataclasses: places, words, unknown keys, and placeholders of what is wrong."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from typing import Annotated, Any, Literal

import pytest

from skincal.dataset.findings import Findings
from skincal.dataset.keys import Key, Length
from skincal.dataset.schema import Table, keys_of, read_table
from skincal.dataset.schema_errors import Violation


@dataclass(frozen=True)
class Wheel(Table):
    radius_m: Annotated[float, Length("a radius [m]", 1e-3, 1.0)]
    spokes: Annotated[int, Key("a whole number, at least 3", 3)] = 12
    tyre: Literal["slick", "knobby"] = "slick"
    valve: float | None = None
    extra: Mapping[str, Any] = field(default_factory=dict)

    def violations(self) -> Iterator[Violation]:
        if self.tyre == "knobby" and self.radius_m < 0.2:
            yield "tyre", "a slick one on so small a wheel", f'"{self.tyre}"'


@dataclass(frozen=True)
class Lamp(Table, unknown="refuse"):
    volts: float


@dataclass(frozen=True)
class Parts(Table, unknown="keep"):
    weights: Mapping[str, Annotated[float, Key("a weight [kg], 0 or more", 0.0)]]


@dataclass(frozen=True)
class Bike(Table):
    frame: Wheel
    name: str
    wheels: tuple[Wheel, ...] = ()
    lamp: Lamp | None = None
    parts: Parts | None = None
    extra: Mapping[str, Any] = field(default_factory=dict)


GOOD: dict[str, Any] = {"frame": {"radius_m": 0.3}, "name": "b"}


def read(**changes: Any) -> tuple[Bike, list[str], list[str]]:
    findings = Findings()
    values = {key: value for key, value in (GOOD | changes).items() if value is not None}
    bike = read_table(Bike, values, findings, "bike.toml")
    return bike, [str(one) for one in findings.errors], [str(one) for one in findings.warnings]


def test_lists_and_whole_numbers_are_read():
    bike, errors, warnings = read(
        wheels=[{"radius_m": 1, "tyre": "knobby"}], parts={"weights": {"a": 2}, "z": 1}
    )
    assert (errors, warnings) == ([], [])
    assert bike.wheels == (Wheel(1.0, tyre="knobby"),)
    assert bike.parts is not None and bike.parts.weights == {"a": 2.0}
    assert keys_of(Wheel) == ["radius_m", "spokes", "tyre", "valve"]


@pytest.mark.parametrize(
    ("changes", "said"),
    [
        ({"frame": {"radius_m": 300}}, "radius_m: expected a radius [m], at most 1 m; got 300. It looks like mil"),
        ({"frame": {}}, "[frame] radius_m: expected a radius [m]; got nothing. Add radius_m = … to [frame]."),
        ({"frame": None}, "bike.toml, [frame]: expected a table [frame]; got nothing. Add it."),
        ({"frame": 3}, "[frame]: expected a table [frame]; got 3. Write [frame] on its own line."),
        ({"name": None}, "bike.toml, name: expected a text; got nothing. Add name = … to the top."),
        ({"name": True}, "bike.toml, name: expected a text; got true"),
        ({"wheels": [GOOD["frame"], {"radius_m": "0.3"}]}, 'expected a radius [m]; got "0.3". Write it without'),
        ({"wheels": [{"radius_m": 0.3, "spokes": 2}]}, "[wheels 1] spokes: expected a whole number, at least 3; got 2"),
        ({"wheels": [{"radius_m": 0.3, "spokes": True}]}, "[wheels 1] spokes: expected a whole"),
        ({"wheels": [{"radius_m": 0.3, "tyre": "knoby"}]}, 'got "knoby". Did you mean "knobby"?'),
        ({"wheels": [{"radius_m": 0.3, "valve": math.inf}]}, "valve: expected a number; got inf. Leave valve out"),
        ({"wheels": [{"radius_m": 0.1, "tyre": "knobby"}]}, "[wheels 1] tyre: expected a slick one"),
        ({"wheels": [{"radius_m": 0.3, "spoke": 3}]}, 'an unknown one. Did you mean "spokes"?'),
        ({"lamp": {"volts": 6.0, "watts": 3}}, "[lamp] watts: expected one of volts; got an unknown key. Remove it."),
        ({"parts": {"weights": {"bell": -1}}}, "[parts] weights.bell: expected a weight [kg], 0 or more; got -1"),
    ],
)  # fmt: skip
def test_errors_name_place_and_remedy(changes: dict[str, Any], said: str):
    _, errors, _ = read(**changes)
    assert len(errors) == 1 and said in errors[0]


def test_unknown_keys_are_kept_with_a_warning():
    bike, errors, warnings = read(colour="red", extra=1)
    assert not errors and bike.extra == {"colour": "red", "extra": 1}
    assert warnings[0] == (
        "bike.toml, colour: expected one of frame, name, wheels, lamp, parts; got an unknown key. "
        "It is kept but not used."
    )


def test_wrong_values_do_not_hide_other_errors():
    bike, errors, _ = read(
        frame={"radius_m": "wide", "spokes": 20}, name=3, wheels=[{"radius_m": 0.1, "tyre": "knobby"}], lamp=1
    )
    assert math.isnan(bike.frame.radius_m) and bike.frame.spokes == 20
    assert (bike.name, bike.lamp, bike.wheels[0].tyre) == ("", None, "slick")
    assert len(errors) == 4
