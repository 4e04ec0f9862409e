"""Directions in which the contact law may err: few, enough for laws between those they come from, and not effects."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from gap.made_sessions import Case, case

from skincal.gap.candidates import Scene, best_of
from skincal.inference.elastic_layer import Layer
from skincal.gap.hypothesis import Hypothesis
from skincal.gap.law import MOST, law_directions
from skincal.gap.models import excess_of, scene_of
from skincal.gap.null import law_errors
from skincal.gap.session import GapSession
from skincal.gap.twin import Twin, alike_layer, layer_loads, twins_for
from skincal.model import Cylinder


def errors_of(of: Case) -> list[np.ndarray]:
    return list(
        law_errors(of.scene, of.made.material, twins_for(of.model.hypothesis, of.made.session)).values()
    )


def with_law(of: Case) -> Scene:
    law = law_directions(of.scene, of.made.material.known, errors_of(of))
    return scene_of(of.model, replace(of.made.material, law=law))


def length(scene: Scene, of: Case, error: np.ndarray) -> float:
    view = scene.part(of.made.material.known)
    return float((view.projection.apply(error[view.rows].reshape(-1, 1)) ** 2).sum())


def test_few_directions_hold_what_all_laws_do():
    of = case("none")
    scene = with_law(of)
    assert 1 <= scene.law.shape[-1] <= MOST
    for error in errors_of(of):
        assert length(scene, of, error) < max(10.0, 0.05 * length(of.scene, of, error))


def test_a_law_between_them_is_held_as_well():
    of = case("none")
    model = of.model.hypothesis
    surface = model.model.surface
    assert isinstance(surface, Cylinder)
    force = of.made.session.samples.contacts.force_n
    middle = float(np.median(force[of.made.session.samples.touching]))
    layer = alike_layer(surface, 0.006, model.model.elasticity_pa_per_m, middle, 2.3e-3)

    def values(h: Hypothesis, s: GapSession) -> np.ndarray:
        stiffer = h.model.elasticity_pa_per_m / model.model.elasticity_pa_per_m
        between = Layer(layer.thickness_m, layer.shear_modulus_pa * stiffer, 0.43)
        return s.means(layer_loads(h, h.placed(s).samples, between) * h.model.scale_per_n)

    twin = Twin("between", values)
    error = law_errors(of.scene, of.made.material, [twin])["between"]
    # More than the least unit of a score before, less than that after.
    assert length(of.scene, of, error) > 100
    assert length(with_law(of), of, error) < 30


def test_no_law_no_directions():
    of = case("none")
    law = law_directions(of.scene, of.made.material.known, [np.zeros_like(of.scene.zero)])
    assert law.shape == (*of.scene.zero.shape, 0)


def test_an_effect_that_no_law_is_like_is_seen_as_before():
    of = case("hysteresis")
    scene, known = with_law(of), of.made.material
    views = scene.part(known.learn), scene.part(known.score)
    before = of.scene.part(known.learn), of.scene.part(known.score)
    found, was = best_of(scene, "hysteresis", *views), best_of(of.scene, "hysteresis", *before)
    assert found is not None and was is not None
    assert found.scored == pytest.approx(was.scored, rel=0.2) and found.scored > 100


def test_what_a_law_explains_is_not_in_the_excess():
    of = case("hysteresis")
    law = with_law(of).law
    without = excess_of(of.model, of.made.material, 1.0)
    assert excess_of(of.model, replace(of.made.material, law=law), 1.0) <= without + 1e-6


def test_the_sensor_of_a_twin_is_the_one_whose_fit_is_this_model():
    of = case("none")
    twins = twins_for(of.model.hypothesis, of.made.session)
    thick = law_errors(of.scene, of.made.material, twins)[twins[-1].name]
    rows = of.made.material.known
    view = of.scene.part(rows)
    free = replace(view.projection, basis=np.zeros((thick[rows].size, 0)))
    own = free.apply(thick[rows].reshape(-1, 1))
    slopes = free.apply(of.scene.slopes.base[rows].reshape(own.shape[0], -1))
    step = np.linalg.lstsq(slopes, own[:, 0], rcond=None)[0]
    as_wide = of.made.material.reading.expected(twins[-1].values(of.model.hypothesis, of.made.session))
    error = of.made.material.reading.with_counts(as_wide).residual(of.scene.zero)
    there = np.linalg.lstsq(slopes, free.apply(error[rows].reshape(-1, 1))[:, 0], rcond=None)[0]
    # E and S of what would fit it are these; a twin as wide as the fitted law is fitted by others.
    assert np.abs(step[3:]).max() < 0.3 * np.abs(there[3:]).max()


def test_where_the_sensor_is_not_free_it_stays():
    of = case("none")
    m = of.made.material
    (thick,) = twins_for(of.model.hypothesis, m.session)[-1:]
    held = replace(m, options=replace(m.options, base=False))
    there = m.reading.expected(thick.values(of.model.hypothesis, m.session))
    stays = m.reading.with_counts(there).residual(of.model.hypothesis.values(m.session))
    np.testing.assert_allclose(law_errors(of.scene, held, [thick])[thick.name], stays)
    assert not np.allclose(law_errors(of.scene, m, [thick])[thick.name], stays)
