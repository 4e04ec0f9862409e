"""Texts of foreign exceptions and values: one line of bounded length, whatever their classes do."""

from __future__ import annotations

from typing import Any

import pytest

from skincal.errors import Problem, first_of, quoted, shown, text_of


class OddError(Exception):
    """An exception whose text is made by a function."""

    def __init__(self, text: Any) -> None:
        super().__init__()
        self.text = text

    def __str__(self) -> str:
        return self.text()


class OddText(str):
    """A text with methods of its own."""

    def split(self, *_: Any) -> Any:
        raise OSError

    def __getitem__(self, *_: Any) -> Any:
        raise OSError


def raising(error: BaseException) -> Any:
    def text() -> str:
        raise error

    return text


@pytest.mark.parametrize("fault", [RuntimeError(), SystemExit(0), KeyboardInterrupt(), GeneratorExit()])
def test_a_text_that_raises(fault: BaseException) -> None:
    assert quoted(OddError(raising(fault))) == "OddError: an error whose text cannot be read"


@pytest.mark.parametrize("text", [lambda: None, lambda: b"bytes"])
def test_a_text_that_is_none(text: Any) -> None:
    assert quoted(OddError(text)) == "OddError: an error whose text cannot be read"


def test_a_text_with_methods_of_its_own() -> None:
    assert text_of(OddError(lambda: OddText("bus\n off"))) == "bus off"


def test_a_text_is_one_line_of_bounded_length() -> None:
    text = text_of(ValueError("\x1b[2J\x00 a\r\nb " + "x" * 10**7))
    assert text.isprintable()
    assert text.startswith("\\x1b[2J\\x00 a b xxx")
    assert len(text) == 200


def test_a_class_with_an_odd_name() -> None:
    named = type("Bus\n" * 10**5, (Exception,), {})
    assert len(quoted(named("off"))) < 70

    class Meta(type):
        @property
        def __name__(cls) -> str:  # type: ignore[override]
            raise KeyError

    class UnnamedError(Exception, metaclass=Meta):
        pass

    assert quoted(UnnamedError("off")).endswith(": off")


def test_a_group_says_what_is_in_it() -> None:
    """`asyncio.TaskGroup` raises "unhandled errors in a TaskGroup (1 sub-exception)"."""
    inner = ExceptionGroup("tasks", [ConnectionError("cable"), OddError(raising(OSError()))])
    text = quoted(BaseExceptionGroup("all", [inner, SystemExit(3), ValueError("not shown")]))
    assert text == (
        "BaseExceptionGroup: all: ConnectionError: cable; OddError: an error whose text cannot be read; SystemExit: 3"
    )


def test_a_group_of_any_depth() -> None:
    error: Exception = ValueError("deep")
    for _ in range(2000):
        error = ExceptionGroup("tasks", [error, error])
    assert quoted(error).startswith("ExceptionGroup: tasks: ValueError: deep")


def test_a_value_whose_repr_raises() -> None:
    class Value:
        def __repr__(self) -> str:
            raise OSError

    assert shown(Value()) == "Value"
    assert shown([Value()]) == "list of 1"
    assert shown([["x" * 10**6] * 1000] * 1000) == "list of 1000"
    assert len(shown("x" * 10**6)) < 100
    assert shown(10**5000) == "int"


def test_endless_names_of_a_file_are_cut() -> None:
    endless = "x" * 100_000
    told = str(
        Problem(f"plan.csv, column {endless}", f"one of {endless}", endless, f'Did you mean "{endless}"?')
    )
    assert told.startswith("plan.csv, column xxx") and len(told) < 3100


def test_first_of_many_words():
    assert first_of(["a", "b", "c"]) == "a, b, c"
    assert first_of(range(5)) == "0, 1, 2 and 2 more"
    assert first_of(["a"], shown=1, total=9) == "a and 8 more"
    assert first_of([]) == ""
