"""The presses to make next: they set rivals apart, and words say what is missing."""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from pathlib import Path
from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest
from diagnose.diagnose_data import moving, still
from gap.gap_sessions import MODEL
from gap.made_sessions import OPTIONS, Made, made

from skincal.collect import Mount, Plan, read_plan, write_plan
from skincal.dataset.placement import patch_coordinates
from skincal.diagnose.diagnosis import Diagnosis
from skincal.diagnose.next_presses import PICKED, PLAN_FILE, expected_reading, next_presses, plan_of
from skincal.diagnose.options import DiagnoseOptions
from skincal.diagnose.pool import imagined, pool_plan
from skincal.diagnose.rig import Rig
from skincal.diagnose.rivals import pairs_of
from skincal.diagnose.session import gap_session
from skincal.effects.samples import HOLD
from skincal.gap.audit import EffectAudit, Lost
from skincal.gap.candidates import Bench
from skincal.gap.choice import Choice, Named, Round
from skincal.gap.models import Model
from skincal.gap.reading import Reading
from skincal.gap.refit import refit
from skincal.gap.separate import Contest, contest, pick
from skincal.gap.session import GapSession
from skincal.gap.signatures import Signature

TRUE = {
    "crosstalk": {"leak": 0.06},
    "spread": {"width_m": 0.0012},
    "latency": {"delay_s": 0.06},
}
RIVALS = [("crosstalk", "ghosting"), ("spread", "crosstalk"), ("latency", "creep")]
CHOSEN = 12


def rng() -> np.random.Generator:
    return np.random.default_rng(0)


@cache
def recorded(effect: str) -> Made:
    """The presses of a dataset under an effect."""
    return made({effect: TRUE[effect]}, gap_session(moving()), model=MODEL)


@cache
def explained(effect: str, by: str) -> Model:
    """Presses under an effect, as a model with that or another one explains them."""
    one = recorded(effect)
    coords = Bench(one.start, one.session).starts(by)[0].coords
    x = np.array([0.7 if c.is_strength else 0.0 for c in coords])
    options = replace(OPTIONS, steps=3, settle=0)
    return Model(refit(one.start, one.session, one.reading, options, coords, x), coords)


def on(plan: Plan, effect: str, rival: str) -> tuple[Contest, GapSession, Reading]:
    """Two explanations on further presses."""
    models = explained(effect, effect), explained(effect, rival)
    session = imagined(plan, Rig.of(moving()), moving(), rng())
    reading = expected_reading(session, models[0], recorded(effect).reading, moving())
    apart = models[1].refit.objective - models[0].refit.objective
    assert apart > 0
    return contest((effect, rival), models, apart, session, reading, OPTIONS), session, reading


@cache
def pool() -> Plan:
    """Every other press to choose from: enough here."""
    plan = pool_plan(Rig.of(moving()), rng())
    return replace(plan, presses=plan.presses[::2])


@cache
def contested(effect: str, rival: str) -> Contest:
    return on(pool(), effect, rival)[0]


def some(count: int, chosen: Any) -> np.ndarray:
    picked = np.zeros(count, dtype=bool)
    picked[chosen] = True
    return picked


@pytest.mark.parametrize(("effect", "rival"), RIVALS)
def test_chosen_presses_set_rivals_further_apart_than_random_ones(effect: str, rival: str):
    pair = contested(effect, rival)
    chosen = some(len(pair), pick([pair], CHOSEN))
    assert chosen.sum() == CHOSEN
    drawn = [some(len(pair), rng.choice(len(pair), CHOSEN, replace=False)) for rng in rng().spawn(20)]
    apart = [pair.added(one) for one in drawn]
    assert pair.added(chosen) > max(apart)
    assert pair.added(chosen) - pair.now > 1.25 * (np.mean(apart) - pair.now)
    assert pair.now < pair.added(chosen) < pair.added()


def test_the_distance_is_what_a_fit_finds():
    """The expected distance is to first order; a fit to the chosen presses alone comes to the same."""
    effect, rival = RIVALS[0]
    chosen = sorted(pick([contested(effect, rival)], CHOSEN).tolist())
    pair, session, reading = on(
        replace(pool(), presses=tuple(pool().presses[i] for i in chosen)), effect, rival
    )
    first, second = explained(effect, effect), explained(effect, rival)
    nowhere = np.zeros((session.presses, 3))
    values = first.hypothesis.with_places(nowhere).values(session)
    reading = reading.with_counts(reading.expected(values))
    start = second.hypothesis.with_places(nowhere)
    found = refit(start, session, reading, OPTIONS, second.coords, second.refit.x)
    assert found.objective == pytest.approx(pair.alone(), rel=0.25)
    assert pair.alone() > 9


