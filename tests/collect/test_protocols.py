"""Laws of the protocols, for any seed and many layouts."""

from __future__ import annotations

from collections import Counter
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from published import LAYOUT

from skincal import tasks
from skincal.collect import PROTOCOLS, FullProtocol, PaperProtocol, Plan, PlannedPress, full_plan, paper_plan
from skincal.collect.protocols import patch_grid
from skincal.errors import InputError
from skincal.model import TaxelLayout

SEEDS = st.integers(0, 2**32 - 1)


def test_every_protocol_has_its_line_of_help():
    assert set(PROTOCOLS) == set(tasks.PROTOCOLS)


def test_every_protocol_has_a_random_stream_of_its_own():
    """A plan is drawn by the seed and the length of the protocol's name."""
    assert len({len(name) for name in PROTOCOLS}) == len(PROTOCOLS)


def full(seed: int, **changes: float | None) -> Plan:
    return full_plan(np.random.default_rng(seed), LAYOUT, **changes)


@given(SEEDS)
@settings(max_examples=40)
def test_paper_presses_are_sixty_grid_places_of_1_to_4_n(seed: int):
    plan = paper_plan(np.random.default_rng(seed), LAYOUT)
    grid = {tuple(place) for place in patch_grid(LAYOUT).tolist()}
    assert len(plan) == len({press.site for press in plan.presses}) == 60
    assert {press.site for press in plan.presses} <= grid
    assert all(1 <= press.force_n <= 4 for press in plan.presses)
    assert plan.cycles() == (0,) * 60 and len(plan.pose_names) == 1


@given(SEEDS)
@settings(max_examples=40)
def test_full_protocol_has_all_its_parts(seed: int):
    plan = full(seed)
    protocol = FullProtocol()
    presses = plan.presses
    assert 90 <= len(plan) <= 110
    assert plan.count("repeat") >= 20 and plan.count("revisit") >= 10
    assert all(presses[i].kind == "anchor" for i in range(0, len(plan), 10))
    assert presses[-1].kind == "anchor"
    assert len({replace(p) for p in presses if p.kind == "anchor"}) == 1
    forces = np.array([p.force_n for p in presses])
    assert 0.3 <= forces.min() < 0.5 and 5 < forces.max() <= 6
    for values, name in ((protocol.speeds_m_per_s, "speed_m_per_s"), (protocol.holds_s, "hold_s")):
        counts = Counter(getattr(p, name) for p in presses)
        assert set(counts) == set(values) and min(counts.values()) >= len(plan) / 4
    assert set(plan.pose_names) == set(protocol.poses)


@given(SEEDS)
@settings(max_examples=40)
def test_kinds_say_what_has_been_before(seed: int):
    plan = full(seed)
    for number, press in enumerate(plan.presses):
        before = [p for p in plan.presses[:number] if p.site == press.site]
        assert plan.cycles()[number] == len(before)
        if press.kind == "regular":
            assert not before
        if press.kind == "repeat":
            assert any(p.same_press(press) for p in before)
        if press.kind == "revisit":
            assert before and not any(p.same_press(press) for p in before)


@given(SEEDS)
@settings(max_examples=25)
def test_order_hides_nothing_behind_time(seed: int):
    plan = full(seed)
    own = [p for p in plan.presses if p.kind == "regular"]
    time = np.arange(len(own))
    for column in (
        [p.force_n for p in own],
        [p.u_m for p in own],
        [p.v_m for p in own],
        [p.speed_m_per_s for p in own],
    ):
        # 50 random pairs: beyond 0.6 by chance once in 100 000.
        assert abs(np.corrcoef(time, column)[0, 1]) < 0.6
    poses = [p.pose for p in plan.presses if p.kind != "anchor"]
    # Both poses come back all session long.
    assert all({"A", "B"} == set(third) for third in np.array_split(poses, 3))


@given(SEEDS, st.integers(2, 10), st.integers(2, 10), st.floats(2e-3, 8e-3))
@settings(max_examples=30)
def test_sites_lie_on_the_taxels_of_any_grid(seed: int, rows: int, cols: int, pitch_m: float):
    layout = TaxelLayout.grid(rows, cols, taxel_size_m=1e-3, pitch_m=pitch_m)
    plan = full_plan(np.random.default_rng(seed), layout)
    low, high = layout.bounds_m
    assert np.all(plan.sites_m() >= low - 1e-9) and np.all(plan.sites_m() <= high + 1e-9)


def test_same_seed_same_plan_other_seed_other_plan():
    assert full(3) == full(3) != full(4)


def test_sites_of_the_full_protocol_cover_the_patch():
    sites = full(5).sites_m()
    for place in patch_grid(LAYOUT):
        assert np.linalg.norm(sites - place, axis=1).min() < 3e-3


def test_a_second_indenter_comes_last_and_with_its_radius():
    plan = full(1, second_indenter_m=0.004)
    radii = [p.indenter_radius_m for p in plan.presses]
    assert radii == [None] * 97 + [0.004] * 20
    assert len(full(1)) == 97


def test_too_small_a_patch_for_the_paper_is_an_error():
    layout = TaxelLayout.grid(1, 1, taxel_size_m=0.003, pitch_m=0.004)
    with pytest.raises(InputError, match=r"at most 9 presses"):
        paper_plan(np.random.default_rng(0), layout)
    assert len(paper_plan(np.random.default_rng(0), layout, PaperProtocol(presses=9))) == 9


def test_same_press_looks_at_everything_but_the_kind():
    press = PlannedPress(1e-3, 0.0, 2.0, 0.02, 1.0)
    assert press.same_press(replace(press, kind="repeat"))
    for change in (
        {"u_m": 2e-3},
        {"force_n": 2.1},
        {"hold_s": 2.0},
        {"pose": "B"},
        {"indenter_radius_m": 4e-3},
    ):
        assert not press.same_press(replace(press, **change))
