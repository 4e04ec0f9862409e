"""Laws of the effects from the transfer to the converter."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from effect_sessions import BASE, LAYOUT, SESSION, SKIN, VALUES, contacts_at, skin_with

from skincal.effects import EFFECTS, EffectSkin, Samples, SignalEffect
from skincal.effects.parameter import Scene
from skincal.errors import InputError
from skincal.model import Plane, Sphere

BALL = Sphere(0.006)
SETTING = BASE.setting


def through(name: str, signal: object, samples: Samples | None = None, **parameters: object) -> np.ndarray:
    """A signal (K, J) through one effect."""
    rows = np.atleast_2d(np.asarray(signal, dtype=float))
    effect = EFFECTS[name]
    assert isinstance(effect, SignalEffect)
    some = samples or Samples.of(contacts_at(np.zeros(len(rows)), 0.0, 1.0), BALL)
    return effect.apply(rows, some, effect.checked(parameters, 16), SETTING)


def only(taxel: int, value: float = 100.0) -> np.ndarray:
    signal = np.zeros((1, 16))
    signal[0, taxel] = value
    return signal


@pytest.mark.parametrize(("taxel", "neighbours"), [(0, [1, 4]), (5, [1, 4, 6, 9]), (7, [3, 6, 11])])
def test_crosstalk_leaks_to_the_next_taxels_only(taxel: int, neighbours: list[int]):
    shown = through("crosstalk", only(taxel), leak=0.1)[0]
    assert sorted(np.flatnonzero(shown)) == sorted([taxel, *neighbours])
    assert shown[taxel] == 100.0
    np.testing.assert_allclose(shown[neighbours], 10.0)


@pytest.mark.parametrize("leak", [3e-3, 1e-2])
def test_shared_crosstalk_is_a_resistive_sheet(leak: float):
    near = skin_with("crosstalk").setting.neighbours
    sheet = np.linalg.solve(np.eye(16) + leak * (np.diag(near.sum(axis=0)) - near), only(6)[0])
    shown = through("crosstalk", only(6), leak=leak, loss=1.0, reach=leak)[0]
    # The Laplacian's largest eigenvalue is below 8.
    np.testing.assert_allclose(shown, sheet, atol=100.0 * (8 * leak) ** 3)
    assert np.abs(through("crosstalk", only(6), leak=leak, loss=1.0)[0] - sheet).max() > 100.0 * 10 * leak**2
    assert shown.sum() == pytest.approx(100.0, rel=1e-12)


def test_crosstalk_leaks_on():
    shown = through("crosstalk", only(5), leak=0.1, reach=0.2)[0].reshape(4, 4)
    assert shown[1, 1] == pytest.approx(100.0 * (1 + 0.1 * 0.2 * 4))
    assert shown[1, 2] == pytest.approx(10.0)
    assert shown[2, 2] == pytest.approx(100.0 * 0.1 * 0.2 * 2)
    assert shown[1, 3] == pytest.approx(100.0 * 0.1 * 0.2)
    assert shown[3, 3] == 0


def test_ghosting_reaches_every_taxel_of_the_array():
    shown = through("ghosting", only(6), row_leak=0.1, column_leak=0.05, array_leak=0.02)[0].reshape(4, 4)
    expected = np.full((4, 4), 2.0)
    expected[1], expected[:, 2] = 10.0, 5.0
    expected[1, 2] = 100.0
    np.testing.assert_allclose(shown, expected)


def test_saturation_is_bounded_monotone_and_linear_at_first():
    x = np.tile(np.linspace(0.0, 1e4, 500)[:, None], (1, 16))
    for sharpness in (1.5, 4.0, 30.0):
        shown = through("saturation", x, inverse_ceiling_per_count=0.01, sharpness=sharpness)[:, 0]
        assert shown.max() <= 100.0 * (1 + 1e-12)
        assert (np.diff(shown) >= -1e-12).all()
        assert shown[-1] == pytest.approx(100.0, rel=0.02)
    faint = through("saturation", only(0, 1e-3), inverse_ceiling_per_count=0.01)[0, 0]
    assert faint == pytest.approx(1e-3, rel=1e-9)
    assert through("saturation", only(0, -5.0), inverse_ceiling_per_count=0.01)[0, 0] == -5.0


def test_sharp_saturation_clips():
    shown = through("saturation", [[50.0] * 8 + [150.0] * 8], inverse_ceiling_per_count=0.01, sharpness=30.0)[
        0
    ]
    np.testing.assert_allclose(shown, [50.0] * 8 + [100.0] * 8, rtol=1e-3)


@pytest.mark.parametrize("recovery", [0.0, 0.5, 1.0])
def test_dead_band_swallows_small_values_and_keeps_their_order(recovery: float):
    x = np.tile(np.linspace(0.0, 50.0, 400)[:, None], (1, 16))
    shown = through("dead_band", x, width_counts=8.0, recovery=recovery)[:, 0]
    assert (np.diff(shown) >= -1e-12).all()
    assert ((shown >= 0) & (shown <= x[:, 0])).all()
    assert shown[x[:, 0] < 1.0].max() < 0.6
    assert shown[-1] == pytest.approx(50.0 - 8.0 * (1 - recovery), abs=1e-6)


@pytest.mark.parametrize("softness", [0.1, 0.5, 1.0])
def test_a_soft_threshold_against_a_sharp_one(softness: float):
    x = np.linspace(0.0, 200.0, 401)[:, None] * np.ones(16)
    soft = through("dead_band", x, width_counts=8.0, softness=softness)[:, 0]
    sharp = through("dead_band", x, width_counts=8.0)[:, 0]
    assert soft[0] == 0.0 and (np.diff(soft) >= 0).all()
    # Of the band itself a soft one keeps no more than half of its width.
    assert 0.0 < soft[16] < 4.0
    # Far beyond it what is missing is a sharp one's b and 0 to 0.31 r b.
    assert 0.0 <= sharp[-1] - soft[-1] <= 0.32 * softness * 8.0
    near = through("dead_band", x, width_counts=8.0, softness=1e-2)[:, 0]
    np.testing.assert_allclose(near, sharp, atol=0.1)


def test_response_curve_of_known_exponents():
    x = np.tile(np.linspace(0.0, 2.0, 9)[:, None], (1, 16))
    parabola = through("response_curve", x, exponent=2.0, knee_n=0.5)
    np.testing.assert_allclose(parabola, x + x**2 / (2 * 0.5), rtol=1e-12)
    straight = through("response_curve", x, exponent=1.0, knee_n=0.5)
    np.testing.assert_allclose(straight, x, rtol=1e-12)
    for exponent in (0.0, 1e-9, -1e-7):
        log = through("response_curve", x, exponent=exponent, knee_n=0.5)
        np.testing.assert_allclose(log, 0.5 * np.log1p(x / 0.5), rtol=1e-6)
    divider = through("response_curve", x, exponent=-1.0, knee_n=0.5)
    np.testing.assert_allclose(divider, x / (1 + x / 0.5), rtol=1e-12)
    slope = through("response_curve", only(0, 1e-9), exponent=0.3)[0, 0] / 1e-9
    assert slope == pytest.approx(1.0, rel=1e-6)


def test_taxel_gain_multiplies():
    gain = np.linspace(0.5, 2.0, 16)
    np.testing.assert_allclose(skin_with("taxel_gain", gain=gain).values(SESSION), VALUES * gain, rtol=1e-12)
    np.testing.assert_allclose(skin_with("taxel_gain", gain=1.5).values(SESSION), VALUES * 1.5, rtol=1e-12)


def test_taxel_offset_adds():
    offset = np.linspace(-3.0, 3.0, 16)
    np.testing.assert_allclose(
        skin_with("taxel_offset", offset_counts=offset).values(SESSION), VALUES + offset
    )


def clocked(time_s: object, **covariates: object) -> Samples:
    time = np.asarray(time_s, dtype=float)
    return Samples.of(contacts_at(np.zeros(len(time)), 1e-3, 2.0), BALL, time_s=time, **covariates)


def test_drifts_count_from_the_beginning_of_the_session():
    late = clocked([1.7e9, 1.7e9 + 100.0])
    gain = skin_with("gain_drift", rate_per_s=1e-3).values(late)
    base = BASE.values(late)
    np.testing.assert_allclose(gain[0], base[0])
    np.testing.assert_allclose(gain[1], base[1] * np.exp(0.1), rtol=1e-6)
    level = skin_with("baseline_drift", slope_counts_per_s=0.05).values(late)
    np.testing.assert_allclose(level - base, [[0.0] * 16, [5.0] * 16], atol=1e-6)


def test_drifts_settle():
    long = clocked([0.0, 50.0, 5000.0])
    gain = skin_with("gain_drift", settling=0.2, settling_time_s=50.0).values(long)
    expected = np.exp(0.2 * (1 - np.exp([0.0, -1.0, -100.0])))
    np.testing.assert_allclose(gain, BASE.values(long) * expected[:, None], rtol=1e-9)
    level = skin_with("baseline_drift", settling_counts=8.0, settling_time_s=50.0).values(long) - BASE.values(
        long
    )
    np.testing.assert_allclose(level[:, 0], 8.0 * (1 - np.exp([0.0, -1.0, -100.0])), atol=1e-9)


def test_drifts_follow_the_temperature():
    warm = clocked([0.0, 1.0, 2.0], temperature_c=[25.0, 27.0, np.nan])
    base = BASE.values(warm)
    gain = skin_with("gain_drift", temperature_per_k=-0.01).values(warm)
    np.testing.assert_allclose(gain, base * np.exp([[0.0], [-0.02], [0.0]]), rtol=1e-12)
    level = skin_with("baseline_drift", temperature_counts_per_k=1.5).values(warm) - base
    np.testing.assert_allclose(level, np.tile([[0.0], [3.0], [0.0]], (1, 16)), atol=1e-12)
    zero = skin_with("baseline_drift", temperature_counts_per_k=1.5, reference_c=26.0).values(warm) - base
    np.testing.assert_allclose(zero, np.tile([[-1.5], [1.5], [-1.5]], (1, 16)), atol=1e-12)


def test_first_cycle_fades_with_touches():
    touches = Samples.of(contacts_at(np.zeros(4), 1e-3, 2.0), BALL, cycle=[0, 1, 2, 50])
    shown = skin_with("first_cycle", amplitude=0.3, cycles=2.0).values(touches).sum(axis=1)
    base = BASE.values(touches).sum(axis=1)
    np.testing.assert_allclose(shown / base, 1 + 0.3 * np.exp(-np.array([0, 1, 2, 50]) / 2), rtol=1e-12)


def test_first_cycle_fades_with_what_its_site_has_met():
    touches = Samples.of(
        contacts_at(np.zeros(5), 1e-3, 2.0),
        BALL,
        cycle=[0, 1, 1, 2, np.nan],
        met_n=[0.0, 0.5, 3.0, np.nan, 1.0],
    )
    given = {"amplitude": 0.3, "cycles": 2.0, "fading_per_n": 0.8}
    shown = skin_with("first_cycle", **given).values(touches).sum(axis=1)
    base = BASE.values(touches).sum(axis=1)
    faded = np.exp([0.0, -0.5 - 0.4, -0.5 - 2.4, -np.inf, -np.inf])
    np.testing.assert_allclose(shown / base, 1 + 0.3 * faded, rtol=1e-12)
    tailed = skin_with("first_cycle", **given, tail=0.5).values(touches).sum(axis=1) / base
    slowly = [1.0, (1 + 0.5 * 0.9) ** -2, (1 + 0.5 * 2.9) ** -2, 0.0, 0.0]
    np.testing.assert_allclose(tailed, 1 + 0.3 * np.array(slowly), rtol=1e-12)
    blind = replace(touches, met_n=None)
    with pytest.raises(InputError, match=r"(?s)first_cycle.*met_n"):
        skin_with("first_cycle", **given).values(blind)
    # Without it, what was met need not be known.
    skin_with("first_cycle", amplitude=0.3).values(blind)


def test_dead_taxels_read_what_they_are_stuck_at():
    answer, stuck = np.ones(16), np.zeros(16)
    answer[5], stuck[5], answer[6] = 0.0, 33.0, 0.0
    skin = skin_with("dead_taxel", answer=answer, stuck_counts=stuck)
    shown = skin.values(SESSION)
    assert (shown[:, 5] == 33.0).all()
    assert (shown[:, 6] == 0.0).all()
    others = np.setdiff1d(np.arange(16), [5, 6])
    assert np.array_equal(shown[:, others], VALUES[:, others])


def test_a_dead_taxel_hides_its_level_at_rest_too():
    answer = np.r_[0.0, np.ones(15)]
    skin = BASE.with_effects({"dead_taxel": {"answer": answer}, "taxel_offset": {"offset_counts": 4.0}})
    assert (skin.values(SESSION)[:, 0] == 0.0).all()


def test_taxels_that_die_half_way_need_a_clock():
    answer = np.r_[0.0, np.ones(15)]
    skin = skin_with("dead_taxel", answer=answer, from_s=np.r_[2.0, np.zeros(15)], stuck_counts=9.0)
    samples = Samples.of(contacts_at(np.zeros(4), 0.0, 1.0), BALL, time_s=[10.0, 11.0, 12.0, 13.0])
    assert skin.effects[0].effect.needs(skin.effects[0].values) == ("time",)
    shown, base = skin.values(samples)[:, 0], BASE.values(samples)[:, 0]
    np.testing.assert_allclose(shown, [base[0], base[1], 9.0, 9.0])


def test_strength_of_dead_taxels_counts_them():
    for strength, dead in ((1.0, 1), (3.0, 3), (100.0, 16)):
        answer = EFFECTS["dead_taxel"].at_strength(strength, np.random.default_rng(0), LAYOUT)["answer"]
        assert (answer == 0).sum() == dead


def test_a_scale_for_each_taxel_acts_after_the_transfer():
    from dataclasses import replace

    from skincal.model import SkinParameters

    scale = np.linspace(50.0, 80.0, 16)
    skin = EffectSkin(replace(SKIN, parameters=SkinParameters(4e8, scale)), BASE.surface)
    np.testing.assert_allclose(skin.values(SESSION), VALUES / 70.0 * scale, rtol=1e-12)
    curved = skin.with_effects({"response_curve": {"exponent": 0.5}}).values(SESSION)
    plain = skin_with("response_curve", exponent=0.5).values(SESSION)
    np.testing.assert_allclose(curved, plain / 70.0 * scale, rtol=1e-12)


def test_a_skin_on_a_plane_has_effects_too():
    from skincal.model import Contacts, Patch, SensorPose, Skin, SkinParameters

    patch = Patch.build(Plane(), LAYOUT, SensorPose(0.0, 0.0), 1e-3)
    flat = EffectSkin(Skin(patch, SkinParameters(4e8, 70.0)), Plane())
    contacts = Contacts(np.zeros((1, 3)), np.array([[0.0, 0.0, 1.0]]), np.array([2.0]))
    samples = Samples.of(
        contacts,
        BALL,
        time_s=0.0,
        phase=1,
        speed_m_per_s=1e-2,
        cycle=0,
        pose=0,
        temperature_c=30.0,
        shear_u_n=0.5,
        shear_v_n=0.0,
    )
    for name, effect in EFFECTS.items():
        given = effect.at_strength(1.0, np.random.default_rng(0), LAYOUT)
        assert np.isfinite(flat.with_effects({name: given}).values(samples)).all()


@pytest.mark.parametrize("unit", [1e-7, 1e-3, 1e4])
@pytest.mark.parametrize("name", ["saturation", "dead_band", "taxel_offset", "baseline_drift", "dead_taxel"])
def test_starts_follow_the_unit_of_values(name: str, unit: float):
    """Volts, teslas, pascals: the same effect is sought, within its bounds."""
    e = EFFECTS[name]
    scene = Scene(3, 1, 100.0, 1.0, 2.0, 60.0)
    other = replace(scene, top_counts=100.0 * unit)
    for counts, values in zip(e.starts(scene), e.starts(other), strict=True):
        for a, b in zip(counts.points, values.points, strict=True):
            for key, value in a.items():
                p = e.parameter(key)
                assert b[key] == pytest.approx(value * unit**p.counts_power)
                assert ((b[key] >= p.low) & (b[key] <= p.high)).all()
    usual = e.at_strength(1.0, np.random.default_rng(0), LAYOUT)
    for key, value in e.at_strength(1.0, np.random.default_rng(0), LAYOUT, top_counts=100.0 * unit).items():
        assert value == pytest.approx(usual[key] * unit ** e.parameter(key).counts_power)