def test_two_pairs_are_told_apart_together():
    first, other = contested(*RIVALS[0]), contested(*RIVALS[2])

    def both(chosen: np.ndarray) -> float:
        picked = some(len(first), chosen)
        return float(np.log(first.added(picked)) + np.log(other.added(picked)))

    chosen = [pick(pairs, CHOSEN) for pairs in ([first, other], [first], [other])]
    assert both(chosen[0]) >= max(both(chosen[1]), both(chosen[2])) - 1e-3
    assert len({tuple(sorted(one.tolist())) for one in chosen}) > 1


def choice_between(rival: str, part: float) -> Choice:
    """Crosstalk was named, and a rival explains a part of what it does."""
    fits = {name: explained("crosstalk", name) for name in ("crosstalk", rival)}
    alike = ("crosstalk", rival) if part > 0.93 else ("crosstalk",)
    tried = Round((), 1000.0, {"crosstalk": 900.0, rival: 900.0 * part}, fits)
    best = fits["crosstalk"]
    return Choice(best, best, (Named("crosstalk", alike, 0.9, 0.01),), (tried,), (1000.0, 100.0))


def diagnosis_of(
    choice: Choice | None, one: Made, verdict: str, cannot_see: dict[str, EffectAudit], **more: Any
) -> Diagnosis:
    """As much of a diagnosis as the next presses look at."""
    audit = SimpleNamespace(effects=cannot_see, cannot_see=tuple(cannot_see))
    return cast(
        "Diagnosis",
        SimpleNamespace(
            verdict=verdict, choice=choice, material=one.material, session=one.session, audit=audit,
            options=DiagnoseOptions(), **{"signatures": (), **more},
        ),
    )  # fmt: skip


def blind(name: str, *lacking: str) -> EffectAudit:
    return EffectAudit(name, 0.1, 0.5, 4.0, 9.0, Lost(0.0, 0.0), lacking, {}, (name,))


def test_rivals_are_those_alike_and_those_near():
    (alike,) = pairs_of(choice_between("ghosting", 0.97))
    (near,) = pairs_of(choice_between("ghosting", 0.85))
    assert (alike.first, alike.second) == ("crosstalk", "ghosting")
    assert alike.unlike == pytest.approx(0.03) and near.apart == pytest.approx(135.0)
    assert alike.alike and not near.alike
    assert [m.names for m in alike.models] == [("crosstalk",), ("ghosting",)]
    assert pairs_of(choice_between("ghosting", 0.5)) == ()


def test_a_near_rival_that_is_surely_out_is_none():
    choice = choice_between("ghosting", 0.85)
    (tried,) = choice.rounds
    large = replace(tried, falls={name: 10 * fall for name, fall in tried.falls.items()})
    assert pairs_of(replace(choice, rounds=(large,))) == ()


def test_rivals_get_a_plan_that_reads_back(tmp_path: Path):
    found = diagnosis_of(choice_between("ghosting", 0.97), recorded("crosstalk"), "effects", {})
    told = next_presses(found, moving(), rng())
    assert told.plan is not None and PICKED <= len(told.plan) <= PICKED + 2
    write_plan(told.plan, tmp_path / PLAN_FILE)
    mount = Mount(moving().surface(), moving().nominal_pose(), moving().layout())
    assert read_plan(tmp_path / PLAN_FILE, mount) == told.plan
    (gain,) = told.gains
    assert gain.added > 1.15 * gain.now and gain.alone > 0 and 0 < gain.unlike < 1
    assert "crosstalk" in told.words[0] and "ghosting" in told.words[0] and PLAN_FILE in told.words[0]
    again = next_presses(found, moving(), rng())
    assert again.plan == told.plan and again.words == told.words


