"""Signatures are columns of what they say, explain what is made of them, and a sentence says where it lies."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from gap.gap_sessions import without
from gap.made_sessions import LAYOUT, held, made, pressed

from skincal.effects.samples import HOLD, IDLE, UNLOAD
from skincal.gap.candidates import View
from skincal.gap.problem import Slopes
from skincal.gap.projection import Projection
from skincal.gap.session import GapSession
from skincal.gap.signatures import (
    Signature,
    covariates_of,
    signature_columns,
    signature_falls,
    where_text,
)

ALWAYS = {"rest level", "large values", "small values", "neighbours", "diagonal", "row and column"} | {
    "taxel gain",
    "force",
}
OF_A_CLOCK = {"hold", "rest drift", "gain in time", "rate of change"}
OF_COVARIATES = {"unloading", "temperature", "speed", "earlier touches", "pose", "indenter", "shear"}


@cache
def values() -> np.ndarray:
    """Values (N, 9) of :func:`pressed`."""
    return made().truth.values(pressed())


def columns_of(session: GapSession, of: np.ndarray | None = None) -> dict[str, np.ndarray]:
    v = values() if of is None else of
    none = [np.zeros((*v.shape, n)) for n in (5, 3, 0)]
    found = signature_columns(Slopes(v, np.zeros_like(v), *none), session, LAYOUT)
    assert all(meaning and np.isfinite(columns).all() for meaning, columns in found.values())
    return {name: columns for name, (_, columns) in found.items()}


def test_every_covariate_has_its_signature():
    assert set(columns_of(pressed())) == ALWAYS | OF_A_CLOCK | OF_COVARIATES


@pytest.mark.parametrize(
    ("covariate", "gone"),
    [
        ("speed_m_per_s", {"speed"}),
        ("cycle", {"earlier touches"}),
        ("pose", {"pose"}),
        ("temperature_c", {"temperature"}),
        ("shear_n", {"shear"}),
    ],
)
def test_what_was_not_recorded_has_none(covariate: str, gone: set[str]):
    found = columns_of(without(pressed(), **{covariate: None}))
    assert set(found) == (ALWAYS | OF_A_CLOCK | OF_COVARIATES) - gone


def test_hold_means_have_those_of_values_and_force_only():
    session = held()
    assert set(columns_of(session, made(session=session).truth.values(session))) == ALWAYS


def test_columns_are_where_their_names_say():
    session, found = pressed(), columns_of(pressed())
    for name, inside in (
        ("unloading", session.phase == UNLOAD),
        ("hold", session.phase == HOLD),
        ("rest drift", session.phase == IDLE),
        ("force", session.press >= 0),
        ("gain in time", session.press >= 0),
    ):
        assert not found[name][~inside].any(), name
        assert found[name][inside].any(), name
    assert found["unloading"][..., 0] == pytest.approx((session.phase == UNLOAD)[:, None] * values())
    gain = found["taxel gain"]
    assert gain.sum(axis=-1) == pytest.approx(values())
    assert all(not gain[:, np.arange(9) != j, j].any() for j in range(9))


def test_neighbours_are_those_of_the_layout():
    found, v = columns_of(pressed()), values()
    near, diagonal, wires = (found[n][..., 0] for n in ("neighbours", "diagonal", "row and column"))
    assert near[:, 4] == pytest.approx(v[:, [1, 3, 5, 7]].sum(axis=1))
    assert near[:, 0] == pytest.approx(v[:, [1, 3]].sum(axis=1))
    assert diagonal[:, 4] == pytest.approx(v[:, [0, 2, 6, 8]].sum(axis=1))
    assert wires[:, 0] == pytest.approx(v[:, [2, 6]].sum(axis=1))
    few = np.array([0, 4, 8])
    thinned = columns_of(pressed().of_taxels(few), v[:, few])
    assert "neighbours" not in thinned
    assert thinned["diagonal"][:, 0, 0] == pytest.approx(v[:, 4])


def test_a_change_is_per_second_and_within_a_press():
    session = pressed()
    change, time = columns_of(session)["rate of change"][..., 0], covariates_of(session).time_s
    first = np.flatnonzero(np.diff(session.press, prepend=-2) != 0)
    assert not change[first].any() and not change[session.press < 0].any()
    k = int(np.flatnonzero(session.press == 3)[2])
    assert change[k] == pytest.approx((values()[k] - values()[k - 1]) / (time[k] - time[k - 1]))


def test_time_in_a_hold_begins_with_the_hold():
    session = pressed()
    cov = covariates_of(session)
    assert not cov.since_hold_s[session.phase != HOLD].any()
    for press in range(4):
        own = cov.since_hold_s[(session.press == press) & (session.phase == HOLD)]
        assert own[0] == 0 and (np.diff(own) > 0).all()
    assert not cov.force_n[session.press < 0].any()


def plain_view(shape: tuple[int, int]) -> View:
    """A view that projects nothing out."""
    nothing = Projection((), np.zeros((shape[0] * shape[1], 0)))
    return View(np.ones(shape[0], dtype=bool), np.ones(shape), nothing, np.zeros((shape[0] * shape[1], 1)))


def test_columns_explain_what_is_made_of_them_and_nothing_else():
    found, view = columns_of(pressed()), plain_view(values().shape)
    unloading = found["unloading"]
    made_of = (unloading @ np.array([0.3, -0.1])).reshape(-1, 1)
    total = float((made_of**2).sum())
    assert signature_falls(view, unloading, made_of) == pytest.approx([total])
    elsewhere = np.where(unloading[..., 0] == 0, 1.0, 0.0).reshape(-1, 1)
    assert signature_falls(view, unloading, elsewhere) == pytest.approx([0.0], abs=1e-9)
    assert signature_falls(view, np.zeros_like(unloading), made_of).tolist() == [0.0]


def test_of_noise_columns_explain_one_each():
    view = plain_view(values().shape)
    noise = np.random.default_rng(0).standard_normal((values().size, 400))
    for name in ("unloading", "taxel gain"):
        columns = columns_of(pressed())[name]
        rank = np.linalg.matrix_rank(columns.reshape(-1, columns.shape[-1]))
        falls = signature_falls(view, columns, noise)
        assert falls.mean() == pytest.approx(rank, abs=5 * np.sqrt(2 * rank / 400))


def told(residual: np.ndarray, session: GapSession | None = None, rows: np.ndarray | None = None) -> str:
    session = pressed() if session is None else session
    rows = np.ones(len(session), dtype=bool) if rows is None else rows
    return where_text(residual, np.ones(residual.shape, dtype=bool), session, LAYOUT, rows)


def test_a_sentence_says_phase_force_and_taxels():
    session = pressed()
    force = covariates_of(session).force_n
    residual = np.ones((len(session), 9))
    strong = (session.phase == UNLOAD) & (force > 2.0)
    residual[np.ix_(strong, [4])] = 8.0
    assert told(residual) == "100 % of the excess residual lies in unloading above 2 N, on taxel (1, 1)"
    everywhere = np.ones_like(residual)
    everywhere[session.phase == UNLOAD] = 8.0
    assert told(everywhere) == "100 % of the excess residual lies in unloading, on all taxels"
    rest = np.ones_like(residual)
    rest[session.press < 0, 2] = 5.0
    assert told(rest) == "100 % of the excess residual lies at rest, on taxel (0, 2)"


def test_a_sentence_is_of_the_rows_that_are_looked_at():
    session = pressed()
    residual = np.ones((len(session), 9))
    residual[session.phase == UNLOAD] = 8.0
    assert told(residual, rows=session.phase != UNLOAD) == "no more residual than noise makes"
    assert told(np.ones_like(residual)) == "no more residual than noise makes"


def test_hold_means_lie_in_the_holds_and_taxels_keep_their_names():
    session = held()
    residual = np.full((len(session), 9), 3.0)
    spread = "the excess residual is spread over presses of all forces and all taxels"
    assert told(residual, session) == spread
    residual[:, 1:] = 1.0
    assert told(residual, session) == "100 % of the excess residual lies in holds, on taxel (0, 0)"
    few = replace(pressed(), taxels=np.array([2, 4, 5, 6, 7, 8]))
    strong = np.ones((len(few), 6))
    strong[few.phase == UNLOAD, 0] = 9.0
    assert told(strong, few).endswith("on taxel (0, 2)")


def test_what_an_unknown_law_may_leave_is_no_more_than_chance():
    rng = np.random.default_rng(5)
    unknown, law = 60.0, np.array([60.0**0.5, 0.0, 0.0])
    of_null = (rng.standard_normal((400, 3)) ** 2).sum(axis=1)
    falls = ((law + rng.standard_normal((400, 3))) ** 2).sum(axis=1).tolist()
    granted, plain = (
        np.array([Signature.of("force", "", fall, 500.0, of_null, least).p_value for fall in falls])
        for least in (unknown, 0.0)
    )
    assert (granted <= 0.05).mean() <= 0.05
    assert (plain <= 0.05).mean() > 0.95
    # Four times as long a residual is no law's.
    large = Signature.of("force", "", 4 * unknown, 500.0, of_null, unknown)
    assert large.p_value == pytest.approx(1 / 401)
    assert large.share == pytest.approx(0.48)
    assert large.times_null == pytest.approx(240.0 / max(20.0, of_null.max()))


@pytest.mark.parametrize(("excess", "share"), [(-30.0, 1.0), (0.0, 1.0), (15.0, 1.0), (60.0, 0.5)])
def test_a_share_is_at_most_all(excess: float, share: float):
    assert Signature.of("force", "", 30.0, excess, np.zeros(3), 0.0).share == pytest.approx(share)
