"""Drivers are found by name or by module and class, and get typed options."""

from __future__ import annotations

import sys
from asyncio import CancelledError
from collections.abc import Mapping, Sequence
from importlib.metadata import EntryPoint
from pathlib import Path
from typing import Annotated, Any, Literal

import pytest
from hand_fakes import FakeHand

from skincal.errors import InputError, WorkError
from skincal.hand import registry
from skincal.hand.registry import (
    converted,
    create_driver,
    driver_class,
    driver_names,
    driver_options,
    parse_options,
    type_text,
)


class OptionHand(FakeHand):
    def __init__(
        self,
        port: Annotated[str, "where it is plugged in"],
        *,
        seed: int = 0,
        speed: float = 1.5,
        gentle: bool = True,
        record: Path | None = None,
        mode: Literal["slow", "fast"] = "slow",
        effects: Mapping[str, float] | None = None,
        offsets: tuple[float, ...] = (),
    ) -> None:
        super().__init__()
        self.given = (port, seed, speed, gentle, record, mode, effects, offsets)


NAME = f"{__name__}:OptionHand"


def test_text_becomes_what_the_annotations_say() -> None:
    text = {"port": "usb0", "seed": "7", "speed": "2", "gentle": "no", "record": "a/b", "mode": "fast"}
    driver = create_driver(NAME, **text, effects="creep=0.5, shear=1", offsets="0.1,-0.2")
    assert isinstance(driver, OptionHand)
    effects = {"creep": 0.5, "shear": 1.0}
    assert driver.given == ("usb0", 7, 2.0, False, Path("a/b"), "fast", effects, (0.1, -0.2))
    driver = create_driver(NAME, port="p", record="none", seed=3)
    assert isinstance(driver, OptionHand)
    assert driver.given[:2] == ("p", 3)
    assert driver.given[4] is None


def test_options_are_listed_with_their_help() -> None:
    options = {option.name: option for option in driver_options(NAME)}
    assert list(options) == ["port", "seed", "speed", "gentle", "record", "mode", "effects", "offsets"]
    assert options["port"].required
    assert options["port"].text == "where it is plugged in"
    assert (options["seed"].kind, options["seed"].default) == (int, 0)


def test_every_wrong_option_is_named_at_once() -> None:
    with pytest.raises(InputError) as caught:
        create_driver(NAME, seed="many", gentle="perhaps", mode="loud", effects="creep", nonsense="1")
    text = str(caught.value)
    assert len(caught.value.problems) == 6
    assert "an option of: port (text), seed (whole number), speed (number), gentle (true or false)" in text
    assert "the option port (text); got nothing. Add --driver-option port=VALUE." in text
    assert "option seed: expected a whole number; got 'many'" in text
    assert "option gentle: expected true or false" in text
    assert "option mode: expected one of slow, fast" in text
    assert "option effects: expected NAME=VALUE,..." in text


@pytest.mark.parametrize(
    ("name", "text"),
    [
        ("no_such_module:Hand", "expected a module no_such_module; got none"),
        ("skincal.nothing:Hand", "expected a module skincal.nothing; got none"),
        (f"{__name__}:NoHand", "expected NoHand in"),
        (f"{__name__}:NAME", "expected a class; got str"),
        ("pathlib:Path", "expected a subclass of skincal.hand.HandDriver or StageDriver; got PosixPath"),
    ],
)
def test_a_name_that_leads_nowhere(name: str, text: str) -> None:
    with pytest.raises(InputError) as caught:
        create_driver(name)
    assert text in str(caught.value)


def test_a_driver_that_cannot_be_described(monkeypatch: pytest.MonkeyPatch) -> None:
    """Its description is needed before it is connected."""
    monkeypatch.setattr(OptionHand, "description", property(lambda self: sys.exit(0)))
    with pytest.raises(WorkError, match="cannot be created: SystemExit"):
        create_driver(NAME, port="x")
    monkeypatch.undo()
    monkeypatch.setattr(OptionHand, "name", property(lambda self: 1 / 0))
    with pytest.raises(WorkError, match="cannot be created: ZeroDivisionError"):
        create_driver(NAME, port="x")
    monkeypatch.undo()
    monkeypatch.setattr(OptionHand, "description", None)
    with pytest.raises(InputError, match="description: expected a HandDescription; got NoneType"):
        create_driver(NAME, port="x")