def test_a_plan_keeps_to_what_the_rig_has_shown():
    data, rig = moving(), Rig.of(moving())
    plan = pool_plan(rig, rng())
    assert {p.pose for p in plan.presses} <= {"A", "B"}
    assert plan.largest_force_n <= data.presses.force_n.max() + 1e-3
    assert max(p.speed_m_per_s for p in plan.presses) <= 2e-3
    places = plan.sites_m()
    low, high = rig.field.bounds_m
    assert (places >= low - 1e-9).all() and (places <= high + 1e-9).all()
    pressed = patch_coordinates(rig.mount.surface, rig.mount.pose, data.presses.position_m)
    assert (low >= pressed.min(axis=0) - 1e-6).all() and (high <= pressed.max(axis=0) + 1e-6).all()
    session = imagined(plan, rig, data, rng())
    assert session.presses == len(plan) and (np.diff(session.samples.time_s) >= 0).all()
    held = session.phase == HOLD
    assert session.frames[held].sum() == pytest.approx(
        rig.frame_rate_hz * sum(p.hold_s for p in plan.presses), rel=0.01
    )


def test_chosen_presses_are_a_session_of_their_own():
    presses = list(pool().presses)
    presses[3] = replace(presses[3], indenter_radius_m=0.004)
    plan = plan_of(Plan("pool", tuple(presses)), [8, 3, 5, 1], Rig.of(moving()))
    assert plan.presses[0].kind == "anchor" and plan.count("anchor") == 2
    # In the order of the pool; the cap is changed once, at the end.
    assert [p.site for p in plan.presses[1:4]] == [presses[i].site for i in (1, 5, 8)]
    assert plan.presses[-1].indenter_radius_m == 0.004 and plan.presses[-2].kind == "anchor"


def test_words_say_what_to_record():
    one = recorded("crosstalk")
    static = replace(one, session=gap_session(still()))
    unseen = {
        "creep": blind("creep", "time", "phase"),
        "shear": blind("shear", "shear"),
        "rate": blind("rate", "time", "speed"),
        "saturation": blind("saturation"),
    }
    told = next_presses(diagnosis_of(None, static, "none", unseen), still(), rng())
    assert told.plan is None
    (creep,) = [w for w in told.words if w.startswith("to see creep")]
    assert "every frame" in creep and "begins and ends" in creep
    assert any("shear" in w and "tangential force" in w for w in told.words)
    assert any("rate" in w and "slowly and fast" in w for w in told.words)
    assert any("saturation" in w and "harder" in w for w in told.words)
    assert "--protocol full" in told.words[-1]


def test_nothing_is_asked_for_where_nothing_is_open():
    choice = choice_between("ghosting", 0.3)
    told = next_presses(diagnosis_of(choice, recorded("crosstalk"), "effects", {}), moving(), rng())
    assert told.words == () and told.plan is None


@pytest.mark.parametrize(
    ("signature", "varied"),
    [("force", "force_n"), ("hold", "hold_s"), ("pose", "pose"), ("neighbours", "site")],
)
def test_what_nobody_knows_is_pressed_one_thing_at_a_time(signature: str, varied: str):
    one = recorded("crosstalk")
    signs = (Signature(signature, "the " + signature, 0.6, 0.005), Signature("speed", "speed", 0.1, 0.5))
    found = diagnosis_of(None, one, "unknown", {}, signatures=signs)
    told = next_presses(found, moving(), rng())
    assert told.plan is not None and PLAN_FILE in told.words[0] and "the " + signature in told.words[0]
    own = [p for p in told.plan.presses if p.kind != "anchor"]
    names = ("force_n", "speed_m_per_s", "hold_s", "pose", "indenter_radius_m", "site")
    differ = {name for name in names if len({getattr(p, name) for p in own}) > 1}
    assert differ - {"site", "speed_m_per_s"} == {varied} - {"site"}
    # Each combination comes again, or sites do.
    assert told.plan.count("repeat") >= len(own) // 4


def test_time_is_shown_by_presses_that_come_back_all_session_long():
    one = recorded("crosstalk")
    found = diagnosis_of(None, one, "unknown", {}, signatures=(Signature("rest drift", "rest", 0.6, 0.005),))
    plan = next_presses(found, moving(), rng()).plan
    assert plan is not None and len({p.site for p in plan.presses[1:-1]}) == 3
    own = [p.site for p in plan.presses[1:-1]]
    assert all(own.count(site) >= 8 and own[-3:].count(site) == 1 for site in set(own))
