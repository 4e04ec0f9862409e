"""Laws of the base model, on random presses, poses and layouts."""

from __future__ import annotations

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st
from model_shapes import box_mesh, sphere_mesh
from published import FINGER, LAYOUT, RADIUS_M, presses_on

from skincal.model import (
    Converter,
    FlatPunch,
    Indenter,
    Patch,
    Plane,
    SensorPose,
    Skin,
    SkinParameters,
    Sphere,
    Status,
    Surface,
    TaxelLayout,
)

PLANE = Plane()
COARSE = {"resolution_m": 0.5e-3}
PATCHES = {
    surface: Patch.build(surface, LAYOUT, SensorPose(0.0235, 0.25), **COARSE) for surface in (FINGER, PLANE)
}
INDENTERS: list[Indenter] = [Sphere(0.006), Sphere(0.004), FlatPunch(0.002), sphere_mesh(3), box_mesh()]

law = settings(max_examples=40)
surfaces = st.sampled_from([FINGER, PLANE])
indenters = st.sampled_from(INDENTERS)
# An edge that runs exactly through points takes them or leaves them as rounding will have it: balls have none.
balls = st.sampled_from(INDENTERS[:2])
places = st.tuples(st.floats(-8e-3, 8e-3), st.floats(-8e-3, 8e-3))
forces = st.floats(0.05, 5.0)
elasticities = st.floats(1.5e8, 1e9)


def _skin(patch: Patch, elasticity: float, scale: float | np.ndarray = 1.0) -> Skin:
    return Skin(patch, SkinParameters(elasticity, scale), Converter.none())


@law
@given(surfaces, indenters, places, forces, st.floats(1.0, 3.0), elasticities)
def test_every_taxel_is_monotone_in_force(surface, indenter, place, force, more, elasticity):
    loads = _skin(PATCHES[surface], elasticity).loads(
        indenter, presses_on(surface, *place, [force, more * force])
    )
    assert np.all(loads[1] >= loads[0] * (1 - 1e-12))


@law
@given(surfaces, indenters, places, forces, elasticities, st.floats(0.2, 5.0))
def test_only_the_ratio_of_force_and_elasticity_shapes_the_image(
    surface, indenter, place, force, elasticity, factor
):
    patch = PATCHES[surface]
    once = _skin(patch, elasticity).loads(indenter, presses_on(surface, *place, force))
    again = _skin(patch, factor * elasticity).loads(indenter, presses_on(surface, *place, factor * force))
    np.testing.assert_allclose(again, factor * once, rtol=1e-9, atol=1e-12)


@law
@given(surfaces, indenters, places, forces, elasticities, st.integers(0, 2**32 - 1))
def test_the_order_of_the_points_does_not_matter(surface, indenter, place, force, elasticity, seed):
    patch = PATCHES[surface]
    order = np.random.default_rng(seed).permutation(len(patch))
    shuffled = Patch(
        patch.points_m[order], patch.normals[order], patch.areas_m2[order], patch.taxel[order], LAYOUT
    )
    contacts = presses_on(surface, *place, force)
    np.testing.assert_allclose(
        _skin(shuffled, elasticity).loads(indenter, contacts),
        _skin(patch, elasticity).loads(indenter, contacts),
        rtol=1e-9,
        atol=1e-12,
    )


def _moved_image(
    surface: Surface,
    indenter: Indenter,
    force: float,
    place: tuple[float, float],
    across: float,
    along: float,
) -> np.ndarray:
    """The image of a press; patch and press moved together."""
    pose = SensorPose(0.0235 + along, 0.25, beta_rad=across / RADIUS_M, x_m=across)
    patch = Patch.build(surface, LAYOUT, pose, **COARSE)
    contacts = presses_on(surface, place[0] + across, place[1] + along, force)
    return _skin(patch, 4e8).loads(indenter, contacts)


@law
@given(surfaces, balls, places, forces, st.floats(-8e-3, 8e-3), st.floats(-8e-3, 8e-3))
def test_a_press_moved_with_the_sensor_gives_the_same_image(surface, indenter, place, force, across, along):
    np.testing.assert_allclose(
        _moved_image(surface, indenter, force, place, across, along),
        _moved_image(surface, indenter, force, place, 0.0, 0.0),
        rtol=1e-6,
        atol=1e-9,
    )


@law
@given(st.floats(-3.0, 3.0), places, forces)
def test_on_a_plane_turned_round_presses_give_one_image(turn, place, force):
    def image(alpha: float) -> np.ndarray:
        u, v = place
        across, along = u * np.cos(alpha) - v * np.sin(alpha), u * np.sin(alpha) + v * np.cos(alpha)
        patch = Patch.build(PLANE, LAYOUT, SensorPose(0.0235, alpha), **COARSE)
        return _skin(patch, 4e8).loads(Sphere(0.006), presses_on(PLANE, across, along, force))

    np.testing.assert_allclose(image(turn), image(0.0), rtol=1e-6, atol=1e-9)


@law
@given(surfaces, indenters, places, forces, elasticities)
def test_the_load_of_all_points_is_the_force(surface, indenter, place, force, elasticity):
    contacts = presses_on(surface, *place, force)
    response = _skin(PATCHES[surface], elasticity).respond(indenter, contacts)
    np.testing.assert_allclose(response.force_n, force, rtol=1e-9)
    # A taxel feels no more than its points carry, so all of them together no more than the force.
    assert response.loads_n.sum() <= force * (1 + 1e-9)


@law
@given(places, forces, elasticities)
def test_a_gapless_flat_image_sums_to_the_force(place, force, elasticity):
    without_gaps = TaxelLayout.grid(6, 6, taxel_size_m=4e-3, pitch_m=4e-3)
    patch = Patch.build(PLANE, without_gaps, SensorPose(0.0235, 0.7), resolution_m=0.5e-3, margin_m=0.0)
    image = _skin(patch, elasticity).image(FlatPunch(0.002), presses_on(PLANE, *place, force))
    np.testing.assert_allclose(image.sum(), force, rtol=1e-9)


@law
@given(surfaces, st.sampled_from(INDENTERS[:4]), places, st.floats(0.2, 5.0), elasticities)
def test_load_centroid_is_within_1_mm_of_the_press(surface, indenter, place, force, elasticity):
    contacts = presses_on(surface, *place, force)
    response = _skin(PATCHES[surface], elasticity).respond(indenter, contacts)
    if response.status[0] == Status.OK:
        assert np.linalg.norm(response.centroid_m[0] - contacts.points_m[0]) < 1e-3


@law
@given(places, forces)
def test_mirrored_presses_give_mirrored_images(place, force):
    patch = Patch.build(FINGER, LAYOUT, SensorPose(0.0235, 0.0), **COARSE)
    u, v = place
    loads = _skin(patch, 4e8).loads(Sphere(0.006), presses_on(FINGER, [u, -u, u], [v, v, -v], [force] * 3))
    image, in_u, in_v = loads.reshape(3, 4, 4)
    np.testing.assert_allclose(in_u, image[:, ::-1], rtol=1e-6, atol=1e-9)
    np.testing.assert_allclose(in_v, image[::-1], rtol=1e-6, atol=1e-9)
