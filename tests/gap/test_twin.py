"""Twins: another contact law on the same sensor, with the force that was pressed and without a place of its own."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from gap.made_sessions import LAYOUT, MODEL, held, pressed
from model.model_shapes import FINGER, cylinder_mesh, sphere_mesh, surface_of

import skincal.gap.twin as twin_module
from skincal.effects import Samples
from skincal.gap.base import BaseModel
from skincal.inference.elastic_layer import ContactError, Layer, Press
from skincal.gap.hypothesis import Hypothesis
from skincal.gap.twin import THICKNESSES_M, alike_layer, layer_loads, twins_for
from skincal.model import Contacts, Plane, SensorPose, Sphere, Surface, TaxelLayout

ONE = TaxelLayout.grid(1, 1, taxel_size_m=0.013, pitch_m=0.013)
FINE_M = 0.3e-3


def layer(thickness_m: float) -> Layer:
    return Layer.of_stiffness(4e8, thickness_m, 0.4)


def on(surface: Surface, layout: TaxelLayout, pose: SensorPose) -> Hypothesis:
    return Hypothesis(
        BaseModel(surface, layout, pose, 4e8, 70.0, MODEL.readout, FINE_M, 1e-3), np.zeros((1, 3))
    )


def pressing(surface: Surface, points_m: np.ndarray, force_n: np.ndarray, radius_m: float = 0.006) -> Samples:
    points = surface.project(points_m)
    return Samples.of(Contacts(points, surface.normal_at(points), force_n), Sphere(radius_m), touching=True)


def on_finger(arc_m: float, y_m: float) -> np.ndarray:
    return np.array([0.0115 * np.sin(arc_m / 0.0115), y_m, 0.0115 * np.cos(arc_m / 0.0115)])


@pytest.mark.parametrize("kind", ["cylinder", "plane"])
def test_loads_sum_to_the_force_as_those_of_the_foundation_do(kind: str):
    surface = FINGER if kind == "cylinder" else Plane()
    pose = SensorPose(0.0235, 0.3) if kind == "cylinder" else SensorPose(0.0235, 0.3, x_m=0.0)
    sensor = on(surface, ONE, pose)
    force = np.array([0.3, 1.0, 2.7, 4.0])
    samples = pressing(surface, np.tile([0.0, 0.0235, 0.0115], (4, 1)), force)
    loads = layer_loads(sensor, samples, layer(1.5e-3))[:, 0]
    # What a taxel feels is projected on its own normal: a little less than the force, but for the grid.
    assert (loads < 1.01 * force).all() and (loads > 0.9 * force).all()
    foundation = sensor.skin.skin.loads(samples.indenters[0], samples.contacts)[:, 0]
    assert loads == pytest.approx(foundation, rel=0.03)
    assert (np.diff(loads / force) < 0).all()


def test_a_thin_layer_is_the_foundation_of_the_same_stiffness():
    sensor = on(FINGER, LAYOUT, SensorPose(0.0235, 0.2, 0.05))
    spots = np.stack(
        [on_finger(a, 0.0235 + b) for a, b in ((0, 0), (1e-3, 2e-3), (-3e-3, 1e-3), (2e-3, -4e-3))]
    )
    samples = pressing(FINGER, spots, np.array([1.0, 2.5, 4.0, 0.6]))
    expected = sensor.skin.skin.loads(samples.indenters[0], samples.contacts)
    off = [
        np.abs(layer_loads(sensor, samples, layer(thickness)) - expected).max()
        for thickness in (0.02e-3, 0.5e-3, 3e-3)
    ]
    assert off[0] < 0.04 * expected.max()
    assert 2 * off[0] < off[2] and off[1] < off[2]


def test_what_is_felt_about_a_contact_does_not_depend_on_where_it_is():
    spots = np.stack([on_finger(1e-3, 0.0235 + 1.5e-3), on_finger(-2e-3, 0.0235)])
    force = np.array([2.0, 3.0])
    here = layer_loads(
        on(FINGER, LAYOUT, SensorPose(0.0235, 0.2)), pressing(FINGER, spots, force), layer(1e-3)
    )
    turn = 0.3
    round_finger = np.array([[np.cos(turn), 0, np.sin(turn)], [0, 1, 0], [-np.sin(turn), 0, np.cos(turn)]])
    elsewhere = on(FINGER, LAYOUT, SensorPose(0.0305, 0.2, turn))
    moved = spots @ round_finger.T + [0, 7e-3, 0]
    there = layer_loads(elsewhere, pressing(FINGER, moved, force), layer(1e-3))
    assert there == pytest.approx(here, abs=1e-9)


def test_a_table_over_the_force_is_as_good_as_a_solution_of_its_own():
    sensor = on(FINGER, LAYOUT, SensorPose(0.0235, 0.2))
    force = np.array([0.37, 0.9, 1.7, 2.9, 4.0])
    spots = np.tile(on_finger(5e-4, 0.0235), (5, 1))
    together = layer_loads(sensor, pressing(FINGER, spots, force), layer(1e-3))
    for k in range(4):
        # Alone, its own force is the largest of the table.
        alone = layer_loads(sensor, pressing(FINGER, spots[k : k + 1], force[k : k + 1]), layer(1e-3))
        assert together[k] == pytest.approx(alone[0], abs=0.015 * force[k])
    weak = layer_loads(sensor, pressing(FINGER, spots[:2], np.array([1e-3, 4.0])), layer(1e-3))
    # Below the table it shrinks in proportion.
    assert 0 < weak[0].sum() <= 1e-3


def test_nothing_is_felt_where_nothing_touches():
    session = pressed(4)
    loads = layer_loads(Hypothesis(MODEL, np.zeros((4, 3))), session.samples, layer(1e-3))
    assert not loads[~session.samples.touching].any()
    assert loads[session.samples.touching].sum() > 0
    assert (loads >= 0).all()


@pytest.mark.parametrize("session", [pressed(6), held(6)], ids=["frames", "holds"])
def test_twins_are_the_sensor_under_another_law(session):
    here = Hypothesis(MODEL, np.zeros((6, 3)))
    base = here.values(session)
    for twin in twins_for(here, session)[:2]:
        values = twin.values(here, session)
        assert values.shape == base.shape
        assert np.corrcoef(values.ravel(), base.ravel())[0, 1] > 0.95
        assert np.abs(values - base).max() > 0.5
        twice = here.moved(np.array([0, 0, 0, 0, np.log(2.0)]))
        assert twin.values(twice, session) == pytest.approx(2 * values)


def test_layers_for_balls_on_fingers_and_powers_for_the_rest():
    here = Hypothesis(MODEL, np.zeros((6, 3)))
    session = held(6)
    assert all(t.name.startswith("layer") for t in twins_for(here, session))
    box = replace(session, samples=replace(session.samples, indenters=(sphere_mesh(1),)))
    assert all(t.name.startswith("power") for t in twins_for(here, box))
    mesh = BaseModel(
        surface_of(cylinder_mesh(24)), LAYOUT, MODEL.pose, 4e8, 70.0, MODEL.readout, 1.5e-3, 3e-3
    )
    other = Hypothesis(mesh, here.places)
    powers = twins_for(other, session)
    assert all(t.name.startswith("power") for t in powers)
    low, high = (t.values(other, session) for t in powers)
    base = other.values(session)
    # One law is as far on the one side of the fitted one as the other is on the other.
    lengths = np.linalg.norm(high - base) * np.linalg.norm(low - base)
    assert ((high - base) * (low - base)).sum() < -0.8 * lengths


def test_skin_too_soft_for_the_grid_has_a_twin_all_the_same():
    soft = replace(MODEL, elasticity_pa_per_m=2e7)
    session = held(4)
    values = twins_for(Hypothesis(soft, np.zeros((4, 3))), session)[0].values(
        Hypothesis(soft, np.zeros((4, 3))), session
    )
    assert np.isfinite(values).all() and values.max() > 5


def test_a_layer_that_is_alike_presses_as_wide_as_the_foundation():
    def width(press: Press, felt: np.ndarray) -> float:
        square = press.axis_m[:, None] ** 2 + press.axis_m**2
        return float(np.sqrt((felt * square).sum() / felt.sum()))

    for surface, radius in ((FINGER, FINGER.radius_m), (Plane(), np.inf)):
        press = Press(radius, 0.006, 0.25e-3, 5.88e-3)
        wanted = width(press, press.foundation_pa(4e8, 2.0))
        for thickness in THICKNESSES_M:
            found = alike_layer(surface, 0.006, 4e8, 2.0, thickness)
            assert found.thickness_m == thickness
            felt = press.fields(found, np.array([2.0]))[0].felt_pa
            assert width(press, felt) == pytest.approx(wanted, rel=0.012)
        # The thicker a layer is, the softer it may be.
        assert found.elasticity_pa_per_m < 4e8


def test_a_foundation_on_a_grid_is_the_model():
    press = Press(FINGER.radius_m, 0.006, 0.1e-3, 5.6e-3)
    felt = press.foundation_pa(4e8, 2.0)
    one = on(FINGER, ONE, SensorPose(0.0235, 0.0))
    samples = pressing(FINGER, on_finger(0.0, 0.0235)[None], np.array([2.0]))
    loads = one.skin.skin.loads(samples.indenters[0], samples.contacts)
    assert felt.sum() * press.spacing_m**2 == pytest.approx(loads[0, 0], rel=0.01)


def test_a_layer_too_stiff_for_the_grid_is_pressed_as_one_that_is_not_or_refused():
    """It used to be made stiffer still, without end."""
    press = twin_module._press(Plane(), 0.006)
    for elasticity in (1e10, 1e12, 1e16):
        layer = Layer.of_stiffness(elasticity, 0.01, 0.45)
        try:
            table = twin_module._solved(press, layer, 5.0)
        except ContactError:
            continue
        assert np.isfinite(table.felt_pa).all() and table.felt_pa.max() > 0
    with pytest.raises(ContactError, match="could be pressed"):
        twin_module._solved(press, Layer.of_stiffness(1e20, 0.01, 0.45), 5.0)
