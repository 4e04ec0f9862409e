"""The best places within the slack: known answers, bounds, mirror images, and another optimiser's opinion."""

from __future__ import annotations

import nlopt
import numpy as np
import pytest
from published import FINGER as SURFACE
from published import LAYOUT

from skincal.model import Contacts, Patch, SensorPose, Skin, SkinParameters, Sphere
from skincal.prediction import ObservedImages, best_places

POSE = SensorPose(0.0235, -0.06, 0.03)
SKIN = Skin(Patch.build(SURFACE, LAYOUT, POSE), SkinParameters(4e8, 66.0))
INDENTER = Sphere(0.006)


class Bench:
    """Presses on the skin whose measured positions are off by a known slack."""

    def __init__(self, presses: int = 12, seed: int = 0, noise: float = 0.0) -> None:
        generator = np.random.default_rng(seed)
        uv = generator.uniform(-0.006, 0.006, (presses, 2))
        self.measured, _ = SURFACE.wrap(POSE, uv)
        self.slack = generator.uniform(-0.9e-3, 0.9e-3, (presses, 2))
        self.force = generator.uniform(1.5, 4.0, presses)
        self.values = self.simulate(self.slack, np.arange(presses))
        self.values = self.values + generator.normal(0.0, noise, self.values.shape) * (self.values > 0)

    def simulate(self, slack_m: np.ndarray, press: np.ndarray) -> np.ndarray:
        points = SURFACE.offset(self.measured[press], slack_m[:, 0], slack_m[:, 1])
        return SKIN.values(INDENTER, Contacts(points, SURFACE.normal_at(points), self.force[press]))

    def seen(self, values: np.ndarray | None = None, **changes: object) -> ObservedImages:
        values = self.values if values is None else values
        parts = {
            "values": values,
            "weight": np.ones_like(values),
            "saturated": np.zeros(values.shape, dtype=bool),
            "lit": values > 0.5,
            "floor_counts": 0.1,
        }
        return ObservedImages(**(parts | changes))


def test_known_slack_is_found() -> None:
    bench = Bench()
    found = best_places(bench.simulate, bench.seen(), np.inf, 2e-3)
    image = bench.simulate(found.slack_m, np.arange(12))
    assert np.sqrt(np.mean((image - bench.values) ** 2)) < 0.05
    sure = (bench.values > 1.0).sum(axis=1) >= 3
    assert sure.sum() >= 4
    np.testing.assert_allclose(found.slack_m[sure], bench.slack[sure], atol=0.05e-3)


def test_slack_is_bounded() -> None:
    bench = Bench()
    found = best_places(bench.simulate, bench.seen(), np.inf, 0.3e-3)
    assert np.abs(found.slack_m).max() <= 0.3e-3
    assert (np.abs(found.slack_m) > 0.299e-3).any()


def test_a_known_position_stays() -> None:
    bench = Bench(4)
    for sigma, slack in ((0.0, 2e-3), (1e-3, 0.0)):
        assert not best_places(bench.simulate, bench.seen(), sigma, slack).slack_m.any()
    stiff = best_places(bench.simulate, bench.seen(), 1e-7, 2e-3)
    assert np.abs(stiff.slack_m).max() < 1e-6


def test_what_a_position_is_worth_draws_it_back() -> None:
    bench = Bench(noise=1.0)
    free = best_places(bench.simulate, bench.seen(), np.inf, 2e-3)
    prior = best_places(bench.simulate, bench.seen(), 0.05e-3, 2e-3)
    assert (np.hypot(*prior.slack_m.T) <= np.hypot(*free.slack_m.T) + 1e-5).all()


def test_never_worse_than_as_measured_or_in_truth() -> None:
    bench = Bench(noise=0.3)
    sigma = 1e-3
    found = best_places(bench.simulate, bench.seen(), sigma, 2e-3)
    for slack in (np.zeros((12, 2)), bench.slack):
        residual = (bench.simulate(slack, np.arange(12)) - bench.values) / found.noise_counts
        objective = (residual**2).sum(axis=1) + ((slack / sigma) ** 2).sum(axis=1)
        assert (found.objective <= objective + 1e-6).all()


