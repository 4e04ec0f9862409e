"""Laws of the effects that remember."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from effect_sessions import BASE, SHORT, contacts_at, skin_with
from scipy.signal import lsim

from skincal.effects import Samples, SkinStream, effect
from skincal.effects.parameter import Start
from skincal.effects.recursion import relaxed
from skincal.effects.samples import HOLD, IDLE, LOAD, UNKNOWN, UNLOAD
from skincal.model import Converter, Sphere

BALL = Sphere(0.006)


def course(force_n: object, time_s: object | None = None, **covariates: object) -> Samples:
    """One press at the middle of the patch."""
    force = np.asarray(force_n, dtype=float)
    time = 0.04 * np.arange(len(force)) if time_s is None else time_s
    return Samples.of(contacts_at(0.0, 1e-3, force), BALL, time_s=time, **covariates)


def total(name: str, samples: Samples, **parameters: object) -> np.ndarray:
    return skin_with(name, **parameters).values(samples).sum(axis=1)


UP_AND_DOWN = np.concatenate([np.linspace(0.0, 3.0, 31), np.linspace(2.9, 0.0, 30)])


def test_hysteresis_loads_as_the_base_and_unloads_above_it():
    base, shown = BASE.values(course(UP_AND_DOWN)), skin_with("hysteresis").values(course(UP_AND_DOWN))
    np.testing.assert_allclose(shown[:31], base[:31], atol=1e-12)
    lit = base[35:55] > 0
    assert (shown[35:55][lit] > base[35:55][lit]).all()
    assert not shown[-1].any()


def test_hysteresis_of_an_inner_loop_stays_within_the_outer_one():
    inner = np.concatenate([np.linspace(0, 3, 31), np.linspace(2.9, 1.5, 15), np.linspace(1.6, 3.0, 15)])
    base = total("hysteresis", course(inner), height=0.0)
    shown = total("hysteresis", course(inner), height=0.5)
    outer = total("hysteresis", course(UP_AND_DOWN), height=0.5)
    assert (shown[31:] >= base[31:] - 1e-9).all()
    np.testing.assert_allclose(shown[31:46], outer[31:46], atol=1e-9)
    assert shown[-1] == pytest.approx(base[-1], rel=1e-9)


def test_hysteresis_side_by_side_is_one_after_the_other():
    """Presses with rest between them against a plain loop over time."""
    from skincal.effects.hysteresis import Hysteresis

    loads = BASE.contact(SHORT).loads_n
    values = Hysteresis().checked({"height": 0.7, "width": 2.0}, 16)
    shown, _ = Hysteresis().run(loads, SHORT, values, None)
    widths, z, plain = 2.0 * np.arange(1, 7)[:, None] / 6, np.zeros((6, 16)), []
    for x in loads:
        z = np.clip(z, x, (1 + widths) * x)
        plain.append(x + 0.7 * (z.mean(axis=0) - x))
    np.testing.assert_allclose(shown, plain, atol=1e-14)


def test_creep_reaches_its_limit_as_an_exponential():
    time = np.concatenate([[0.0, 1e-6], np.linspace(0.5, 40.0, 80)])
    held = course(np.r_[0.0, np.full(81, 2.0)], time)
    base = total("creep", held, amplitude=0.0)
    shown = total("creep", held, amplitude=0.3, time_constant_s=2.0)
    np.testing.assert_allclose(shown[1:] / base[1:], 1 + 0.3 * (1 - np.exp(-time[1:] / 2.0)), atol=1e-6)


@pytest.mark.parametrize("begin", effect("creep").search_from)
def test_a_search_for_creep_begins_where_its_numbers_matter(begin: Start):
    """A single exponential does not change to first order with its breadth, and a fit by slopes would stay one."""
    (point,) = begin.points
    sizes = {"time_constant_s": 0.1 * point["time_constant_s"], "breadth": 0.1}
    here = total("creep", course(UP_AND_DOWN), **point)
    for name, size in sizes.items():
        up, down = (
            total("creep", course(UP_AND_DOWN), **{**point, name: point[name] + sign * size})
            for sign in (1, -1)
        )
        assert np.abs(up - down).max() > 2 * np.abs(up + down - 2 * here).max() > 0


def test_creep_does_not_depend_on_how_often_it_is_sampled():
    """A load that goes in straight lines has the same answer on any grid through its corners."""
    coarse = np.array([0.0, 1.0, 3.0, 3.5])
    fine = np.linspace(0.0, 3.5, 71)
    x = np.interp(fine, coarse, [0.0, 2.0, 2.0, 0.0])[:, None]
    for tau in (0.01, 0.7, 50.0):
        q, _ = relaxed(x, fine, np.array([tau]), None)
        few, _ = relaxed(np.array([[0.0], [2.0], [2.0], [0.0]]), coarse, np.array([tau]), None)
        np.testing.assert_allclose(q[[0, 20, 60, 70]], few, atol=1e-12)


def test_broad_creep_goes_with_the_logarithm_of_time():
    time = np.concatenate([[0.0, 1e-6], np.geomspace(0.2, 12.0, 40)])
    held = course(np.r_[0.0, np.full(41, 2.0)], time)
    shown = {b: total("creep", held, amplitude=0.3, time_constant_s=1.5, breadth=b)[2:] for b in (0.0, 2.0)}
    off = {}
    for breadth, values in shown.items():
        line = np.polynomial.Polynomial.fit(np.log(time[2:]), values, 1)
        off[breadth] = np.std(values - line(np.log(time[2:]))) / np.ptp(values)
    assert off[2.0] < 0.04 < off[0.0]


def test_creep_recovers_after_the_press():
    time = np.concatenate([[0.0, 0.1], [5.0, 5.1], np.linspace(5.2, 30.0, 30)])
    shown = total(
        "creep", course(np.r_[0.0, 2.0, 2.0, 0.0, np.zeros(30)], time), time_constant_s=1.0, amplitude=0.3
    )
    assert shown[3] > 0
    assert (np.diff(shown[3:]) < 0).all()
    assert shown[-1] < 1e-6


def test_a_fall_reads_as_at_rest_afterwards_clipped_or_not():
    """What a skin has lost that gives way does not pull at its taxels once the press has gone."""
    falling = skin_with("creep", amplitude=-0.4, time_constant_s=1.0)
    force = np.r_[np.linspace(0, 2, 5), np.full(50, 2.0), np.linspace(2, 0, 5), np.zeros(40)]
    samples = course(force)
    both_ways = replace(falling, skin=replace(falling.skin, converter=Converter.none()))
    free, held = both_ways.values(samples), falling.values(samples)
    assert falling.skin.converter.value_min == 0
    assert (np.diff(free[6:55].sum(axis=1)) < 0).all() and free[54].sum() > 1
    assert np.array_equal(held, free) and not free[60:].any()
    stream = SkinStream(falling)
    one_by_one = np.concatenate([stream.step(samples[k : k + 1]) for k in range(len(force))])
    assert one_by_one == pytest.approx(held, abs=1e-9)


@pytest.mark.parametrize("taus", [[0.7], [0.02, 0.7, 30.0]], ids=["one", "three"])
def test_relaxation_is_the_response_of_its_linear_system(taus: list[float]):
    time, x = 0.04 * np.arange(200), np.random.default_rng(0).uniform(0, 3, (200, 3))
    x[0] = 0.0
    plain = [[lsim(([1.0], [tau, 1.0]), column, time)[1] for column in x.T] for tau in taus]
    q, _ = relaxed(x, time, np.array(taus), None)
    np.testing.assert_allclose(q, np.mean(plain, axis=0).T, atol=1e-12)
    first, state = relaxed(x[:61], time[:61], np.array(taus), None)
    second, _ = relaxed(x[61:], time[61:], np.array(taus), state)
    np.testing.assert_array_equal(np.vstack([first, second]), q)


def test_samples_at_one_moment_are_no_trouble():
    samples = course([0.0, 1.0, 1.5, 2.0, 2.0], [0.0, 0.1, 0.1, 0.1, 0.5])
    for name in ("creep", "latency"):
        assert np.isfinite(skin_with(name).values(samples)).all()


def test_latency_shifts():
    samples = course(UP_AND_DOWN)
    base = BASE.values(samples)
    shown = skin_with("latency", delay_s=0.08).values(samples)
    np.testing.assert_allclose(shown[2:], base[:-2], atol=1e-9)
    half = skin_with("latency", delay_s=0.06).values(samples)
    np.testing.assert_allclose(half[2:], (base[:-2] + base[1:-1]) / 2, atol=1e-9)


def test_latency_assumes_a_constant_load_before_the_session():
    samples = course([2.0, 3.0, 3.0])
    shown, base = total("latency", samples, delay_s=0.06), BASE.values(samples).sum(axis=1)
    np.testing.assert_allclose(shown, [base[0], base[0], (base[0] + base[1]) / 2], rtol=1e-12)


def test_filter_latency_is_a_lag_of_first_order():
    force = np.concatenate([np.linspace(0.5, 3.0, 40), np.full(160, 3.0)])
    samples = course(force)
    base = BASE.values(samples)
    assert samples.time_s is not None
    step = float(samples.time_s[1] - samples.time_s[0])
    late = {
        part: skin_with("latency", delay_s=0.3, filtered=part).values(samples) for part in (0.0, 0.5, 1.0)
    }
    for shown in late.values():
        # What is missing while it rises, over the rise: the mean lag.
        missing = (base - shown).sum(axis=0) * step
        lit = base[-1] - base[0] > 5
        assert missing[lit] / (base[-1] - base[0])[lit] == pytest.approx(np.full(lit.sum(), 0.3), rel=0.02)
    # A filter goes on rising after a pure delay has ended.
    total_of = {part: shown.sum(axis=1) for part, shown in late.items()}
    assert total_of[0.0][60] == pytest.approx(base[-1].sum(), rel=1e-9)
    assert total_of[0.5][60] < total_of[0.0][60] * 0.9999 and total_of[1.0][60] < total_of[0.5][60]


@pytest.mark.parametrize("filtered", [0.0, 0.5, 1.0])
def test_latency_is_the_same_sample_by_sample(filtered: float):
    samples = course(np.r_[0.5, 1.0, 1.5, 2.5, 2.0, 2.0, 0.7], [0.0, 0.1, 0.1, 0.2, 0.3, 0.45, 0.5])
    skin = skin_with("latency", delay_s=0.12, filtered=filtered)
    stream = SkinStream(skin)
    single = np.concatenate([stream.step(samples[k : k + 1]) for k in range(len(samples))])
    if filtered == 1.0:
        np.testing.assert_allclose(single, skin.values(samples), atol=1e-9)
    else:
        # Of two samples at one moment a delay knows the last one in a session, and not yet in a stream.
        np.testing.assert_allclose(single[[0, 1, 3, 5, 6]], skin.values(samples)[[0, 1, 3, 5, 6]], atol=1e-9)


def phases(count: int = 5) -> list[int]:
    return [LOAD] * count + [HOLD] * count + [UNLOAD] * count + [IDLE]


def rated(speed: float, phase: list[int] | int, **parameters: object) -> np.ndarray:
    force = np.r_[np.full(15, 2.0), 0.0]
    samples = course(force, phase=phase, press=np.r_[np.zeros(15, dtype=int), -1], speed_m_per_s=speed)
    base = BASE.values(samples).sum(axis=1)[:15]
    return skin_with("rate", **parameters).values(samples).sum(axis=1)[:15] / base


def test_rate_is_a_power_of_the_speed():
    for speed in (1e-4, 1e-3, 1e-2):
        expected = (1 + speed / 1e-3) ** 0.1
        np.testing.assert_allclose(rated(speed, phases(), exponent=0.1, fade_s=1000.0), expected, rtol=1e-3)
        np.testing.assert_allclose(rated(speed, UNKNOWN, exponent=0.1, fade_s=0.1), expected, rtol=1e-12)


def test_rate_fades_after_loading():
    shown = np.log(rated(1e-2, phases(), exponent=0.1, fade_s=0.2))
    age = np.r_[np.zeros(5), 0.04 * np.arange(1, 11)]
    np.testing.assert_allclose(shown, 0.1 * np.log(11) * np.exp(-age / 0.2), rtol=1e-9)


def test_rate_begins_anew_with_every_press():
    force, phase = np.full(8, 2.0), [LOAD, HOLD, HOLD, HOLD, HOLD, HOLD, HOLD, HOLD]
    samples = course(force, phase=phase, press=[0, 0, 0, 0, 1, 1, 1, 1], speed_m_per_s=1e-2)
    shown = total("rate", samples, exponent=0.1, fade_s=0.1)
    np.testing.assert_allclose(shown[:4], shown[4:], rtol=1e-9)
    assert shown[3] < shown[4]
