"""Locate a residual: shares of its excess over the noise by phase, force, time, taxel and covariate."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from skincal.effects.samples import HOLD, IDLE, LOAD, UNLOAD
from skincal.inference.session import GapSession
from skincal.model.arrays import BoolArray, FloatArray

PHASES = {LOAD: "loading", HOLD: "the hold", UNLOAD: "unloading", IDLE: "rest"}
_MIN_TIMES, _MIN_SHARE = 1.6, 0.25
"""A part of the session is mentioned if it holds this multiple of its proportion, and this share, of the excess."""


@dataclass(frozen=True)
class ResidualShare:
    """Share of the excess residual in one part of the session.

    Attributes:
        name: key of the part, such as ``force``.
        meaning: description of the part.
        share: share of the excess residual that lies in the part.
        times: mean excess of the part over that of what it is a part of: the session, or of all presses.
    """

    name: str
    meaning: str
    share: float
    times: float


def residual_shares(residual: FloatArray, session: GapSession) -> tuple[ResidualShare, ...]:
    """Return the share of the excess residual in each part of a session, highest ``times`` first.

    Args:
        residual: (N, J) residuals over the noise, NaN where nothing was read.
        session: the session they belong to.
    """
    excess = residual**2 - 1
    is_read = np.isfinite(excess)
    total = float(np.where(is_read, excess, 0.0).sum())
    if total <= 0:
        return ()
    by_row, size = np.where(is_read, excess, 0.0).sum(axis=1), is_read.sum(axis=1)
    found: list[ResidualShare] = []
    for name, meaning, rows, whole in _parts(session):
        of_whole = float(by_row[whole].sum())
        if of_whole > 0 and 0 < size[rows].sum() < size[whole].sum():
            part = float(by_row[rows].sum())
            times = part / of_whole * float(size[whole].sum() / size[rows].sum())
            found.append(ResidualShare(name, meaning, part / total, times))
    return tuple(sorted(found, key=lambda x: -x.times))


def _parts(session: GapSession) -> Iterator[tuple[str, str, BoolArray, BoolArray]]:
    """Yield key, description and observations (N,) of each part of a session, and those of which it is a part."""
    samples, observed = session.samples, np.flatnonzero(session.observation >= 0)
    first = np.zeros(len(session), dtype=np.int64)  # first sample of each observation
    first[session.observation[observed][::-1]] = observed[::-1]
    force, is_pressed = session.mean_force(), session.press >= 0
    every = np.ones(len(session), dtype=np.bool_)
    for phase, word in PHASES.items():
        yield word, word, session.phase == phase, every
    median_n = float(np.median(force[is_pressed])) if is_pressed.any() else 0.0
    yield "force", f"presses above {median_n:.2g} N", is_pressed & (force > median_n), is_pressed
    yield "small force", f"presses below {median_n:.2g} N", is_pressed & (force <= median_n), is_pressed
    time = samples.elapsed_s[first]
    if samples.time_s is not None and session.has_frames:
        thirds = np.quantile(time, [1 / 3, 2 / 3])
        yield "begin", "the first third of the session", time < thirds[0], every
        yield "end", "the last third of the session", time > thirds[1], every
    for name, column, high, low in (
        ("speed", samples.speed_m_per_s, "presses faster than {:.3g} m/s", "presses at {:.3g} m/s or less"),
        (
            "cycle",
            samples.cycle,
            "sites touched more than {:g} times before",
            "sites touched at most {:g} times before",
        ),
    ):
        if column is not None:
            values = column[first]
            median = float(np.nanmedian(values[is_pressed])) if is_pressed.any() else 0.0
            yield name, high.format(median), is_pressed & (values > median), is_pressed
            yield f"low {name}", low.format(median), is_pressed & (values <= median), is_pressed
    for name, column in (("pose", samples.pose), ("indenter", samples.indenter)):
        kinds = [] if column is None else np.unique(column[first][is_pressed])
        if column is not None and len(kinds) > 1:
            for kind in kinds:
                yield name, f"{name} number {int(kind) + 1}", is_pressed & (column[first] == kind), is_pressed


def describe_residual(residual: FloatArray, session: GapSession, taxel_names: Sequence[str]) -> str:
    """Return a sentence that says in which parts of the session, and on which taxels, a residual (N, J) lies."""
    excess = np.where(np.isfinite(residual), residual**2 - 1, 0.0)
    total = float(excess.sum())
    if total <= 0:
        return "the residual is no larger than the noise"
    shares = residual_shares(residual, session)
    clear = [s for s in shares if s.times >= _MIN_TIMES and s.share > _MIN_SHARE][:2]
    by_taxel = np.sort(excess.sum(axis=0))[::-1]
    few = int(np.searchsorted(np.cumsum(by_taxel) / total, 0.8)) + 1
    if few <= max(2, len(by_taxel) // 6):
        worst = np.argsort(-excess.sum(axis=0))[:few]
        taxels = "mainly on " + ", ".join(taxel_names[int(j)] for j in worst)
    else:
        taxels = "on all taxels"
    if not clear:
        return f"the excess residual is spread over the whole session, {taxels}"
    shares_in_words = [f"{100 * min(s.share, 1.0):.0f} % in {s.meaning}" for s in clear]
    overlap = " (they overlap)" * (len(clear) > 1)
    return f"share of the excess residual: {' and '.join(shares_in_words)}{overlap}, {taxels}"
