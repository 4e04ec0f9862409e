"""Signatures: on what a residual depends, in terms that a sensor engineer thinks in, and where most of it lies.

A signature is a few columns over the observations, made from the fitted values and the covariates: the value in the
unloading, in the hold against time and its logarithm, at rest against session time, and so on. What its columns explain
of the whitened residual, with sensor and places projected out, is compared with what they explain in null sessions.
They describe and never compete in naming.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from skincal.effects.samples import HOLD, IDLE, LOAD, UNLOAD
from skincal.gap.candidates import View
from skincal.gap.problem import Slopes
from skincal.gap.projection import orthonormal
from skincal.inference.session import GapSession
from skincal.model import TaxelLayout
from skincal.model.arrays import BoolArray, FloatArray, IntArray, as_floats

PHASE_WORDS: Mapping[int, str] = {LOAD: "loading", HOLD: "the hold", UNLOAD: "unloading", IDLE: "rest"}


_LEAST_FALL = 20.0
"""Squared units of the noise: less than this is nothing, even where no null session has any."""


@dataclass(frozen=True)
class Signature:
    """What a residual has to do with something.

    Attributes:
        name: of the signature.
        meaning: in a few words.
        share: part of the excess that it explains; at most 1.
        p_value: of explaining as much in a null session, beside what an unknown contact law may leave there.
        times_null: what it explains over the most that it explains in any null session.
        fall: by how much it lowers the squared residual, in squared units of the noise.
    """

    name: str
    meaning: str
    share: float
    p_value: float
    times_null: float = 0.0
    fall: float = 0.0

    @classmethod
    def of(
        cls, name: str, meaning: str, fall: float, excess: float, of_null: FloatArray, unknown: float
    ) -> Signature:
        """What a signature says of a session.

        Null sessions have the contact laws that were simulated. A skin has another, and what that leaves, a few tens of
        squared units, is more than noise does in any of them. Two residuals together are no longer than both lengths:
        as much as an unknown law may leave is granted to every null session on top.

        Args:
            name: of the signature.
            meaning: in a few words.
            fall: by how much it lowers the squared residual.
            excess: squared residual beyond that of the mean null session.
            of_null: (D,) what it explains of null sessions.
            unknown: squared residual that a contact law may leave that is none of the simulated ones.
        """
        granted = (np.sqrt(of_null) + np.sqrt(unknown)) ** 2
        chance = (1 + int((granted >= fall).sum())) / (1 + len(of_null))
        most = max(_LEAST_FALL, float(of_null.max(initial=0.0)))
        return cls(name, meaning, fall / max(excess, fall, 1.0), chance, fall / most, fall)


@dataclass(frozen=True, eq=False)
class Covariates:
    """Covariates of observations (N,), NaN where not known; force [N], times [s]."""

    force_n: FloatArray
    time_s: FloatArray
    since_hold_s: FloatArray
    speed_m_per_s: FloatArray
    cycle: FloatArray
    pose: FloatArray
    temperature_c: FloatArray
    shear_n: FloatArray
    indenter: FloatArray


def covariates_of(session: GapSession) -> Covariates:
    """Mean covariates of the observations."""
    samples = session.samples
    blank = np.full(len(samples), np.nan)

    def column(values: FloatArray | IntArray | None) -> FloatArray:
        given = blank if values is None else values.astype(np.float64)
        return session_mean(session, given)

    elapsed = samples.elapsed_s if samples.time_s is not None else blank
    since = np.zeros(len(samples))
    if samples.phase is not None and samples.time_s is not None:
        held = samples.phase == HOLD
        for row in np.unique(session.row[held & (session.row >= 0)]).tolist():
            own = np.flatnonzero(held & (session.row == row))
            since[own] = samples.time_s[own] - samples.time_s[own[0]]
    shear = blank if samples.shear_n is None else np.hypot(samples.shear_n[:, 0], samples.shear_n[:, 1])
    return Covariates(
        column(np.where(samples.touching, samples.contacts.force_n, 0.0)),
        column(elapsed),
        column(since),
        column(samples.speed_m_per_s),
        column(samples.cycle),
        column(samples.pose),
        column(samples.temperature_c),
        column(shear),
        column(samples.indenter),
    )


def session_mean(session: GapSession, values: FloatArray) -> FloatArray:
    """(N,) means of values (K,) of the samples."""
    seen = session.observation >= 0
    owner = session.observation[seen]
    total = np.bincount(owner, values[seen], len(session))
    return as_floats(total / np.bincount(owner, minlength=len(session)))


def signature_columns(
    slopes: Slopes, session: GapSession, layout: TaxelLayout
) -> dict[str, tuple[str, FloatArray]]:
    """Meaning and columns (N, J, n) [counts] of every signature that the covariates allow."""
    v, phase, cov = slopes.values, session.phase, covariates_of(session)
    keep = np.arange(layout.taxels) if session.taxels is None else session.taxels
    found: dict[str, tuple[str, list[FloatArray]]] = {}

    def add(name: str, meaning: str, *weights: FloatArray) -> None:
        known = [np.nan_to_num(w) for w in weights if np.isfinite(w).any() and np.nanstd(w) > 0]
        if known:
            found[name] = (meaning, [w[:, None] * v if w.ndim == 1 else w for w in known])

    touching = (session.press >= 0).astype(np.float64)
    add("unloading", "the value while unloading", (phase == UNLOAD) * 1.0, (phase == UNLOAD) * cov.force_n)
    held = (phase == HOLD) * 1.0
    add(
        "hold",
        "the value against time in the hold",
        held * cov.since_hold_s,
        held * np.log1p(cov.since_hold_s),
    )
    rest = (session.press < 0).astype(np.float64)
    own = [_one_taxel(v, j, rest * cov.time_s) for j in range(v.shape[1])]
    level = [_one_taxel(v, j, np.ones(len(v))) for j in range(v.shape[1])]
    add("rest level", "the level of each taxel, at rest and under load", *level)
    add("rest drift", "the level at rest against session time", *own)
    add("gain in time", "the value against session time", touching * cov.time_s, touching * cov.time_s**2)
    add("temperature", "the value against temperature", touching * cov.temperature_c)
    add(
        "speed",
        "the value against the speed of loading",
        touching * np.log(np.maximum(cov.speed_m_per_s, 1e-7)),
    )
    add("rate of change", "the value's change in time", _change(v, session, cov.time_s))
    add("earlier touches", "the first touch of a site against later ones", touching * (cov.cycle == 0))
    top = float(np.quantile(v[v > 5], 0.9)) if (v > 5).any() else 1.0
    add("large values", "the top tenth of values", np.maximum(v - top, 0.0))
    add("small values", "the bottom of values", np.minimum(v, 0.15 * top), v * (v < 0.15 * top))
    for name, meaning, mask in _rings(layout, keep):
        add(name, meaning, v @ mask)
    add("taxel gain", "the gain of each taxel", *[_one_taxel(v, j, v[:, j]) for j in range(v.shape[1])])
    add("pose", "the value against the hand's pose", touching * cov.pose)
    add(
        "force",
        "the value against force",
        touching * cov.force_n,
        touching * np.log(np.maximum(cov.force_n, 0.05)),
    )
    add(
        "indenter",
        "the value against the indenter",
        touching * cov.indenter,
        touching * cov.indenter * cov.force_n,
    )
    add("shear", "the value against tangential force", touching * cov.shear_n)
    return {name: (meaning, np.stack(columns, axis=-1)) for name, (meaning, columns) in found.items()}


def _one_taxel(v: FloatArray, taxel: int, weight: FloatArray) -> FloatArray:
    column = np.zeros_like(v)
    column[:, taxel] = weight
    return column


def _change(v: FloatArray, session: GapSession, time_s: FloatArray) -> FloatArray:
    """Change of the values (N, J) in time, within a press [counts/s]."""
    change = np.zeros_like(v)
    if len(v) < 2 or not np.isfinite(time_s).all():
        return change
    same = (np.diff(session.press) == 0) & (session.press[1:] >= 0) & (np.diff(time_s) > 0)
    step = np.diff(v, axis=0) / np.where(same, np.diff(time_s), 1.0)[:, None]
    change[1:] = np.where(same[:, None], step, 0.0)
    return change


def _rings(layout: TaxelLayout, keep: IntArray) -> list[tuple[str, str, FloatArray]]:
    row, col = np.divmod(keep, layout.cols)
    rows, cols = np.abs(row[:, None] - row), np.abs(col[:, None] - col)
    near, diagonal = rows + cols == 1, (rows == 1) & (cols == 1)
    wires = ((rows == 0) | (cols == 0)) & (rows + cols > 1)
    return [
        ("neighbours", "the values of the next taxels", near.astype(np.float64)),
        ("diagonal", "the values of the diagonal taxels", diagonal.astype(np.float64)),
        ("row and column", "the values of further taxels of the row and column", wires.astype(np.float64)),
    ]


def signature_falls(view: View, columns: FloatArray, residuals: FloatArray) -> FloatArray:
    """What columns (N, J, n) explain (D,) of projected residuals (n J, D)."""
    seen = view.seen(columns)
    length = as_floats(np.linalg.norm(seen, axis=0))
    use = length > 1e-9 * max(1e-300, float(length.max(initial=0.0)))
    if not use.any():
        return np.zeros(len(residuals.T))
    along = as_floats(orthonormal(seen[:, use]).T @ residuals)
    return as_floats((along**2).sum(axis=0))


_ALL_TAXELS = "on all taxels"


def where_text(
    residual: FloatArray, seen: BoolArray, session: GapSession, layout: TaxelLayout, rows: BoolArray
) -> str:
    """In a sentence: where most of the excess of the squared residual lies.

    Args:
        residual: (N, J) whitened.
        seen: (N, J) where something was read.
        session: gives phases and forces.
        layout: names taxels.
        rows: (N,) observations that are looked at.
    """
    excess = np.where(seen & rows[:, None], residual**2 - 1.0, 0.0)
    total = float(excess.sum())
    if total <= 0:
        return "no more residual than noise makes"
    of_phase = {phase: float(excess[session.phase == phase].sum()) / total for phase in PHASE_WORDS}
    phase = max(of_phase, key=lambda p: of_phase[p])
    inside = session.phase == phase
    place = "at rest"
    if phase != IDLE:
        words, inside = _of_forces(excess, covariates_of(session).force_n, inside)
        # Without frames all there is are holds.
        place = ("in " + PHASE_WORDS[phase] if session.has_frames else "in holds") + words
    share = float(excess[inside].sum()) / total
    taxels = _taxel_words(excess[inside], layout, session)
    if not session.has_frames and bool(inside[rows].all()) and taxels == _ALL_TAXELS:
        return "the excess residual is spread over presses of all forces and all taxels"
    return f"{100 * min(share, 1.0):.0f} % of the excess residual lies {place}, {taxels}"


def _of_forces(excess: FloatArray, force_n: FloatArray, inside: BoolArray) -> tuple[str, BoolArray]:
    """Forces that hold most of the excess of some observations (N,), in words, and the observations of these forces."""
    total = float(excess[inside].sum())
    if total <= 0 or not np.isfinite(force_n[inside]).all():
        return "", inside
    sides = [(f" above {limit:g} N", force_n > limit) for limit in (4.0, 3.0, 2.0, 1.0, 0.5)]
    sides += [(f" below {limit:g} N", force_n < limit) for limit in (0.5, 1.0, 2.0, 3.0)]
    for words, side in sides:
        some = inside & side
        if some.sum() < 0.6 * inside.sum() and float(excess[some].sum()) > 0.8 * total:
            return words, some
    return "", inside


def _taxel_words(excess: FloatArray, layout: TaxelLayout, session: GapSession) -> str:
    own = excess.sum(axis=0)
    order = np.argsort(-own)
    reached = np.cumsum(own[order]) / max(float(own.sum()), 1e-300)
    few = int(np.searchsorted(reached, 0.8)) + 1
    if few > max(1, len(own) // 5):
        return _ALL_TAXELS
    flat = order[:few] if session.taxels is None else session.taxels[order[:few]]
    names = ", ".join(f"({r}, {c})" for r, c in zip(*np.divmod(np.sort(flat), layout.cols), strict=True))
    return f"on taxel{'s' if few > 1 else ''} {names}"
