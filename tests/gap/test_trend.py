"""What moves of presses go with, told from chance."""

from __future__ import annotations

import numpy as np
import pytest

from skincal.gap import trend
from skincal.gap.trend import Explained, beyond, explained, largest_share, numbers

PRESSES = 50
GROUPS = ((0, 1, 2, 3), (4, 5, 6), (7, 8))


def a_rig(seed: int = 0) -> tuple[np.ndarray, np.ndarray]:
    """Columns (P, 2, 9): offsets in two hand poses, what goes with place and force; and those of the pose (P, 2, 3)."""
    rng = np.random.default_rng(seed)
    place, force, second = (
        rng.uniform(-1, 1, (PRESSES, 2)),
        rng.uniform(0, 1, PRESSES),
        np.arange(PRESSES) % 3 == 0,
    )
    columns, one = np.zeros((PRESSES, 2, 9)), np.ones(PRESSES)
    for pose, own in enumerate((~second, second)):
        columns[own, 0, 2 * pose] = columns[own, 1, 2 * pose + 1] = 1.0
    columns[:, 0, 4], columns[:, 1, 5] = place[:, 0], place[:, 1]
    columns[:, 0, 6], columns[:, 1, 6] = place[:, 1], place[:, 0]
    columns[:, 0, 7] = columns[:, 1, 8] = force
    nuisance = np.zeros((PRESSES, 2, 3))
    nuisance[:, 0, 0] = nuisance[:, 1, 1] = one
    nuisance[:, 0, 2], nuisance[:, 1, 2] = -place[:, 1], place[:, 0]
    return columns, nuisance


def tried(moves: np.ndarray, seed: int = 0) -> Explained:
    found = explained(moves, *a_rig(), GROUPS, np.random.default_rng(seed))
    assert found is not None
    return found


def noise(seed: int) -> np.ndarray:
    return np.random.default_rng(seed).normal(size=(PRESSES, 2))


def test_chance_is_told_as_chance(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(trend, "_SWAPS", 499)
    chances = np.array([tried(noise(seed)).p_value for seed in range(400)])
    assert 0.45 < chances.mean() < 0.55
    # Three standard errors about what was asked for.
    assert 0.017 < (chances <= 0.05).mean() < 0.083


def test_what_is_there_in_any_case_is_no_trend() -> None:
    _, nuisance = a_rig()
    moves = noise(0)
    shifted = moves + nuisance @ [4.0, -3.0, 2.0]
    here, there = tried(moves), tried(shifted)
    assert there.p_value == here.p_value and there.share == pytest.approx(here.share)
    assert beyond(shifted, nuisance) == pytest.approx(beyond(moves, nuisance))


@pytest.mark.parametrize("group", GROUPS)
def test_a_group_is_found_by_itself(group: tuple[int, ...]) -> None:
    columns, _ = a_rig()
    way = {GROUPS[0]: [0, 0, 1.2, -1.0], GROUPS[1]: [1.3, -1.1, 0.4], GROUPS[2]: [2.5, -1.5]}[group]
    found = [tried(columns[..., group] @ way + 0.8 * noise(seed)) for seed in range(20)]
    assert all(one.p_value < 0.002 and one.share > 0.12 for one in found)
    assert sum(tuple(one.columns) == group for one in found) >= 18


def test_a_weak_offset_is_clearer_by_itself_than_among_all_numbers() -> None:
    columns, nuisance = a_rig()
    alone: list[float] = []
    among: list[float] = []
    for seed in range(10):
        moves = columns[..., :4] @ [0.0, 0.0, 0.6, 0.6] + noise(seed)
        for chances, groups in ((alone, GROUPS), (among, [range(9)])):
            found = explained(moves, columns, nuisance, groups, np.random.default_rng(0))
            assert found is not None
            chances.append(found.p_value)
    assert np.median(alone) < np.median(among)


def test_two_groups_are_found_together() -> None:
    columns, _ = a_rig()
    found = tried(columns @ [0, 0, 2.0, -2.0, 2.0, -2.0, 0.0, 0.0, 0.0] + 0.5 * noise(2))
    assert set(found.columns.tolist()) == set(range(7))


def test_numbers_and_share_are_those_of_least_squares() -> None:
    columns, nuisance = a_rig()
    moves, own = noise(3), columns[..., 4:7]
    design = np.concatenate([own, nuisance], axis=-1).reshape(2 * PRESSES, -1)
    x, left, *_ = np.linalg.lstsq(design, moves.ravel(), rcond=None)
    assert numbers(moves, own, nuisance) == pytest.approx(x[:3])
    _, total, *_ = np.linalg.lstsq(nuisance.reshape(2 * PRESSES, -1), moves.ravel(), rcond=None)
    share = 1 - (left[0] / (2 * PRESSES - 6)) / (total[0] / (2 * PRESSES - 3))
    assert largest_share(moves, own, nuisance, [range(3)]) == pytest.approx(share)


def test_a_group_that_says_nothing_of_its_own_is_left_out() -> None:
    columns, nuisance = a_rig()
    # One force and one hand pose: what goes with either is an offset of all places.
    columns[..., 7:] = nuisance[..., :2] * 0.7
    columns[..., :4] = np.concatenate([nuisance[..., :2], np.zeros((PRESSES, 2, 2))], axis=-1)
    moves = columns[..., 4:7] @ [1.0, -1.0, 0.0] + noise(0)
    found = explained(moves, columns, nuisance, GROUPS, np.random.default_rng(0))
    assert found is not None and found.columns.tolist() == [4, 5, 6]
    assert np.abs(found.x).max() < 3
    assert np.abs(numbers(moves, columns, nuisance)).max() < 3
    left = [GROUPS[0], GROUPS[2], ()]
    assert explained(moves, columns, nuisance, left, np.random.default_rng(0)) is None
    assert largest_share(moves, columns, nuisance, left) == 0.0