def test_another_optimiser_finds_nothing_better() -> None:
    bench = Bench(8, seed=4, noise=0.3)
    sigma, bound = 1e-3, 2e-3
    found = best_places(bench.simulate, bench.seen(), sigma, bound)
    felt = (bench.values > 1).sum(axis=1)
    assert (felt >= 2).sum() >= 4
    for k in range(8):

        def objective(x: np.ndarray, _gradient: np.ndarray, k: int = k) -> float:
            slack = np.asarray(x)[None] * 1e-3
            residual = (bench.simulate(slack, np.array([k]))[0] - bench.values[k]) / found.noise_counts
            return float(residual @ residual + (slack**2).sum() / sigma**2)

        best = np.inf
        for start in np.stack(np.meshgrid(*2 * [np.linspace(-1.6, 1.6, 4)]), axis=-1).reshape(-1, 2):
            solver = nlopt.opt(nlopt.LN_BOBYQA, 2)
            solver.set_lower_bounds(-1e3 * bound)
            solver.set_upper_bounds(1e3 * bound)
            solver.set_min_objective(objective)
            solver.set_xtol_abs(1e-4)
            solver.set_maxeval(150)
            solver.optimize(start)
            best = min(best, solver.last_optimum_value())
        # What only one taxel feels lies on a ring, rippled by the cells of the patch: any part of it is as good.
        assert found.objective[k] <= best + (1e-3 if felt[k] >= 2 else 2.0)


def test_a_saturated_taxel_is_a_lower_bound() -> None:
    bench = Bench(30, seed=2)
    top = float(bench.values.max()) * 0.3
    saturated = bench.values >= top
    cut = np.minimum(bench.values, top)
    found = best_places(bench.simulate, bench.seen(cut, saturated=saturated), np.inf, 2e-3)
    wrong = best_places(bench.simulate, bench.seen(cut), np.inf, 2e-3)
    hit = (saturated.sum(axis=1) == 1) & ((bench.values > 1).sum(axis=1) >= 4)
    assert hit.any()
    off = np.abs(found.slack_m - bench.slack)[hit].max()
    assert off < 0.1e-3 < np.abs(wrong.slack_m - bench.slack)[hit].max()


def test_unread_taxels_do_not_count() -> None:
    bench = Bench(6)
    rubbish, weight = bench.values.copy(), np.ones_like(bench.values)
    rubbish[:, 5], weight[:, 5] = 200.0, 0.0
    found = best_places(bench.simulate, bench.seen(rubbish, weight=weight), np.inf, 2e-3)
    clean = best_places(bench.simulate, bench.seen(weight=weight), np.inf, 2e-3)
    np.testing.assert_allclose(found.slack_m, clean.slack_m, atol=1e-6)


def test_a_glitch_does_not_set_the_noise() -> None:
    bench = Bench(12, noise=0.3)
    values = bench.values.copy()
    values[3] = np.roll(values[3], 7) * 3
    assert best_places(bench.simulate, bench.seen(values), 1e-3, 2e-3).noise_counts < 1.0


def test_presses_do_not_depend_on_each_other() -> None:
    """A table too large to be simulated at once is cut up."""
    bench = Bench(12)
    together = best_places(bench.simulate, bench.seen(), np.inf, 2e-3)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("skincal.prediction.places.ROOM", 10_000)
        apart = best_places(bench.simulate, bench.seen(), np.inf, 2e-3)
    np.testing.assert_array_equal(apart.slack_m, together.slack_m)


def test_no_press_is_no_work() -> None:
    bench = Bench(1)
    empty = bench.seen(np.empty((0, 16)))
    assert best_places(bench.simulate, empty, 1e-3, 2e-3).slack_m.shape == (0, 2)


@pytest.mark.parametrize("slack", [-1e-3, np.inf, np.nan])
def test_a_slack_that_makes_no_sense(slack: float) -> None:
    bench = Bench(1)
    with pytest.raises(ValueError, match="slack_m: expected a finite length"):
        best_places(bench.simulate, bench.seen(), 1e-3, slack)
