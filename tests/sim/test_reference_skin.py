"""The reference skin: the base model, effects beside it, and what it tells of a session."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from calibrations import make_calibration, on_a_plane
from sessions import KINEMATICS, contact, exact, images, ramp, skin

from skincal.calibration import Effect, FittedLaw, stream_of
from skincal.effects import EFFECTS, Samples
from skincal.effects.samples import HOLD, IDLE, LOAD, UNLOAD
from skincal.errors import InputError
from skincal.model import ContactLaw, Sphere
from skincal.robot import bundled_hand
from skincal.sim import ReferenceSkin, Truth
from skincal.sim.reference_skin import PressTracker


def test_without_effects_it_is_the_base_model_rounded() -> None:
    reference = skin()
    for c in ramp():
        values = reference.base_values(c)
        np.testing.assert_array_equal(reference.image(c), np.clip(np.rint(values), 0, 255))


def test_it_may_be_the_skin_of_a_calibration_effects_included() -> None:
    scales = tuple(np.linspace(40.0, 90.0, 16))
    model = replace(make_calibration().model, scale_per_taxel_per_n=scales)
    creeping = make_calibration(model=model, effects=(Effect("creep", {"amplitude": 0.3}),))
    truth = exact(Truth.draw(np.random.default_rng(3), bundled_hand(), effects={"taxel_offset": 1.0}))
    truth = replace(truth, noise_counts=0.0, rest_counts=0.0).with_skin(creeping, bundled_hand())
    assert list(truth.effects) == ["taxel_offset", "creep"]
    assert [e["strength"] for e in truth.effects_list()] == [1.0, None]
    assert truth.skin_dict()["scale_per_taxel_per_n"] == list(scales)
    assert truth.model_dict(plane=False)["scale_per_n"] == pytest.approx(65.0)
    truth = replace(truth, effects={"creep": truth.effects["creep"]})
    reference = ReferenceSkin(KINEMATICS, truth, np.random.default_rng(1))
    stream, tracker = stream_of(creeping), PressTracker(KINEMATICS)
    for c in ramp():
        known = tracker.next(c)
        sample = Samples.of(
            c.contacts(), Sphere(0.006), touching=c.touching, time_s=c.time_s, press=known.press
        )
        expected = np.clip(np.rint(stream.step(sample)), 0, 255)[0]
        np.testing.assert_array_equal(reference.image(c), expected)


def test_it_has_the_contact_law_of_a_calibration() -> None:
    law = ContactLaw(1.4, 1e-8, 1.1)
    truth = exact(Truth.draw(np.random.default_rng(3), bundled_hand()))
    own = truth.with_skin(make_calibration(contact_law=FittedLaw(law)), bundled_hand())
    assert own.contact_law == law and own.skin_dict()["contact_law"]["exponent"] == 1.4
    plain = truth.with_skin(make_calibration(), bundled_hand())
    assert plain.contact_law is None and "contact_law" not in plain.skin_dict()
    seen = [
        np.stack([ReferenceSkin(KINEMATICS, t, np.random.default_rng(1)).base_values(c) for c in ramp()])
        for t in (own, plain)
    ]
    assert np.abs(seen[0] - seen[1]).max() > 0.5


def test_foreign_calibrations_and_doubled_effects_are_refused() -> None:
    truth = Truth.draw(np.random.default_rng(3), bundled_hand(), effects={"creep": 1.0})
    with pytest.raises(InputError, match=r"hand .*, \[surface\] kind"):
        truth.with_skin(on_a_plane(), bundled_hand())
    with pytest.raises(InputError, match="effect creep: expected either drawn or the calibration's"):
        truth.with_skin(make_calibration(effects=(Effect("creep"),)), bundled_hand())


def test_neutral_effects_are_none() -> None:
    neutral = skin(**dict.fromkeys(EFFECTS, 0.0))
    np.testing.assert_array_equal(images(neutral, ramp()), images(skin(), ramp()))


@pytest.mark.parametrize("name", sorted(EFFECTS))
def test_every_effect_can_be_carried_and_shows(name: str) -> None:
    session = [*ramp(), *ramp(4.0), *ramp(8.0, y_m=0.0255)][::2]
    if name in ("baseline_drift", "gain_drift"):
        session = [replace(c, time_s=200 * c.time_s) for c in session]
    if any(parameter.shape == "per-pose" for parameter in EFFECTS[name].parameters):
        # Poses make it visible; the second half is in another one.
        session = [replace(c, q_rad=c.q_rad + 0.2 * (i >= len(session) // 2)) for i, c in enumerate(session)]
    with_effect = images(skin(**{name: 1.0}), session)
    assert np.isfinite(with_effect).all() or name == "dead_taxel"
    difference = np.abs(np.nan_to_num(with_effect) - images(skin(), session))
    assert difference.max() >= 1


def test_hysteresis_makes_unloading_another_curve() -> None:
    session = ramp()
    plain, looped = images(skin(), session).sum(axis=1), images(skin(hysteresis=1.0), session).sum(axis=1)
    up, down = 10 + 10, 50 + 9
    assert plain[up] == pytest.approx(plain[down], abs=20)
    assert abs(looped[down] - looped[up]) > 3 * abs(plain[down] - plain[up])


def test_noise_is_that_of_the_truth() -> None:
    truth = Truth.draw(np.random.default_rng(3), bundled_hand())
    truth = replace(truth, rest_counts=20.0, noise_counts=2.0)
    reference = ReferenceSkin(KINEMATICS, truth, np.random.default_rng(1))
    rest = np.array([reference.image(contact(0.04 * i, -1.0)) for i in range(500)])
    assert rest.mean() == pytest.approx(20.0, abs=0.1)
    assert rest.std() == pytest.approx(2.0, rel=0.05)


def test_presses_sites_and_poses_are_counted() -> None:
    tracker = PressTracker(KINEMATICS)
    session = [*ramp(), *ramp(4.0), *ramp(8.0, y_m=0.0265), *ramp(12.0)]
    session = [replace(c, q_rad=c.q_rad + (0.2 if c.time_s >= 8 else 0.0)) for c in session]
    found = [tracker.next(c) for c in session]
    holds = [found[80 * i + 40] for i in range(4)]
    assert [c.press for c in holds] == [0, 1, 2, 3]
    assert [c.cycle for c in holds] == [0, 1, 0, 2]
    assert [c.met_n for c in holds] == [0.0, 4.0, 0.0, 4.0]
    assert [c.pose for c in holds] == [0, 0, 1, 1]
    assert {c.phase for c in holds} == {HOLD}
    assert found[25].phase == LOAD
    assert found[60].phase == UNLOAD
    assert found[2].phase == IDLE
    assert found[2].press == -1


def test_the_speed_is_that_before_the_touch() -> None:
    tracker = PressTracker(KINEMATICS)
    gaps = [1e-3, 8e-4, 6e-4, 4e-4, 2e-4]
    for i, gap in enumerate(gaps):
        tracker.next(replace(contact(0.04 * i, -1.0), gap_m=gap))
    found = tracker.next(replace(contact(0.2, 0.5), gap_m=-1e-4))
    assert found.speed_m_per_s == pytest.approx(2e-4 / 0.04)


def test_a_contact_lost_for_a_moment_is_the_same_press() -> None:
    tracker = PressTracker(KINEMATICS)
    times = [0.0, 0.04, 0.08, 0.12, 0.16]
    forces = [1.0, 1.0, -1.0, 1.0, 1.0]
    presses = [tracker.next(contact(t, f)).press for t, f in zip(times, forces, strict=True)]
    assert presses == [0, 0, -1, 0, 0]
