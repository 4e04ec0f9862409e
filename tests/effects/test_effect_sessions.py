"""Samples, presses played as samples, histories of sites, the session and the stream."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from effect_sessions import (
    BASE,
    FINGER,
    LAYOUT,
    SESSION,
    SHORT,
    SKIN,
    VALUES,
    contacts_at,
    rms,
    session,
    skin_with,
)

from skincal.covariates import COVARIATES
from skincal.effects import (
    EFFECTS,
    EffectSkin,
    Samples,
    SkinStream,
    Steps,
    Values,
    effect,
    hold_session,
    hold_times,
    met_before,
)
from skincal.effects.samples import HOLD, IDLE, LOAD, UNLOAD
from skincal.errors import InputError
from skincal.model import Contacts, Converter, SkinParameters, Sphere

BALL = Sphere(0.006)


def test_an_unknown_effect_lists_those_that_are():
    with pytest.raises(
        InputError, match=r"(?s)baseline_drift, .*taxel_offset; got .*Did you mean hysteresis"
    ):
        effect("histeresis")
    with pytest.raises(InputError, match="one of"):
        EffectSkin.of(SKIN, FINGER, {"zzz": {}})
    assert effect("creep") is EFFECTS["creep"]


def test_values_of_parameters_are_a_mapping_that_cannot_change():
    values = EFFECTS["creep"].checked({"amplitude": 0.2}, 16)
    assert dict(values)["amplitude"] == 0.2
    assert values.number("time_constant_s") == EFFECTS["creep"].parameter("time_constant_s").neutral
    assert "amplitude" in repr(values)
    assert isinstance(values, Values)
    with pytest.raises(ValueError, match="read-only"):
        values["amplitude"][...] = 1.0


def test_touching_follows_from_phase_or_force():
    contacts = contacts_at(0.0, 0.0, [0.0, 1.0, 0.0, 1.0])
    assert Samples.of(contacts, BALL).touching.tolist() == [False, True, False, True]
    phased = Samples.of(contacts, BALL, phase=[IDLE, LOAD, UNLOAD, -1])
    assert phased.touching.tolist() == [False, True, True, True]
    assert Samples.of(contacts, BALL, touching=False).touching.tolist() == [False] * 4
    assert Samples.of(contacts, BALL).press.tolist() == [-1, 0, -1, 1]


def test_samples_that_make_no_sense_are_refused():
    contacts = contacts_at([0.0, 0.0], 0.0, 1.0)
    for bad in ([1.0, 0.5], [0.0, np.nan]):
        with pytest.raises(ValueError, match="time_s"):
            Samples.of(contacts, BALL, time_s=bad)
    with pytest.raises(ValueError, match="indenter"):
        Samples.of(contacts, ((BALL,), [0, 1]))
    with pytest.raises(ValueError, match="speed_m_per_s"):
        replace(Samples.of(contacts, BALL), speed_m_per_s=np.zeros(3))


def test_samples_of_a_simulation_have_every_covariate():
    """One that it forgets would let its effects abstain, silently."""
    known = {
        name: np.nan if not one.whole else -1
        for one in COVARIATES.values()
        for name in (one.columns if len(one.columns) > 1 else (one.attribute,))
    } | {"time_s": 0.0}
    contacts = contacts_at(0.0, 0.0, [1.0])
    assert all(Samples.of(contacts, BALL, complete=True, **known).has(name) for name in COVARIATES)
    for name in known:
        fewer = {other: value for other, value in known.items() if other != name}
        with pytest.raises(TypeError, match="expected every covariate"):
            Samples.of(contacts, BALL, complete=True, **fewer)


def test_samples_are_read_only_and_can_be_cut():
    some = SESSION[10:20]
    assert len(some) == 10
    assert some.start_s == SESSION.start_s
    assert np.array_equal(some.shear_n, SESSION.shear_n[10:20])
    with pytest.raises(ValueError, match="read-only"):
        some.time_s[0] = 0.0


def test_image_goes_through_the_converter():
    skin = EffectSkin(replace(SKIN, converter=Converter(0.0, 60.0, True)), FINGER)
    image = skin.image(SESSION)
    assert image.max() == 60.0
    assert np.array_equal(image, np.clip(np.rint(VALUES), 0.0, 60.0))


def test_a_contact_serves_other_scales_but_no_other_skin():
    contacted = BASE.contact(SESSION)
    brighter = replace(BASE, skin=replace(SKIN, parameters=SkinParameters(4e8, 140.0)))
    np.testing.assert_allclose(brighter.finish(contacted), 2 * VALUES, rtol=1e-12)
    softer = replace(BASE, skin=replace(SKIN, parameters=SkinParameters(2e8, 70.0)))
    with pytest.raises(ValueError, match="of others"):
        softer.finish(contacted)


def test_all_effects_at_once_stream_as_the_session():
    given = {
        n: e.at_strength(0.7, np.random.default_rng(k), LAYOUT) for k, (n, e) in enumerate(EFFECTS.items())
    }
    skin = BASE.with_effects(given)
    stream = SkinStream(skin)
    steps = np.vstack([stream.step(SHORT[k : k + 1]) for k in range(len(SHORT))])
    np.testing.assert_allclose(steps, skin.values(SHORT), rtol=0, atol=1e-9)
    assert rms(steps - BASE.values(SHORT)) > 1.0
    assert skin.has_memory


@pytest.mark.parametrize("name", ["hysteresis", "creep", "rate", "latency"])
def test_a_stream_remembers_over_a_sample_without_a_place(name: str):
    pressed = np.flatnonzero(SHORT.touching & (SHORT.contacts.force_n > 0.5))
    points = SHORT.contacts.points_m.copy()
    points[pressed[len(pressed) // 2]] = np.nan
    lost = replace(SHORT, contacts=Contacts(points, SHORT.contacts.normals, SHORT.contacts.force_n))
    skin = BASE.with_effects({name: EFFECTS[name].at_strength(1.0, np.random.default_rng(0), LAYOUT)})
    stream = SkinStream(skin)
    steps = np.vstack([stream.step(lost[k : k + 1]) for k in range(len(lost))])
    assert np.isnan(steps).any()
    np.testing.assert_allclose(steps, skin.values(lost), rtol=0, atol=1e-9)


def test_a_stream_does_not_go_back_in_time():
    stream = SkinStream(skin_with("creep"))
    stream.step(SHORT[20:21])
    with pytest.raises(ValueError, match="or later"):
        stream.step(SHORT[10:11])
    stream.reset()
    stream.step(SHORT[10:11])


def test_effects_that_lack_a_covariate_are_an_error_or_abstain():
    bare = Samples.of(SHORT.contacts, (SHORT.indenters, SHORT.indenter), touching=SHORT.touching)
    given = {n: e.at_strength(1.0, np.random.default_rng(0), LAYOUT) for n, e in EFFECTS.items()}
    with pytest.raises(InputError, match="samples without"):
        BASE.with_effects(given).values(bare)
    abstaining = replace(BASE, missing="abstain").with_effects(given)
    rest = {
        n: g
        for n, g in given.items()
        if not EFFECTS[n].covariates and n not in ("gain_drift", "baseline_drift")
    }
    rest["contact_offset"], rest["force_bias"] = {}, {}
    np.testing.assert_allclose(abstaining.values(bare), BASE.with_effects(rest).values(bare), atol=1e-9)


def test_standard_times_where_none_are_known():
    times = hold_times(3)
    np.testing.assert_allclose(times[0], [0.0, 0.5, 1.5, 2.0])
    np.testing.assert_allclose(times[1] - times[0], 3.0)
    given = hold_times(2, [10.0, np.nan], [10.2, np.nan], None, [np.nan, 40.0])
    np.testing.assert_allclose(given[0], [10.0, 10.2, 11.2, 11.7])
    assert given[1, 3] == 40.0
    assert (np.diff(given, axis=1) > 0).all()
    assert (np.diff(hold_times(4, [0.0, 1.0, np.nan, 3.0]).ravel()) >= 0).all()
    # A clock may begin anywhere.
    early = hold_times(3, [-100.0, -50.0, -10.0])
    assert early[:, 0].tolist() == [-100.0, -50.0, -10.0]
    assert hold_times(1)[0, 0] == 0.0


def test_presses_are_played_as_load_hold_and_unload():
    played = session(3, Steps(4, 5, 6))
    samples = played.samples
    assert len(samples) == 3 * 16
    assert samples.phase[:16].tolist() == [LOAD] * 4 + [HOLD] * 5 + [UNLOAD] * 6 + [IDLE]
    force = samples.contacts.force_n[:16]
    assert (np.diff(force[:4]) > 0).all()
    np.testing.assert_allclose(force[3:9], force[3])
    assert (np.diff(force[8:15]) < 0).all()
    assert force[14] == force[15] == 0
    assert (np.diff(samples.time_s) >= 0).all()
    assert not BASE.values(samples)[15].any()


def test_without_memory_the_mean_of_a_hold_is_its_image():
    holds = Samples.of(contacts_at([0.0, 1e-3], 0.0, [1.0, 3.0]), BALL)
    played = hold_session(holds, hold_times(2))
    np.testing.assert_allclose(played.means(BASE.values(played.samples)), BASE.values(holds), rtol=1e-12)


def test_a_hold_reached_from_above_shows_hysteresis():
    holds = Samples.of(contacts_at([0.0, 0.0], 0.0, [2.0, 2.0]), BALL)
    played = hold_session(holds, hold_times(2), down=[False, True])
    up, down = played.means(skin_with("hysteresis").values(played.samples)).sum(axis=1)
    base = BASE.values(holds)[0].sum()
    assert up == pytest.approx(base, rel=1e-9)
    assert down > 1.02 * base


def test_long_holds_creep_more():
    holds = Samples.of(contacts_at([0.0, 0.0], 0.0, [2.0, 2.0]), BALL)
    times = hold_times(2, [0.0, 20.0], [0.5, 20.5], [1.5, 30.5])
    played = hold_session(holds, times)
    short, long = played.means(skin_with("creep").values(played.samples)).sum(axis=1)
    assert long > 1.02 * short


def test_the_largest_force_of_a_site_is_remembered():
    rng = np.random.default_rng(0)
    site, force = rng.integers(0, 4, 40), rng.uniform(0.5, 5.0, 40)
    cycle = np.array([(site[:k] == site[k]).sum() for k in range(40)], dtype=float)
    met = [force[:k][site[:k] == site[k]].max(initial=0.0) for k in range(40)]
    assert np.array_equal(met_before(site, cycle, force), met)


def test_an_unlisted_touch_leaves_each_site_its_history():
    # The fourth touch was cut off; it counts, but is no press.
    met = met_before(np.array([1, 1, 0, 0, 1]), np.array([0.0, 1, 0, 2, 2]), np.array([1.0, 5, 2, 0.5, 1]))
    assert met.tolist() == [0.0, 1.0, 0.0, 2.0, 5.0]


def test_plateaus_remember_the_peak_of_the_touch_before():
    force = np.array([1.0, 2, 5, 3, 1])
    met = met_before(np.zeros(10, dtype=int), np.repeat([0.0, 1.0], 5), np.tile(force, 2))
    assert met.tolist() == [0.0] * 5 + [5.0] * 5


def test_an_unknown_history_is_the_median_of_others():
    site, cycle = np.array([0, 0, 1, 1, 2, 3]), np.array([0.0, 1, 0, 1, 4, np.nan])
    met = met_before(site, cycle, np.array([1.0, 9, 2, 9, 9, 9]))
    assert met[:5].tolist() == [0.0, 1.0, 0.0, 2.0, 1.5]
    assert np.isnan(met[5])


def test_where_no_press_tells_of_an_earlier_one_nothing_is_known():
    met = met_before(np.arange(3), np.array([0.0, 1.0, 2.0]), np.ones(3))
    assert met[0] == 0.0 and np.isnan(met[1:]).all()
    # A force that is not known is none of the site's.
    assert np.isnan(met_before(np.zeros(2, dtype=int), np.array([0.0, 1.0]), np.array([np.nan, 1.0]))[1])
    nothing = np.zeros(0)
    assert met_before(nothing.astype(int), nothing, nothing).shape == (0,)
