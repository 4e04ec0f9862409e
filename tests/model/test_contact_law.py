"""A contact law beside the elastic foundation."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from effects.effect_sessions import BASE, FINGER, contacts_at

from skincal.effects import EffectSkin, Samples
from skincal.model import ContactLaw, Contacts, FlatPunch, Patch, Plane, SensorPose, Skin, Sphere, StressLaw

SKIN = BASE.skin
BALL = Sphere(0.006)
POSE = SensorPose(0.0235, 0.2, 0.05)
CONTACTS = contacts_at(np.array([0.0, 1e-3, -3e-3]), np.array([0.0, 2e-3, -1e-3]), np.array([1.0, 3.0, 2.0]))


def loads(law: ContactLaw | None) -> np.ndarray:
    return replace(SKIN, contact=law).loads(BALL, CONTACTS)


def test_a_neutral_law_is_the_foundation():
    assert (loads(ContactLaw()) == loads(None)).all()


def test_it_is_the_stress_law_and_the_radius_that_it_says():
    assert loads(ContactLaw(exponent=1.3)) == pytest.approx(
        replace(SKIN, law=StressLaw(1.3, 5e-4)).loads(BALL, CONTACTS)
    )
    assert loads(ContactLaw(radius_scale=1.1)) == pytest.approx(SKIN.loads(Sphere(0.0066), CONTACTS))
    assert ContactLaw(radius_scale=1.1).equivalent_indenter(FlatPunch(0.004)).radius_m == 0.004
    both = ContactLaw(exponent=1.25).stress(StressLaw(1.5, 1e-4))
    assert both == StressLaw(1.875, 1e-4)


def test_spreading_and_sharpening_are_opposite():
    wide, sharp, own = (loads(ContactLaw(spread_m2=v)) for v in (2e-8, -2e-8, 0.0))
    assert np.abs(wide - own).max() > 1e-4
    assert wide + sharp == pytest.approx(2 * own)
    peak = np.unravel_index(np.argmax(own), own.shape)
    assert wide[peak] < own[peak] < sharp[peak]


def test_spreading_is_that_of_a_gaussian():
    """Loads over the place of the press are smoothed by the variance, to first order."""
    h, v = 2.5e-4, 2e-8
    fine = Skin(Patch.build(FINGER, SKIN.patch.layout, POSE, 2e-4, 8e-3, "gauss"), SKIN.parameters)
    u, y = np.random.default_rng(0).uniform(-4e-3, 4e-3, (2, 12))

    def at(across: float, along: float) -> np.ndarray:
        return fine.loads(BALL, contacts_at(u + across, y + along, np.full(12, 3.0)))

    laplace = (at(h, 0) + at(-h, 0) + at(0, h) + at(0, -h) - 4 * at(0, 0)) / h**2
    spread = replace(fine, contact=ContactLaw(spread_m2=v)).loads(
        BALL, contacts_at(u, y, np.full(12, 3.0))
    ) - at(0, 0)
    assert np.sqrt(np.mean((spread - v / 2 * laplace) ** 2)) < 0.2 * np.sqrt(np.mean(spread**2))


def test_a_law_adds_to_the_spread_of_a_cover():
    """Both are small: together they change an image by what each changes alone, to first order."""
    samples, covered = Samples.of(CONTACTS, BALL), {"spread": {"width_m": 2e-4}}

    def values(law: ContactLaw | None, effects: dict[str, dict[str, float]]) -> np.ndarray:
        return EffectSkin.of(replace(SKIN, contact=law), FINGER, effects).values(samples)

    own, law = values(None, {}), ContactLaw(spread_m2=1e-8)
    both = values(law, covered) - own
    assert both == pytest.approx(
        values(law, {}) + values(None, covered) - 2 * own, abs=0.05 * np.abs(both).max()
    )


def test_the_exponent_of_a_half_space_presses_in_as_hertz_says():
    """On a plane penetration is (9 F² / (16 E*² R))^(1/3): Johnson, Contact Mechanics, 1985, equation 4.23."""
    flat = Skin(Patch.build(Plane(), SKIN.patch.layout, SensorPose(0.0, 0.0), 1e-4, 6e-3), SKIN.parameters)
    skin = replace(flat, contact=ContactLaw(exponent=0.5, reference_radius_m=0.006))
    depth = {}
    for radius in (0.004, 0.006, 0.009):
        for force in (0.3, 0.6):
            at = Contacts(np.zeros((1, 3)), np.array([[0.0, 0.0, 1.0]]), np.array([force]))
            depth[radius, force] = float(skin.respond(Sphere(radius), at).penetration_m[0])
    one = depth[0.006, 0.3]
    for (radius, force), own in depth.items():
        assert own / one == pytest.approx(((force / 0.3) ** 2 * 0.006 / radius) ** (1 / 3), rel=0.02)


def test_what_is_no_ball_is_as_stiff_as_ever():
    law = ContactLaw(exponent=0.5, reference_radius_m=0.006)
    assert law.stiffness(FlatPunch(0.004)) == 1.0
    assert ContactLaw(exponent=0.5).stiffness(Sphere(0.004)) == 1.0
    assert law.stiffness(Sphere(0.006)) == pytest.approx(1.0)
