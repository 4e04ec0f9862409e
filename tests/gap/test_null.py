"""Null sessions: what scores chance gives, and how often it reaches one."""

from __future__ import annotations

import numpy as np
import pytest
from gap.made_sessions import OPTIONS, Case, based, case, made, scene_of

from skincal.gap.candidates import Scene
from skincal.gap.library import Library
from skincal.gap.models import Material
from skincal.gap.null import Null, law_errors, simulate_null
from skincal.gap.signatures import signature_columns
from skincal.gap.twin import Twin, twins_for

NAMES = ("hysteresis", "crosstalk", "saturation", "taxel_offset", "contact_offset", "force_bias")


def null_of(of: Case, draws: int, seed: int, errors: dict[str, np.ndarray] | None = None) -> Null:
    errors = errors or {"fitted": np.zeros_like(of.scene.zero)}
    library = Library.of(of.scene, NAMES)
    signs = signature_columns(of.scene.slopes, of.made.session, of.made.truth.model.layout)
    columns = {name: signs[name][1] for name in ("unloading", "force")}
    rng = np.random.default_rng(seed)
    return simulate_null(of.scene, of.made.material, library, errors, draws, rng, columns)


@pytest.fixture(scope="module")
def null() -> Null:
    return null_of(case("none"), 400, 0)


def best_p(null: Null, other: Null) -> np.ndarray:
    """The p-value of the best effect of each session of another null."""
    names = list(other.scores)
    units = np.stack([other.scores[n] / null.unit(n) for n in names])
    best = np.argmax(units, axis=0)
    return np.array([null.p_value(names[b], other.scores[names[b]][d]) for d, b in enumerate(best)])


def test_p_values_of_null_sessions_are_as_they_should(null: Null):
    p = best_p(null, null_of(case("none"), 400, 1))
    for level in (0.01, 0.05, 0.2, 0.5):
        assert np.mean(p <= level) == pytest.approx(level, abs=4.5 * np.sqrt(level * (1 - level) / 200))


def test_a_higher_score_is_never_likelier(null: Null):
    for name in NAMES:
        chances = [null.p_value(name, s) for s in np.linspace(-5, 60, 40)]
        assert (np.diff(chances) <= 0).all()
        assert chances[0] <= 1 and chances[-1] >= 1 / 401
    assert null.p_value("hysteresis", 1e6) == 1 / 401
    assert null.p_value("hysteresis", -1e6) == 1


def test_scores_are_counted_in_what_each_effect_reaches_by_chance(null: Null):
    for name in NAMES:
        assert np.mean(null.scores[name] > null.unit(name)) <= 0.051
    # What is not in the list, as a taxel that dies, counts as the quietest.
    assert 1 < null.unit("dead_taxel") <= min(null.unit(name) for name in NAMES)
    assert (null.best == np.max([own / null.unit(n) for n, own in null.scores.items()], axis=0)).all()


def test_laws_are_told_apart():
    of = case("none")
    rough = np.zeros_like(of.scene.zero)
    rough[::3] = 3.0
    both = null_of(of, 20, 2, {"fitted": np.zeros_like(rough), "rough": rough})
    assert both.laws == ("fitted",) * 20 + ("rough",) * 20
    assert all(len(own) == 40 for own in both.scores.values())
    assert both.mean_square == pytest.approx(1 + 0.5 * 9 / 3, abs=0.15)
    share = both.signatures["force"]
    assert len(share) == 40 and (share >= 0).all()


def test_a_null_session_has_the_mean_square_of_noise(null: Null):
    assert null.mean_square == pytest.approx(1.0, abs=0.01)


def test_an_excess_is_counted_in_the_most_of_any_null_session(null: Null):
    assert len(null.beyond) == len(null.laws)
    assert null.beyond.mean() == pytest.approx(0.0, abs=1e-6 * null.beyond.max())
    assert null.times_most(3 * null.beyond.max()) == pytest.approx(3.0)
    assert Null((), {}, 1.0).times_most(100.0) == 0.0


def test_same_seed_same_null():
    one, two = (null_of(case("none"), 5, 3) for _ in range(2))
    assert all((one.scores[n] == two.scores[n]).all() for n in one.scores)


def test_the_fitted_law_has_no_error_and_another_one_has():
    of = case("none")
    model, material = of.model.hypothesis, of.made.material
    same = law_errors(of.scene, material, [Twin("same", lambda h, s: h.values(s))])["same"]
    # Presses and sensor stay where they are; one count in a thousand is less than anything.
    assert np.abs(same).max() < 0.02
    twin = twins_for(model, of.made.session)[1]
    other = law_errors(of.scene, material, [twin])[twin.name]
    assert other.shape == same.shape and np.sqrt((other**2).mean()) > 0.2
    scored = null_of(of, 30, 4, {"fitted": np.zeros_like(other), twin.name: other})
    assert scored.best[30:].max() > scored.best[:30].max()


@pytest.mark.slow
def test_sessions_without_effects_have_the_p_values_of_null_sessions(null: Null):
    """Not linearised ones but sessions that the model itself made, each fitted."""
    p: list[float] = []
    for seed in range(24):
        one = made(seed=100 + seed)
        model = based(one)
        scene: Scene = scene_of(one, model)
        material: Material = one.material
        views = scene.part(material.learn), scene.part(material.score)
        residuals = views[0].residual, views[1].residual
        library = Library.of(scene, NAMES)
        own = {n: float(library.falls(n, views, residuals)[1][0]) for n in NAMES}
        name = max(own, key=lambda n: own[n] / null.unit(n))
        p.append(null.p_value(name, own[name]))
    assert OPTIONS.position_sigma_m == 1e-4
    assert np.mean(np.array(p) <= 0.05) <= 0.2
    assert 0.3 < np.mean(p) < 0.85
