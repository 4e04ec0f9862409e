"""The audit sees what a protocol can show, and says why it cannot show the rest."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from gap.gap_sessions import MODEL, READOUT, full, static

from skincal.effects import EFFECTS
from skincal.gap.audit import (
    AuditOptions,
    EffectAudit,
    audit,
    imitation,
    linearise,
    smallest_strength,
    threshold,
)
from skincal.gap.base import base_columns
from skincal.gap.noise import assumed_floor
from skincal.gap.reasons import facts_of, why_not
from skincal.gap.session import GapSession

FLOOR = assumed_floor(READOUT)


def audited(session: GapSession, *names: str, **options: float) -> dict[str, EffectAudit]:
    chosen = replace(AuditOptions(), **options)
    rng = np.random.default_rng(0)
    return audit(
        linearise(MODEL, session, base_columns(MODEL, session), FLOOR, chosen, rng, names or None), chosen
    )


@pytest.fixture(scope="module")
def of_full() -> dict[str, EffectAudit]:
    return audited(full())


@pytest.fixture(scope="module")
def of_static() -> dict[str, EffectAudit]:
    return audited(static())


def test_full_protocol_hides_nothing(of_full: dict[str, EffectAudit]):
    assert list(of_full) == list(EFFECTS)
    assert [name for name, found in of_full.items() if not found.visible] == []


def test_sets_hold_the_effect_itself_and_are_small(of_full: dict[str, EffectAudit]):
    assert all(found.consistent_with[0] == name for name, found in of_full.items())
    assert np.mean([len(found.consistent_with) for found in of_full.values()]) <= 1.8


@pytest.mark.parametrize(
    "name", ["hysteresis", "creep", "rate", "latency", "first_cycle", "gain_drift", "baseline_drift", "shear"]
)
def test_static_session_cannot_see(name: str, of_static: dict[str, EffectAudit]):
    found = of_static[name]
    assert not found.visible
    assert found.smallest_strength == np.inf
    assert why_not(found, facts_of(static()))


@pytest.mark.parametrize("name", ["crosstalk", "ghosting", "taxel_offset", "dead_taxel", "spread"])
def test_static_session_still_sees_what_is_in_the_images(name: str, of_static: dict[str, EffectAudit]):
    assert of_static[name].visible


def test_reasons_name_what_is_missing(of_static: dict[str, EffectAudit]):
    facts = facts_of(static())
    assert "no frames" in why_not(of_static["creep"], facts)
    assert "reached from above" in why_not(of_static["hysteresis"], facts)
    assert "speed_m_per_s" in why_not(of_static["rate"], facts)
    assert "cycle" in why_not(of_static["first_cycle"], facts)
    assert why_not(of_static["shear"], facts) == "no shear_u_n and shear_v_n recorded"
    assert why_not(of_static["gain_drift"], facts) == "no times of the presses were recorded"


def test_one_speed_takes_rate_away():
    session = full(16)
    assert session.samples.speed_m_per_s is not None
    steady = replace(
        session, samples=replace(session.samples, speed_m_per_s=np.full(len(session.samples), 2e-3))
    )
    both, one = audited(session, "rate")["rate"], audited(steady, "rate")["rate"]
    assert one.distance < 0.3 * both.distance
    assert "equally fast" in why_not(one, facts_of(steady))


def test_raster_order_makes_gains_look_like_drift():
    names = ("gain_drift", "taxel_gain")
    rows, mixed = (audited(full(36, raster=r), *names)["gain_drift"] for r in (True, False))
    assert rows.consistent_with == ("gain_drift", "taxel_gain")
    assert mixed.consistent_with == ("gain_drift",)
    assert mixed.overlaps["taxel_gain"] < 0.8


def test_order_of_presses_does_not_matter_to_what_has_no_memory():
    session = full(16)
    order = np.argsort(
        np.random.default_rng(1).permutation(session.presses)[np.maximum(session.row, 0)], kind="stable"
    )
    still = replace(session.samples, time_s=None)
    other = GapSession(
        still[order], session.row[order], np.arange(len(order)), session.press[order], session.phase[order],
        session.frames[order],
    )  # fmt: skip
    names = ("crosstalk", "spread", "response_curve", "stiffening", "force_bias")
    one, two = audited(replace(session, samples=still), *names), audited(other, *names)
    for name in names:
        assert two[name].distance == pytest.approx(one[name].distance, rel=1e-6)


def test_more_noise_and_looser_positions_hide_more():
    session, names = full(16), ("contact_offset", "saturation", "hysteresis")
    usual, loose = audited(session, *names), audited(session, *names, position_sigma_m=4e-3, shape_sigma=0.1)
    assert all(loose[name].distance < usual[name].distance for name in names)


def test_threshold_is_the_noncentral_chi_square_of_its_power():
    rng = np.random.default_rng(0)
    distance = threshold(3, 0.05, 0.8)
    drawn = (rng.standard_normal((40000, 3)) + np.array([distance, 0.0, 0.0])) ** 2
    assert np.mean(drawn.sum(axis=1) > 7.815) == pytest.approx(0.8, abs=0.01)


def test_smallest_strength():
    assert smallest_strength(10.0, 5.0, 2.0) == pytest.approx(0.2)  # in proportion
    assert smallest_strength(16.0, 4.0, 1.0) == pytest.approx(0.25)  # like the square
    assert smallest_strength(10.0, 9.0, 0.9) == pytest.approx(0.05)  # levels off: begins in proportion
    assert smallest_strength(10.0, 5.0, 20.0) == pytest.approx(2.0)
    assert smallest_strength(0.0, 0.0, 2.0) == np.inf


def test_imitation_is_the_cosine_and_keeps_to_bounds():
    a, b = np.array([[1.0], [0.0]]), np.array([[1.0], [1.0]])
    free = np.array([-10.0]), np.array([10.0])
    assert imitation(a, b, *free) == pytest.approx(np.sqrt(0.5))
    assert imitation(a, a, *free) == pytest.approx(1.0)
    assert imitation(a, a, np.array([0.0]), np.array([0.5])) == pytest.approx(np.sqrt(0.75))
    assert imitation(-a, a, np.array([0.0]), np.array([10.0])) == pytest.approx(0.0)
