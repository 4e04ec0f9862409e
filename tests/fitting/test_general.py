"""The general way: contacts in space, shares from the skin model, tables of them, and whole fits."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from skincal.fitting.fit_options import FitOptions, GridSteps, SearchBox
from skincal.fitting.general import evaluate_pose, evaluate_slab
from skincal.fitting.general_local import LocalPlaces
from skincal.fitting.general_skin import TABLE_MARGIN_M, ContactMap, SkinShares
from skincal.fitting.general_table import (
    ROUGH,
    SkinTable,
    TableReach,
    choose_reach,
    join_tables,
    split_presses,
    tabulate_presses,
)
from skincal.fitting.grid import MacroGrid, MicroSettings
from skincal.fitting.posterior import Bounds
from skincal.fitting.problem import FitProblem, PressTable, build_problem
from skincal.fitting.result import FitResult
from skincal.fitting.solve import default_steps, plan_grid, solve
from skincal.fitting.tasks import Neighbourhood, climb_near
from skincal.model import Contacts, Cylinder, Plane
from tests.fitting.conftest import BOX, QUICK, RADIUS, Truth, make_session, rig, skin, some_presses
from tests.fitting.geometry import general_problem, on_cylinder, shell
from tests.fitting.looking import see

SETTINGS = MicroSettings(0.5, 1e-3, 2e-3)
REACH = TableReach(0.5e-3, 0.06, 0.5, levels=5, step_m=0.3e-3, resolution_m=0.5e-3)


@pytest.fixture(scope="module")
def table() -> PressTable:
    return make_session(presses=20)[0]


@pytest.fixture(scope="module")
def problem(table: PressTable) -> FitProblem:
    return general_problem(table)


@pytest.fixture(scope="module")
def on_mesh(table: PressTable) -> FitProblem:
    """Few presses: each needs a table of contacts, which on a mesh takes long."""
    return general_problem(some_presses(table, np.arange(3)), shell(lambda y: np.full_like(y, RADIUS)))


@pytest.fixture(scope="module")
def eight(problem: FitProblem) -> FitProblem:
    """Eight of the presses, which are tabled sooner."""
    return problem.subset(np.arange(len(problem)) < 8, "left out")


@pytest.fixture(scope="module")
def tabled(eight: FitProblem, truth: Truth) -> SkinTable:
    return _tabled(eight, truth.macro, REACH)


def _tabled(problem: FitProblem, macro: np.ndarray, reach: TableReach) -> SkinTable:
    return join_tables([tabulate_presses(problem, part, macro, reach) for part in split_presses(problem)])


def _pairs(
    problem: FitProblem, macro: np.ndarray, count: int = 120
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    rng = np.random.default_rng(1)
    press = rng.integers(0, len(problem), count)
    nuisance = np.column_stack([rng.uniform(-1.8e-3, 1.8e-3, (count, 2)), rng.normal(0, 0.02, count)])
    return np.tile(macro, (count, 1)), press, nuisance


def _direct(
    problem: FitProblem,
    macro: np.ndarray,
    press: np.ndarray,
    nuisance: np.ndarray,
    resolution_m: float = 0.5e-3,
) -> np.ndarray:
    shares = SkinShares(problem, *macro[:3], resolution_m=resolution_m)
    return shares.shares(press, nuisance[:, :2], np.log(problem.force_n[press]) + nuisance[:, 2] - macro[3])


class TestContacts:
    def test_are_those_of_the_surface(self, table: PressTable, problem: FitProblem) -> None:
        assert problem.contacts is not None
        slack = np.random.default_rng(0).uniform(-4e-3, 4e-3, (len(problem), 2))
        points, normals = problem.contacts.at(problem.rows, slack)
        surface = Cylinder(RADIUS)
        expected = surface.offset(on_cylinder(table)[problem.rows], slack[:, 0], slack[:, 1])
        assert points == pytest.approx(expected, abs=1e-7)
        assert normals == pytest.approx(surface.normal_at(expected), abs=1e-5)

    def test_go_no_further_than_they_are_tabled(self, problem: FitProblem) -> None:
        assert problem.contacts is not None
        edge, beyond = np.full((2, 2), problem.contacts.half_m), np.full((2, 2), 1.0)
        assert (
            problem.contacts.at(problem.rows[:2], edge)[0] == problem.contacts.at(problem.rows[:2], beyond)[0]
        ).all()

    def test_keep_measured_normals(self, table: PressTable) -> None:
        tilted = np.tile([0.0, 0.6, 0.8], (20, 1))
        tilted[3] = np.nan
        contacts = ContactMap.of(Cylinder(RADIUS), on_cylinder(table), np.arange(20), 2e-3, tilted)
        points, normals = contacts.at(np.array([2, 3]), np.array([[1e-3, 0.0], [1e-3, 0.0]]))
        assert normals[0] == pytest.approx([0.0, 0.6, 0.8])
        assert normals[1] == pytest.approx(Cylinder(RADIUS).normal_at(points)[1], abs=1e-5)

    def test_stop_at_the_edge_of_a_mesh(self) -> None:
        surface = shell(lambda y: np.full_like(y, RADIUS))
        contacts = ContactMap.of(surface, np.array([[0.0, 0.0005, RADIUS]]), np.array([0]), 2e-3)
        points, _ = contacts.at(np.zeros(1, dtype=np.intp), np.array([[0.0, -1.8e-3]]))
        assert np.isfinite(points).all()
        assert -0.2e-3 < points[0, 1] < 0.3e-3


class TestShares:
    def test_are_the_loads_of_the_skin_over_the_force(
        self, table: PressTable, problem: FitProblem, truth: Truth
    ) -> None:
        shares = SkinShares(problem, truth.across_m, truth.y_m, truth.alpha_rad)
        press = np.arange(len(problem))
        got = shares.shares(
            press, np.zeros((len(press), 2)), np.log(problem.force_n / truth.elasticity_pa_per_m)
        )
        points = on_cylinder(table)[problem.rows]
        contacts = Contacts(points, Cylinder(RADIUS).normal_at(points), problem.force_n)
        expected = skin(truth).loads(problem.rig.indenters[0], contacts) / problem.force_n[:, None]
        assert got == pytest.approx(expected, abs=2e-6)

    def test_cells_lose_a_twelfth_of_their_square(self, problem: FitProblem, truth: Truth) -> None:
        pose = truth.across_m, truth.y_m, truth.alpha_rad
        for cell in (0.25e-3, 0.5e-3):
            lost = SkinShares(problem, *pose, resolution_m=cell).lost_m2()
            assert lost == pytest.approx(np.full(2, cell**2 / 12), rel=1e-6)

    def test_are_zero_where_the_taxels_have_no_place(self, on_mesh: FitProblem) -> None:
        shares = SkinShares(on_mesh, 0.0, 0.2, 0.0)
        assert shares.skin is None
        assert (shares.shares(np.array([0, 1]), np.zeros((2, 2)), np.full(2, -19.0)) == 0).all()
        assert (shares.lost_m2() == 0).all()


class TestGrid:
    def test_holds_what_single_combinations_give(self, problem: FitProblem, truth: Truth) -> None:
        few = problem.subset(np.arange(len(problem)) < 4, "left out")
        macro = truth.macro
        grid = MacroGrid(
            macro[:1], macro[1] + np.array([0.0, 1e-3]), macro[2:3], macro[3] + np.array([0.0, 0.5])
        )
        slab = evaluate_slab(few, grid, 0, SETTINGS)
        assert slab.mse_counts2.shape == (2, 1, 2)
        skin = SkinShares(few, macro[0], grid.y_m[1], macro[2])
        one = evaluate_pose(few, skin, grid.log_elasticity[1:], SETTINGS)[0]
        assert slab.mse_counts2[1, 0, 1] == pytest.approx(one.mse_counts2)
        assert slab.scale_per_n[1, 0, 1] == pytest.approx(one.scale_per_n)
        assert slab.slack_rms_m[1, 0, 1] == pytest.approx(one.slack_rms_m)
        assert slab.mse_counts2[0, 0, 0] < slab.mse_counts2[1, 0, 1]

    def test_a_pose_without_a_place_explains_nothing(self, on_mesh: FitProblem) -> None:
        nowhere = SkinShares(on_mesh, 0.0, 0.2, 0.0)
        got = evaluate_pose(on_mesh, nowhere, np.log([4e8]), SETTINGS)[0]
        assert got.scale_per_n == 0.0
        seen = (on_mesh.values * on_mesh.weight)[on_mesh.weight > 0]
        assert got.mse_counts2 == pytest.approx((seen**2).mean())

    def test_the_default_is_coarse(self, problem: FitProblem, table: PressTable) -> None:
        assert default_steps(build_problem(rig(), table)) == GridSteps()
        paper = SearchBox((-2.4e-3, 2.4e-3), (0.0195, 0.0275), (math.radians(-20), math.radians(20)))
        assert 100 < plan_grid(problem, paper, FitOptions()).combinations < 1000


class TestTable:
    @pytest.mark.parametrize("away", [np.zeros(5), np.array([0.4e-3, -0.3e-3, 0.04, 0.3, 0.0])])
    def test_gives_the_images_of_the_skin(
        self, eight: FitProblem, tabled: SkinTable, truth: Truth, away: np.ndarray
    ) -> None:
        macro, press, nuisance = _pairs(eight, truth.macro + away)
        got = see(tabled, eight, macro, press, nuisance).value
        expected = _direct(eight, macro[0], press, nuisance, 0.125e-3)
        assert np.abs(got - expected).max() < 6e-3
        assert np.sqrt(((got - expected) ** 2).mean()) < 5e-4

    def test_its_coarse_cells_make_no_image_sharper(
        self, eight: FitProblem, tabled: SkinTable, truth: Truth
    ) -> None:
        macro, press, nuisance = _pairs(eight, truth.macro, 400)
        expected = see(
            Neighbourhood.around(macro[0]).model(eight).tables, eight, macro, press, nuisance
        ).value
        raw = _direct(eight, macro[0], press, nuisance)
        got = see(tabled, eight, macro, press, nuisance).value
        # Of images of one total, the sharper has the larger sum of squares.
        assert (raw**2).sum() > 1.002 * (expected**2).sum()
        assert (got**2).sum() == pytest.approx((expected**2).sum(), rel=1e-3)

    def test_slopes_are_those_of_its_own_values(
        self, eight: FitProblem, tabled: SkinTable, truth: Truth
    ) -> None:
        macro, press, nuisance = _pairs(eight, truth.macro + np.array([0.1e-3, 0.1e-3, 0.01, 0.1, 0.0]))
        seen = see(tabled, eight, macro, press, nuisance)
        slopes = [seen.by_centre[..., 0], seen.by_centre[..., 1], seen.by_alpha, -seen.by_log_ratio]
        for i, (step, slope) in enumerate(zip((1e-6, 1e-6, 1e-4, 1e-3), slopes, strict=True)):
            shift = step * np.eye(5)[i]
            ahead, behind = (see(tabled, eight, macro + s, press, nuisance).value for s in (shift, -shift))
            assert slope == pytest.approx((ahead - behind) / (2 * step), abs=0.02 * np.abs(slope).max())
        slopes = [seen.by_contact[..., 0], seen.by_contact[..., 1], seen.by_log_ratio]
        for i, (step, slope) in enumerate(zip((1e-6, 1e-6, 1e-3), slopes, strict=True)):
            shift = step * np.eye(3)[i]
            ahead, behind = (see(tabled, eight, macro, press, nuisance + s).value for s in (shift, -shift))
            assert slope == pytest.approx((ahead - behind) / (2 * step), abs=0.02 * np.abs(slope).max())

    def test_spreads_as_the_kernels_do(self, eight: FitProblem, truth: Truth) -> None:
        few = eight.subset(np.arange(len(eight)) < 4, "left out")
        macro, press, nuisance = _pairs(few, truth.macro)
        spread = 0.3e-3
        reach = TableReach(0.2e-3, 0.02, 0.2, levels=3, step_m=0.3e-3)
        tabled = _tabled(few, macro[0], reach)
        kernels = replace(Neighbourhood.around(macro[0]), spread_m=spread).model(few).tables
        expected = see(kernels, few, macro, press, nuisance).value
        got = see(tabled.spread(spread), few, macro, press, nuisance).value
        plain = see(tabled, few, macro, press, nuisance).value
        assert np.abs(plain - expected).max() > 0.02
        assert np.abs(got - expected).max() < 0.004
        assert tabled.spread(0.0) is tabled

    def test_follows_a_surface_that_changes_along_the_finger(self, table: PressTable, truth: Truth) -> None:
        cone = general_problem(
            some_presses(table, np.arange(4)), shell(lambda y: RADIUS + 0.4 * (0.0235 - y), 400, 150)
        )
        cone = cone.subset(np.arange(len(cone)) < 2, "left out")
        assert len(cone) == 2
        away = np.array([0.0, 0.5e-3, 0.0, 0.0, 0.0])
        tabled = _tabled(cone, truth.macro, replace(REACH, levels=3))
        macro, press, nuisance = _pairs(cone, truth.macro + away)
        expected = _direct(cone, macro[0], press, nuisance)
        flat = replace(tabled, shares=tabled.shares * np.r_[np.ones(tabled.shares.shape[-1] - 2), 0.0, 0.0])
        error, without = (
            np.sqrt(((see(t, cone, macro, press, nuisance).value - expected) ** 2).mean())
            for t in (tabled, flat)
        )
        assert error < 1e-3
        assert error < 0.6 * without

    def test_does_not_depend_on_how_it_was_divided(self, eight: FitProblem, truth: Truth) -> None:
        macro = truth.macro
        reach = replace(REACH, levels=3, step_m=0.8e-3)
        whole = tabulate_presses(eight, np.arange(len(eight)), macro, reach)
        parts = _tabled(eight, macro, reach)
        many, press, nuisance = _pairs(eight, macro)
        assert (
            see(whole, eight, many, press, nuisance).value == see(parts, eight, many, press, nuisance).value
        ).all()

    def test_serves_a_problem_without_some_of_its_presses(
        self, eight: FitProblem, tabled: SkinTable, truth: Truth
    ) -> None:
        keep = np.arange(len(eight)) != 1
        fewer = eight.subset(keep, "glitch")
        macro = np.tile(truth.macro, (len(fewer), 1))
        got = see(tabled, fewer, macro, np.arange(len(fewer)), np.zeros((len(fewer), 3))).value
        all_ = see(
            tabled,
            eight,
            np.tile(macro[0], (len(eight), 1)),
            np.arange(len(eight)),
            np.zeros((len(eight), 3)),
        )
        assert (got == all_.value[keep]).all()


def _bounds(box: SearchBox, scales: tuple[float, float]) -> Bounds:
    low, high = np.array([box.across_m, box.y_m, box.alpha_rad]).T
    edges = np.log([box.elasticity_pa_per_m, scales])
    return Bounds(np.r_[low, edges[:, 0]], np.r_[high, edges[:, 1]])


def test_a_climb_ends_where_that_of_the_fast_way_does(
    table: PressTable, eight: FitProblem, truth: Truth
) -> None:
    start = truth.macro + np.array([0.2e-3, -0.2e-3, 0.03, 0.1, 0.0])
    # On cells of 0.5 mm tabled every 0.3 mm the centre is 0.6 sigma off, and E and S 0.5.
    tabled = _tabled(eight, truth.macro, replace(REACH, step_m=0.2e-3, resolution_m=0.25e-3))
    general = climb_near(eight, _bounds(BOX, eight.scales), start, Neighbourhood.around(start, tabled))
    plain = build_problem(rig(), table, min_active=2)
    plain = plain.subset(np.isin(plain.rows, eight.rows), "left out")
    fast = climb_near(plain, _bounds(BOX, eight.scales), start)
    sigma = np.sqrt(np.diag(fast.covariance))
    assert abs(general.log_density - fast.log_density) < 2.0
    off, width = np.abs(general.macro - fast.macro) / sigma, np.sqrt(np.diag(general.covariance)) / sigma
    assert (off < 0.2).all()
    assert width == pytest.approx(np.ones(5), rel=0.1)
    assert choose_reach(general).centre_m < ROUGH.centre_m


def test_on_a_plane_the_centre_is_x(truth: Truth) -> None:
    flat = replace(rig(), surface=Plane())
    table, _ = make_session(presses=6)
    problem = build_problem(flat, table)
    points = np.column_stack([table.across_m, table.along_m, np.zeros(6)])
    problem = replace(problem, contacts=ContactMap.of(Plane(), points, problem.rows, 2e-3 + TABLE_MARGIN_M))
    shares = SkinShares(problem, 1e-3, 0.0238, 0.1)
    press = np.arange(len(problem))
    moved = SkinShares(problem, 2e-3, 0.0238, 0.1)
    ratio = np.full(len(press), -19.0)
    shifted = np.tile([1e-3, 0.0], (len(press), 1))
    assert moved.shares(press, shifted, ratio) == pytest.approx(
        shares.shares(press, np.zeros_like(shifted), ratio), abs=1e-6
    )


@pytest.mark.slow
def test_the_whole_general_fit_agrees_with_the_fast_one(truth: Truth) -> None:
    table, _ = make_session(truth, presses=30, seed=3)
    options = replace(QUICK, steps=GridSteps(2.4e-3, 2.0e-3, math.radians(20), 4))
    problem = general_problem(table)
    assert problem.contacts is not None
    local = LocalPlaces.of(problem, on_cylinder(table), np.array([0.0, truth.y_m]))
    contacts = replace(problem.contacts, local=local, skin_on_grid=True)
    general = _solved(replace(problem, contacts=contacts), options)
    fast = _solved(build_problem(rig(), table, min_active=2), QUICK)
    for name, (low, high) in fast.intervals.items():
        assert low <= general.best[name] <= high, name
        own = general.intervals[name]
        # Ends of intervals come from a few hundred independent draws here; up to 15 % were measured.
        assert own[1] - own[0] == pytest.approx(high - low, rel=0.3), name
        assert own[0] <= getattr(truth, name) <= own[1], name
    assert general.mse_counts2 == pytest.approx(fast.mse_counts2, abs=0.1)


def _solved(problem: FitProblem, options: FitOptions) -> FitResult:
    return solve(problem, BOX, options, np.random.default_rng(0))
