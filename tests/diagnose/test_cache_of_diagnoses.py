"""The cache gives what was put into it, for the same parts only, and is done without where it cannot be had."""

from __future__ import annotations

import os
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import trimesh

from skincal.diagnose.cache import Arrays, Cache, default_folder, digest
from skincal.gap.problem import RefitOptions
from skincal.model import MeshIndenter, MeshSurface, SensorPose


class Maker:
    """Makes an entry and counts how often."""

    def __init__(self, value: float = 1.0) -> None:
        self.value, self.made = value, 0

    def __call__(self) -> Arrays:
        self.made += 1
        return {"a": np.full(3, self.value), "mean": np.array(self.value / 3)}


def test_what_was_made_once_is_not_made_again(tmp_path: Path):
    cache, make = Cache(tmp_path / "deep" / "cache"), Maker()
    first = cache.get("null", [np.arange(3), "x"], make)
    again = cache.get("null", [np.arange(3), "x"], make)
    assert make.made == 1
    assert set(again) == {"a", "mean"}
    assert all(np.array_equal(first[name], again[name]) for name in first)


@pytest.mark.parametrize(
    "parts", [[np.arange(4), "x"], [np.arange(3), "y"], [np.arange(3.0), "x"], [np.arange(3)]]
)
def test_other_parts_are_another_entry(tmp_path: Path, parts: list[object]):
    cache = Cache(tmp_path)
    cache.get("null", [np.arange(3), "x"], Maker(1.0))
    assert cache.get("null", parts, Maker(2.0))["a"][0] == 2.0
    assert cache.get("law", [np.arange(3), "x"], Maker(3.0))["a"][0] == 3.0


def test_without_a_folder_nothing_is_kept():
    cache, make = Cache(), Maker()
    cache.get("null", [1], make)
    cache.get("null", [1], make)
    assert make.made == 2


def flipped(content: bytes) -> bytes:
    middle = len(content) // 2
    return content[:middle] + bytes([content[middle] ^ 0xFF]) + content[middle + 1 :]


@pytest.mark.parametrize(
    "broken", [lambda content: content[:40], lambda _: b"", flipped], ids=["cut off", "empty", "flipped"]
)
def test_an_entry_that_is_broken_is_made_again(tmp_path: Path, broken: Callable[[bytes], bytes]):
    cache, make = Cache(tmp_path), Maker()
    cache.get("null", [1], make)
    (entry,) = tmp_path.iterdir()
    entry.write_bytes(broken(entry.read_bytes()))
    assert cache.get("null", [1], make)["a"][0] == 1.0
    assert make.made == 2
    cache.get("null", [1], make)
    assert make.made == 2


def test_a_folder_that_cannot_be_written_costs_time_and_nothing_else(tmp_path: Path):
    (tmp_path / "file").write_text("no folder")
    make = Maker()
    assert Cache(tmp_path / "file").get("null", [1], make)["a"][0] == 1.0
    assert make.made == 1


def test_an_interrupt_leaves_no_entry(tmp_path: Path):
    def cut() -> Arrays:
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        Cache(tmp_path).get("null", [1], cut)
    assert list(tmp_path.iterdir()) == []


def test_entries_used_longest_ago_go_first(tmp_path: Path):
    cache = Cache(tmp_path, most=2)
    for number in (1, 2):
        cache.get("null", [number], Maker(number))
        entry = tmp_path / f"null-{digest([number])}.npz"
        os.utime(entry, (number, number))
    cache.get("null", [1], Maker())
    cache.get("null", [3], Maker(3.0))
    assert {p.name for p in tmp_path.iterdir()} == {f"null-{digest([n])}.npz" for n in (1, 3)}


def test_a_digest_sees_all_of_an_array_wherever_it_is():
    long = np.zeros(5000)
    other = long.copy()
    other[2500] = 1e-12
    assert digest([long]) != digest([other])
    assert digest([(long, 1)]) != digest([(other, 1)])
    assert digest([[("a", long)]]) != digest([[("a", other)]])
    assert digest([(long, 1)]) == digest([(long.copy(), 1)])
    assert digest([("a", "b"), "c"]) != digest([("a",), "b", "c"])


def test_a_digest_sees_all_fields_that_dataclasses_are_compared_by():
    kept = RefitOptions(steps=3)
    assert digest([kept]) == digest([replace(kept, mapper=sorted)]) != digest([replace(kept, steps=4)])
    pose, long = SensorPose(0.02, 0.1), np.zeros(5000)
    assert digest([pose]) != digest([replace(pose, x_m=1e-9)])
    other = long.copy()
    other[2500] = 1e-12
    assert digest([{"a": {"b": long}}]) != digest([{"a": {"b": other}}])
    assert digest([{"a": 1}]) != digest([{"b": 1}])


def test_a_digest_tells_meshes_by_what_they_are_made_of():
    ball = trimesh.creation.icosphere(1, radius=0.006)
    other = ball.vertices.copy()
    other[3] *= 1.01
    for kind in (MeshSurface, MeshIndenter):
        one = digest([kind(ball.vertices, ball.faces)])
        assert one == digest([kind(ball.vertices.copy(), ball.faces)]) != digest([kind(other, ball.faces)])
    assert digest([MeshSurface(ball.vertices, ball.faces)]) != digest(
        [MeshSurface(ball.vertices, ball.faces, step_m=1e-3)]
    )


def test_what_cannot_be_looked_into_is_not_kept(tmp_path: Path):
    with pytest.raises(
        TypeError, match=r"expected arrays, numbers, text or dataclasses of them; got <class 'ob"
    ):
        digest([object()])
    make = Maker()
    for _ in range(2):
        assert Cache(tmp_path).get("null", [{"of any kind": object()}], make)["a"][0] == 1.0
    assert make.made == 2 and not any(tmp_path.iterdir())


def test_another_program_has_entries_of_its_own(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    before = digest([1])
    monkeypatch.setattr("skincal.diagnose.cache._program", lambda: b"edited")
    assert digest([1]) != before


def test_a_cache_beside_another_takes_no_room_of_it(tmp_path: Path):
    cache = Cache(tmp_path, most=1)
    cache.get("null", [1], Maker())
    fits = cache.beside("fits", most=2)
    for number in range(3):
        fits.get("refit", [number], Maker())
    assert [p.name for p in tmp_path.glob("*.npz")] == [f"null-{digest([1])}.npz"]
    assert len(list((tmp_path / "fits").iterdir())) == 2
    assert Cache().beside("fits", most=2).folder is None


def test_the_folder_is_said_or_the_users(monkeypatch: pytest.MonkeyPatch, tmp_path: Path):
    monkeypatch.setenv("SKINCAL_CACHE", str(tmp_path / "own"))
    assert default_folder() == tmp_path / "own"
    monkeypatch.delenv("SKINCAL_CACHE")
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "users"))
    assert default_folder() == tmp_path / "users" / "skincal"
