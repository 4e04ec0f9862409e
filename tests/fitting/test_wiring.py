"""Taxels in another order than the data say are recognised, and nothing else is taken for it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from skincal.fitting.problem import PressTable, build_problem
from skincal.fitting.wiring import TaxelOrder, _exchange_taxels, _Search, find_taxel_order
from skincal.fitting.wiring_orders import mapping_of, named_orders
from tests.fitting.conftest import BOX, Truth, make_session, rig, some_presses

IMAGE = np.arange(16).reshape(4, 4)


def exchanged(*pairs: tuple[int, int]) -> np.ndarray:
    order = np.arange(16)
    for a, b in pairs:
        order[[a, b]] = order[[b, a]]
    return order


def wound() -> np.ndarray:
    image = IMAGE.copy()
    image[1::2] = image[1::2, ::-1]
    return image.ravel()


def order_of(table: PressTable, slack_m: float = 2e-3) -> TaxelOrder | None:
    return find_taxel_order(build_problem(replace(rig(), slack_m=slack_m), table), BOX)


WIRED = {
    "flip_cols = true": IMAGE[:, ::-1].ravel(),
    "flip_rows = true": IMAGE[::-1].ravel(),
    "flip_rows = true\nflip_cols = true": IMAGE[::-1, ::-1].ravel(),
    "transpose = true": IMAGE.T.ravel(),
    "order = [0, 1, 2, 3, 7, 6, 5, 4, 8, 9, 10, 11, 15, 14, 13, 12]": wound(),
    "order = [0, 1, 2, 3, 4, 6, 5, 7, 8, 9, 10, 11, 12, 13, 14, 15]": exchanged((5, 6)),
    "order = [0, 1, 2, 3, 8, 9, 10, 11, 4, 5, 6, 7, 12, 13, 14, 15]": IMAGE[[0, 2, 1, 3]].ravel(),
    "order = [12, 13, 14, 15, 0, 1, 2, 3, 4, 5, 6, 7, 8, 9, 10, 11]": np.roll(IMAGE, 1, axis=0).ravel(),
}


@pytest.mark.parametrize("mapping", list(WIRED))
def test_wiring_is_recognised(mapping: str):
    table, _ = make_session(presses=40)
    undone = np.argsort(WIRED[mapping])
    found = order_of(replace(table, counts=table.counts[:, undone]))
    assert found is not None
    assert found.order.tolist() == WIRED[mapping].tolist()
    assert found.mapping == mapping
    assert found.rms_after < 0.5 * found.rms_before


@pytest.mark.parametrize("seed", range(4))
def test_any_permutation_is_found(seed: int):
    table, _ = make_session(presses=60, seed=seed)
    order = np.random.default_rng(seed).permutation(16)
    found = order_of(replace(table, counts=table.counts[:, np.argsort(order)]))
    assert found is not None
    assert found.order.tolist() == order.tolist()


@pytest.mark.parametrize("seed", range(8))
def test_good_data_are_left_alone(seed: int):
    table, _ = make_session(presses=12 + 8 * seed, seed=seed, position_sigma_m=1e-3)
    assert order_of(table) is None


@pytest.mark.parametrize("seed", [90, 184])
def test_a_press_far_from_its_measured_place_is_no_order(seed: int):
    """One press of taxels that are hardly ever pressed lies where a fit from its measured place does not get to."""
    table, where = make_session(presses=44, seed=seed, position_sigma_m=1e-3)
    assert order_of(some_presses(table, np.flatnonzero(where[:, 0] < 2.5e-3))) is None


@pytest.mark.parametrize("seed", range(4))
def test_gains_dead_and_leaking_taxels_are_no_order(seed: int):
    table, _ = make_session(presses=40, seed=seed)
    rng = np.random.default_rng(seed)
    counts = table.counts * np.exp(0.25 * rng.standard_normal(16))
    counts[:, rng.choice(16, 2, replace=False)] = 0.0
    counts += 0.1 * np.roll(counts, 1, axis=1)
    assert order_of(replace(table, counts=counts)) is None


@pytest.mark.parametrize("axis", [0, 1])
def test_exchanged_lines_with_dark_taxels(axis: int):
    """Taxels that no press reaches go with their row or column, though their own traces do not say so."""
    table, _ = make_session(presses=40)
    order = np.take(IMAGE, [1, 0, 2, 3], axis=axis).ravel()
    counts = table.counts.copy()
    dark = IMAGE[:2, :2].ravel()[1:3]
    counts[:, dark] = counts.min()
    found = order_of(replace(table, counts=counts[:, np.argsort(order)]))
    assert found is not None and found.order.tolist() == order.tolist()


def test_taxels_that_are_seldom_pressed_join_no_cycle():
    """Two taxels are exchanged; noise makes a cycle of three a little better."""
    nats = np.zeros((6, 6))
    nats[:2] = 50.0
    nats[0, 1], nats[1, 0], nats[1, 2] = 0.0, 0.0, -1.0
    for start in ([2, 0, 1, 3, 4, 5], [0, 1, 2, 3, 4, 5]):
        assert _exchange_taxels(np.array(start), nats).tolist() == [1, 0, 2, 3, 4, 5]


def test_one_shifted_row_has_a_name():
    for axis in (0, 1):
        image = np.moveaxis(np.arange(48).reshape(6, 8), axis, 0).copy()
        image[3] = np.roll(image[3], 2)
        order = np.moveaxis(image, 0, axis).ravel()
        assert any((one.order == order).all() for one in named_orders(6, 8))


def test_banks_of_rows():
    table, _ = make_session(presses=40)
    order = IMAGE[[0, 2, 1, 3]][:, [0, 2, 1, 3]].ravel()
    found = order_of(replace(table, counts=table.counts[:, np.argsort(order)]))
    assert found is not None and found.order.tolist() == order.tolist()


def test_a_taxel_that_is_not_read_is_no_order():
    table, _ = make_session(presses=40)
    counts = table.counts.copy()
    counts[:, 6] = np.nan
    assert order_of(replace(table, counts=counts)) is None


def test_named_orders_are_different_permutations():
    for rows, cols in ((4, 4), (3, 5), (1, 6)):
        orders = np.stack([one.order for one in named_orders(rows, cols)])
        assert len(np.unique(orders, axis=0)) == len(orders)
        assert (np.sort(orders, axis=1) == np.arange(rows * cols)).all()
        assert mapping_of(np.arange(rows * cols), rows, cols) == ""


def test_slopes_of_a_pose(truth: Truth) -> None:
    problem = build_problem(rig(), make_session(truth, presses=12, noise=0.2)[0])
    search = _Search(problem, BOX)
    bent = 1e-4 * np.random.default_rng(0).standard_normal(12)
    pose = np.array([1e-4, truth.y_m + 3e-4, -0.1, np.log(2e-6), np.log(3e-6), *bent])
    slack, order = np.full((len(problem), 2), 1e-4), np.arange(16)[::-1]

    def differences(at: np.ndarray) -> np.ndarray:
        return search._differences(search._nominal_images(at, slack).shares, order).ravel()

    found = search._difference_slopes(search._nominal_images(pose, slack), pose, order)
    for column, step in zip(found.T, np.diag([1e-7, 1e-7, 1e-5, 1e-5, 1e-5, *[1e-7] * 12]), strict=True):
        expected = (differences(pose + step) - differences(pose - step)) / (2 * step.sum())
        assert column == pytest.approx(expected, abs=1e-6 * np.abs(expected).max())
