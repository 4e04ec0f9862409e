"""Streams on other clocks, and paths into messages."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import numpy as np
import pytest

from skincal.imports.bag_file import FieldError, NotHereError, array_at, number_at, parse_path, value_at
from skincal.imports.clock import resampled

TIME = np.array([0.0, 1.0, 2.0, 5.0])
VALUES = np.array([10.0, 20.0, 40.0, 70.0])


def test_previous_takes_the_last_that_is_not_later():
    found = resampled(TIME, VALUES, np.array([-0.1, 0.0, 0.9, 1.0, 3.4, 3.6, 5.0, 6.4, 6.6]), "previous", 1.5)
    np.testing.assert_array_equal(found, [np.nan, 10, 10, 20, 40, np.nan, 70, 70, np.nan])


def test_linear_lies_between_and_bridges_no_gap():
    found = resampled(TIME, VALUES, np.array([-0.1, 0.0, 0.25, 1.5, 2.0, 3.0, 5.0, 5.1]), "linear", 1.5)
    np.testing.assert_allclose(found, [np.nan, 10, 12.5, 30, 40, np.nan, 70, np.nan])


def test_stream_without_samples_says_nothing():
    assert np.isnan(resampled(TIME[:0], VALUES[:0], TIME, "previous", 0.1)).all()


@dataclass
class Leaf:
    x: float = 1.5
    name: str = "tip"


@dataclass
class Tree:
    leaf: Leaf = field(default_factory=Leaf)
    leaves: list[Leaf] = field(default_factory=lambda: [Leaf(2.0, "a"), Leaf(3.0, "b")])
    data: Any = field(default_factory=lambda: np.arange(6, dtype=np.int16).reshape(2, 3))


@pytest.mark.parametrize(
    ("path", "value"),
    [("leaf.x", 1.5), ("leaves[1].x", 3.0), ("leaves[name=b].x", 3.0), ("leaves[0].name", "a")],
)
def test_paths_lead_to_values(path: str, value: object):
    assert value_at(Tree(), parse_path(path)) == value


def test_arrays_come_flat():
    np.testing.assert_array_equal(array_at(Tree(), parse_path("data")), np.arange(6.0))
    assert number_at(Tree(), parse_path("data[1]")[:0] + parse_path("leaf.x")) == 1.5


@pytest.mark.parametrize("path", ["", "a..b", "a[", "a[x]", "a b", "[0]"])
def test_what_is_no_path(path: str):
    with pytest.raises(FieldError):
        parse_path(path)


def test_what_is_not_there():
    with pytest.raises(FieldError, match='no field "y" in Leaf, which has x, name'):
        value_at(Tree(), parse_path("leaf.y"))
    for path in ("leaves[2].x", "leaves[name=c].x"):
        with pytest.raises(NotHereError):
            value_at(Tree(), parse_path(path))
    with pytest.raises(FieldError, match="no number but str"):
        number_at(Tree(), parse_path("leaf.name"))
