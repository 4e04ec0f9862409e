"""Linearised sensitivities: their falls are those of a ridge regression, and of the search where effects are small."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from gap.made_sessions import OPTIONS, case, made, scene_of

from skincal.effects import EFFECTS
from skincal.gap.candidates import search
from skincal.gap.free import priors, strengths
from skincal.gap.library import Library, columns_of
from skincal.gap.models import Model
from skincal.gap.refit import refit


def parts(name: str = "none"):
    of = case(name)
    return of.scene, (of.scene.part(of.made.material.learn), of.scene.part(of.made.material.score))


def test_falls_are_those_of_a_ridge_regression():
    scene, views = parts()
    library = Library.of(scene, ["taxel_offset"])
    ((start, columns),) = library.columns["taxel_offset"]
    assert columns.shape == (*scene.zero.shape, 9)
    first, second = (v.seen(columns) for v in views)
    penalty = 1 / priors(start.coords)[strengths(start.coords)]
    tall = np.vstack([first, np.diag(penalty)])
    x = np.linalg.lstsq(tall, np.vstack([views[0].residual, np.zeros((9, 1))]), rcond=None)[0]
    expected = [
        (v.residual**2).sum() - ((v.residual - s @ x) ** 2).sum()
        for v, s in zip(views, (first, second), strict=True)
    ]
    learned, scored = library.falls("taxel_offset", views, (views[0].residual, views[1].residual))
    assert [learned[0], scored[0]] == pytest.approx(expected)


def test_many_residuals_at_once_are_what_they_are_one_by_one():
    scene, views = parts()
    library = Library.of(scene, ["hysteresis", "crosstalk"])
    rng = np.random.default_rng(0)
    drawn = tuple(v.projection.apply(rng.standard_normal((len(v.residual), 5))) for v in views)
    for name in library.columns:
        learned, scored = library.falls(name, views, (drawn[0], drawn[1]))
        for d in range(5):
            one = library.falls(name, views, (drawn[0][:, d : d + 1], drawn[1][:, d : d + 1]))
            assert [learned[d], scored[d]] == pytest.approx([one[0][0], one[1][0]])


def test_the_form_that_learns_most_is_scored():
    scene, views = parts("hysteresis")
    library = Library.of(scene, ["hysteresis"])
    residuals = views[0].residual, views[1].residual
    learned, scored = library.falls("hysteresis", views, residuals)
    single = [
        Library({"hysteresis": (form,)}).falls("hysteresis", views, residuals)
        for form in library.columns["hysteresis"]
    ]
    assert len(single) == 3
    best = int(np.argmax([s[0][0] for s in single]))
    assert (learned[0], scored[0]) == (single[best][0][0], single[best][1][0])
    # Where what was learned by that form does not hold on the presses that score, the one that holds best does.
    against = residuals[0], -residuals[1]
    single = [
        Library({"hysteresis": (form,)}).falls("hysteresis", views, against)
        for form in library.columns["hysteresis"]
    ]
    assert single[best][1][0] < 0
    learned, scored = library.falls("hysteresis", views, against)
    best = int(np.argmax([s[1][0] for s in single]))
    assert (learned[0], scored[0]) == (single[best][0][0], single[best][1][0])


@pytest.mark.parametrize(
    ("name", "parameter"), [("crosstalk", "leak"), ("creep", "amplitude"), ("force_bias", "offset_n")]
)
def test_small_effects_explain_what_the_search_finds(name: str, parameter: str):
    p = EFFECTS[name].parameter(parameter)
    one = made({name: {parameter: p.neutral + 0.25 * p.typical}})
    model = Model(refit(one.start, one.session, one.reading, OPTIONS, learn=one.material.known))
    scene = scene_of(one, model)
    views = scene.part(one.material.learn), scene.part(one.material.score)
    library = Library.of(scene, [name])
    learned, _ = library.falls(name, views, (views[0].residual, views[1].residual))
    best = max(search(scene, s, *views).learned for s in scene.bench.starts(name))
    assert best > 15
    assert learned[0] == pytest.approx(best, rel=0.25, abs=4)


def test_columns_are_secants_towards_the_inside_of_the_bounds():
    scene, _ = parts()
    start = scene.bench.starts("crosstalk")[0]
    leak = EFFECTS["crosstalk"].parameter("leak")
    expected = scene.bench.values({"crosstalk": {"leak": np.asarray(0.25 * leak.typical)}}) - scene.zero
    assert columns_of(scene, start)[..., 0] == pytest.approx(expected / 0.25)
    for name in EFFECTS:
        for start in scene.bench.starts(name)[:1]:
            assert np.abs(columns_of(scene, start)).max(axis=(0, 1)).min() > 0, name


def test_a_library_holds_what_the_data_can_speak_of():
    scene, _ = parts()
    session = scene.bench.session
    timeless = replace(session.samples, time_s=None)
    blind = replace(scene, bench=replace(scene.bench, session=replace(session, samples=timeless), cache={}))
    names = ["creep", "latency", "crosstalk", "dead_taxel"]
    assert set(Library.of(blind, names).columns) == {"crosstalk"}
    assert set(Library.of(scene, names).columns) == {"creep", "latency", "crosstalk"}
