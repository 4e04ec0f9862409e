"""What an effect explains is what the squared residual falls by, and what was hidden is found by searching for it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from gap.made_sessions import LAYOUT, MODEL, OPTIONS, Case, arrays, based, case, made, pressed, scene_of
from model.model_shapes import sphere_mesh

from skincal.effects import COVARIATES, EFFECTS
from skincal.gap.candidates import FEWER, FORMS, Bench, Found, Scene, Start, View, best_of, search, straight
from skincal.gap.hypothesis import Hypothesis
from skincal.gap.library import Library


def views(of: Case) -> tuple[View, View]:
    return of.scene.part(of.made.material.learn), of.scene.part(of.made.material.score)


def found(name: str, of: Case) -> Found:
    best = best_of(of.scene, name, *views(of))
    assert best is not None
    return best


def bench(**lacking: None) -> Bench:
    session = pressed()
    session = replace(session, samples=replace(session.samples, **lacking))
    return Bench(Hypothesis(MODEL, np.zeros((session.presses, 3))), session)


@pytest.mark.parametrize("name", EFFECTS)
def test_values_under_an_effect_are_those_of_the_model(name: str):
    here = bench()
    zero = here.values({})
    effect = {name: EFFECTS[name].at_strength(0.5, np.random.default_rng(0), LAYOUT)}
    expected = here.hypothesis.with_effects(effect).values(here.session)
    # What was asked before, and is kept, must not show.
    here.values({"stiffening": {"exponent": np.asarray(1.2)}})
    here.values({"spread": {"width_m": np.asarray(1e-3)}})
    here.values({"creep": {"amplitude": np.asarray(0.1)}})
    for _ in range(2):
        assert here.values(effect) == pytest.approx(expected, abs=1e-9)
        assert (here.values({}) == zero).all()
    assert np.abs(expected - zero).max() > 0.3


def test_values_beside_an_effect_that_is_there_already():
    one = made({"hysteresis": {"height": 0.3}})
    here = Bench(one.truth, one.session)
    both = arrays({"hysteresis": {"height": 0.3}, "crosstalk": {"leak": 0.1}})
    expected = one.truth.with_effects(both).values(one.session)
    assert here.values(arrays({"crosstalk": {"leak": 0.1}})) == pytest.approx(expected, abs=1e-9)
    assert here.starts("hysteresis") == []


@pytest.mark.parametrize("name", [name for name in EFFECTS if name != "dead_taxel"])
def test_every_effect_is_searched_from_each_of_its_forms(name: str):
    starts = bench().starts(name)
    whole = len(FORMS.get(name, [{}]))
    assert len(starts) == whole + len(FEWER.get(name, ()))
    for start, left_out in zip(starts[whole:], FEWER.get(name, ()), strict=True):
        names = {p.name for p in EFFECTS[name].parameters}
        assert left_out < names and {c.parameter.name for c in start.coords} == names - left_out
    for start, forms in zip(starts[:whole], FORMS.get(name, [{}]), strict=True):
        assert start.effect == name and any(c.is_strength for c in start.coords)
        assert {c.parameter.name: c.start for c in start.coords if c.parameter.name in forms} == forms
        assert {c.parameter.name for c in start.coords} == {p.name for p in EFFECTS[name].parameters}


def test_drift_without_time_has_nothing_to_leave_out():
    untimed = bench(**{COVARIATES["time"]: None})
    for name in FEWER:
        assert len(untimed.starts(name)) == len(FORMS[name])


def test_a_form_that_holds_for_no_other_presses_gives_way(monkeypatch: pytest.MonkeyPatch):
    of = case("hysteresis")
    starts = of.scene.bench.starts("hysteresis")
    falls = iter([(100.0, -50.0), (40.0, 20.0), (60.0, 5.0)])

    def found(scene: Scene, start: Start, learn: View, score: View) -> Found:
        return Found(start, np.zeros(len(start.coords)), *next(falls))

    monkeypatch.setattr("skincal.gap.candidates.search", found)
    best = best_of(of.scene, "hysteresis", *views(of))
    assert best is not None and best.scored == 20.0 and best.start.coords == starts[1].coords
    falls = iter([(100.0, 1.0), (40.0, 20.0), (60.0, 5.0)])
    best = best_of(of.scene, "hysteresis", *views(of))
    assert best is not None and best.learned == 100.0


def test_dead_taxels_are_not_searched():
    assert bench().starts("dead_taxel") == []


def test_what_the_data_cannot_tell_is_not_searched():
    blind = bench(**dict.fromkeys(COVARIATES.values()))
    for name, effect in EFFECTS.items():
        starts = blind.starts(name)
        assert not (effect.covariates and starts), name
        assert not any(c.parameter.needs for start in starts for c in start.coords)
    assert blind.starts("crosstalk") and blind.starts("contact_offset")
    samples = replace(pressed().samples, indenters=(sphere_mesh(1), sphere_mesh(1)))
    meshes = Bench(blind.hypothesis, replace(pressed(), samples=samples))
    assert meshes.starts("indenter_radius") == [] and meshes.starts("crosstalk")


def test_taxels_that_are_not_looked_at_are_not_searched():
    some = Bench(Hypothesis(MODEL, np.zeros((24, 3))), pressed().of_taxels(np.array([0, 4, 8])))
    (start,) = some.starts("taxel_offset")
    assert [c.index for c in start.coords] == [0, 4, 8]
    assert some.values({}).shape[1] == 3


def test_a_fall_is_the_difference_of_two_squares():
    of = case("crosstalk")
    learn, _ = views(of)
    change = of.scene.bench.values(arrays({"crosstalk": {"leak": 0.03}})) - of.scene.zero
    left = learn.residual - learn.seen(change)
    assert learn.fall(change) == pytest.approx((learn.residual**2).sum() - (left**2).sum())
    assert learn.fall(np.zeros_like(change)) == 0
    assert learn.seen(np.stack([change, 2 * change], axis=-1)) == pytest.approx(
        np.hstack([learn.seen(change), 2 * learn.seen(change)])
    )


def test_the_base_model_and_places_explain_nothing_more():
    of = case("none")
    learn, _ = views(of)
    rows, slopes = learn.rows, of.scene.slopes
    for k in range(5):
        white = slopes.base[rows][..., k].reshape(-1, 1)
        assert np.linalg.norm(learn.projection.apply(white)) < 1e-9 * np.linalg.norm(white)
    own = np.where(
        (of.scene.press[rows] == of.scene.press[rows].max())[:, None], slopes.place[rows][..., 0], 0.0
    )
    before, after = own.reshape(-1, 1), learn.projection.apply(own.reshape(-1, 1))
    # Known to 0.1 mm from its own measurement, a press takes up all but what that prior allows.
    strength = np.linalg.norm(before) * OPTIONS.position_sigma_m
    assert np.linalg.norm(after) <= 1.001 * np.linalg.norm(before) / np.hypot(1.0, strength)


def test_the_residual_of_a_true_base_model_is_noise_once_projected():
    of = case("none")
    for view in views(of):
        freedom = len(view.residual) - 5
        assert (view.residual**2).sum() / freedom == pytest.approx(1.0, abs=5 * np.sqrt(2 / freedom))


@pytest.mark.parametrize("name", ["hysteresis", "crosstalk", "taxel_gain"])
def test_what_is_hidden_is_found(name: str):
    of = case(name)
    best = found(name, of)
    assert best.effect == name and best.learned > 20 and best.scored > 20
    truth = of.made.truth.effects[name]
    for key, value in truth.items():
        p = EFFECTS[name].parameter(key)
        got = best.parameters[name][key]
        unit = p.typical if p.role == "strength" else np.abs(value)
        # Taxels that a dozen presses hardly reach keep to their prior.
        assert np.median(np.abs(got - value)) < 0.45 * np.abs(unit), key


def test_fading_with_what_a_site_has_met_is_found_where_that_is_known():
    effect: dict[str, dict[str, float]] = {
        "first_cycle": {"amplitude": 0.6, "cycles": 90.0, "fading_per_n": 0.3}
    }
    one = made(effect, pressed(100))
    unknown = replace(one, session=replace(one.session, samples=replace(one.session.samples, met_n=None)))
    told, untold = (
        best_of(scene, "first_cycle", scene.part(of.material.learn), scene.part(of.material.score))
        for of in (one, unknown)
        for scene in [scene_of(of, based(of))]
    )
    assert told is not None and untold is not None
    assert told.learned > 1.1 * untold.learned > 20 and told.scored > 1.1 * untold.scored
    own = told.parameters["first_cycle"]
    assert own["fading_per_n"] == pytest.approx(0.3, abs=0.2) and own["cycles"] > 5
    assert "fading_per_n" not in untold.parameters["first_cycle"]


def test_an_effect_in_the_positions_is_seen_where_they_were_measured():
    """The places of the presses take it up nearly wholly; what moved them tells of it all the same."""
    of = case("contact_offset")
    residual = of.model.refit.slopes.residual
    assert np.mean(residual**2) < 1.15
    best = found("contact_offset", of)
    assert best.learned > 40 and best.scored > 20
    own = best.parameters["contact_offset"]
    assert own["stretch_across"] > 0.02 and own["stretch_along"] < -0.02
    assert own["pose_along_m"][0] - own["pose_along_m"][1] > 2e-4
    moved = replace(of.scene, residual=residual)
    blind = best_of(moved, "contact_offset", *(moved.part(v.rows) for v in views(of)))
    assert blind is not None and best.learned > 5 * max(blind.learned, 0.0)


def test_what_moves_contacts_is_explained_to_first_order():
    of = case("contact_offset")
    learn, score = views(of)
    (start,) = of.scene.bench.starts("contact_offset")
    best = straight(of.scene, start, learn, score)
    library = Library.of(of.scene, ["contact_offset"])
    learned, scored = library.falls("contact_offset", (learn, score), (learn.residual, score.residual))
    assert (best.learned, best.scored) == pytest.approx((learned[0], scored[0]))


def test_a_search_never_ends_worse_than_it_began():
    of = case("none")
    learn, score = views(of)
    for name in ("creep", "saturation", "spread"):
        for start in of.scene.bench.starts(name):
            best = search(of.scene, start, learn, score)
            assert best.learned >= -1e-6 and np.isfinite(best.scored)
            for c, x in zip(start.coords, best.x, strict=True):
                assert c.bounds[0] - 1e-12 <= x <= c.bounds[1] + 1e-12


def test_a_search_goes_on_from_where_it_is_told():
    of = case("hysteresis")
    learn, score = views(of)
    best = found("hysteresis", of)
    again = search(of.scene, replace(best.start, x=tuple(best.x)), learn, score)
    assert again.learned >= best.learned - 1e-6
    assert again.x == pytest.approx(best.x, abs=0.1)


def test_a_scene_without_presses_to_move_is_the_fit_itself():
    of = case("none")
    still = of.model.hypothesis.with_places(np.zeros_like(of.model.hypothesis.places))
    scene = Scene.of(still, of.model.refit.slopes, of.made.session, of.made.reading, OPTIONS)
    assert (scene.residual == of.model.refit.slopes.residual).all()