def test_annotations_that_only_a_type_checker_knows(monkeypatch: pytest.MonkeyPatch) -> None:
    def make(port: Serial, speed: int = 1) -> FakeHand:  # type: ignore[name-defined]  # noqa: F821
        return FakeHand()

    monkeypatch.setattr(sys.modules[__name__], "make_hand", make, raising=False)
    assert [option.name for option in driver_options(f"{__name__}:make_hand")] == ["port", "speed"]
    assert driver_options("builtins:dict") == ()


def test_a_driver_that_cannot_be_imported_or_made(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "broken_hand.py").write_text("raise RuntimeError('no licence')")
    (tmp_path / "needing_hand.py").write_text("import a_vendor_library")
    monkeypatch.syspath_prepend(tmp_path)
    with pytest.raises(WorkError, match="cannot be imported: RuntimeError: no licence"):
        create_driver("broken_hand:Hand")
    with pytest.raises(WorkError, match="needs the package a_vendor_library, which is not installed"):
        create_driver("needing_hand:Hand")
    monkeypatch.setattr(OptionHand, "__init__", lambda self: 1 / 0)
    with pytest.raises(WorkError, match="cannot be created: ZeroDivisionError"):
        create_driver(NAME)

    def cancelled(self: object) -> None:
        raise CancelledError("no loop")

    monkeypatch.setattr(OptionHand, "__init__", cancelled)
    with pytest.raises(WorkError, match="cannot be created: CancelledError"):
        create_driver(NAME)


def test_a_package_makes_its_driver_known(monkeypatch: pytest.MonkeyPatch) -> None:
    points = [EntryPoint("mine", NAME, registry.GROUP)]
    monkeypatch.setattr(registry, "entry_points", lambda group, name="mine": points if name == "mine" else [])
    assert driver_names() == ("mine",)
    assert driver_class("mine") is getattr(sys.modules[__name__], "OptionHand")  # noqa: B009
    points.append(EntryPoint("mine", "other:Hand", registry.GROUP))
    with pytest.raises(InputError, match="expected one entry point; got other:Hand and"):
        driver_class("mine")


def test_an_installed_package_adds_its_hand(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    # What pip leaves of a package that names a driver in its pyproject.toml.
    (tmp_path / "lab_hand.py").write_text("from hand_fakes import FakeHand\n\nclass LabHand(FakeHand): ...\n")
    info = tmp_path / "lab_hand-1.0.dist-info"
    info.mkdir()
    (info / "METADATA").write_text("Metadata-Version: 2.1\nName: lab-hand\nVersion: 1.0\n")
    (info / "entry_points.txt").write_text("[skincal.drivers]\nlab = lab_hand:LabHand\n")
    monkeypatch.syspath_prepend(tmp_path)
    assert {"lab", "sim"} <= set(driver_names())
    hand = create_driver("lab")
    assert isinstance(hand, FakeHand) and type(hand).__module__ == "lab_hand"


def test_options_of_the_command_line() -> None:
    assert parse_options(["seed=7", "taxel-rate=1=2"]) == {"seed": "7", "taxel_rate": "1=2"}
    for wrong in (["seed"], ["=7"], ["a=1", "a=2"]):
        with pytest.raises(InputError, match="--driver-option"):
            parse_options(wrong)


@pytest.mark.parametrize(
    ("kind", "shown"),
    [
        (float | None, "number or none"),
        (Literal["a", "b"], "a or b"),
        (Mapping[str, float], "NAME=number,..."),
        (Sequence[int], "whole number,..."),
        (dict, "NAME=text,..."),
        (object, "object"),
    ],
)
def test_types_as_a_person_reads_them(kind: Any, shown: str) -> None:
    assert type_text(kind) == shown


def test_what_is_no_text_is_taken_as_it_is() -> None:
    thing = object()
    assert converted(thing, int) is thing
    assert converted("x", Any) == "x"
    assert converted("a", int | str) == "a"
    with pytest.raises(ValueError, match="cannot be given as text"):
        converted("a", object)
