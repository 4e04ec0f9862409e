"""Where a residual lies: by phase, force, time, taxel and covariate, as shares of its excess over noise."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from skincal.effects.samples import HOLD, IDLE, LOAD, UNLOAD
from skincal.inference.session import GapSession
from skincal.model import TaxelLayout
from skincal.model.arrays import BoolArray, FloatArray

PHASES = {LOAD: "loading", HOLD: "the hold", UNLOAD: "unloading", IDLE: "rest"}
_CLEAR = 1.6
"""A part of the session is named that has so many times its share of the excess."""


@dataclass(frozen=True)
class Share:
    """A part of the session.

    Attributes:
        name: what it is a part by.
        meaning: in words.
        share: of the excess residual that lies there.
        times: that over the part's share of the values.
    """

    name: str
    meaning: str
    share: float
    times: float


def shares(residual: FloatArray, session: GapSession) -> tuple[Share, ...]:
    """Parts of a session in which more of the excess lies than their size says, strongest first.

    Args:
        residual: (N, J) over the noise, NaN where not read.
        session: whose it is.
    """
    excess = residual**2 - 1
    seen = np.isfinite(excess)
    total = float(np.where(seen, excess, 0.0).sum())
    if total <= 0:
        return ()
    s, own = session.samples, np.flatnonzero(session.observation >= 0)
    first = np.zeros(len(session), dtype=np.int64)
    first[session.observation[own][::-1]] = own[::-1]
    force, on = session.mean_force(), session.press >= 0
    parts: list[tuple[str, str, BoolArray]] = [
        (word, f"{word}", session.phase == phase)
        for phase, word in PHASES.items()
        if (session.phase == phase).any()
    ]
    middle = float(np.median(force[on])) if on.any() else 0.0
    parts += [
        ("force", f"above {middle:.2g} N", on & (force > middle)),
        ("small force", f"below {middle:.2g} N", on & (force <= middle)),
    ]
    time = s.elapsed_s[first]
    if s.time_s is not None and session.has_frames:
        ends = np.quantile(time, [1 / 3, 2 / 3])
        parts += [
            ("begin", "the first third of the session", time < ends[0]),
            ("end", "the last third of the session", time > ends[1]),
        ]
    for name, column in (("speed", s.speed_m_per_s), ("cycle", s.cycle)):
        if column is not None:
            of = column[first]
            cut = float(np.nanmedian(of[on])) if on.any() else 0.0
            words = (
                ("fast presses", "slow presses")
                if name == "speed"
                else ("sites touched before", "first touches")
            )
            parts += [(name, words[0], on & (of > cut)), (f"low {name}", words[1], on & (of <= cut))]
    for name, column in (("pose", s.pose), ("indenter", s.indenter)):
        if column is not None and len(np.unique(column[first][on])) > 1:
            parts += [
                (name, f"{name} number {int(v) + 1}", on & (column[first] == v))
                for v in np.unique(column[first][on])
            ]
    found = []
    for name, words, rows in parts:
        share = float(np.where(seen & rows[:, None], excess, 0.0).sum()) / total
        size = float((seen & rows[:, None]).sum()) / max(float(seen.sum()), 1.0)
        if 0 < size < 1:
            found.append(Share(name, words, share, share / size))
    return tuple(sorted(found, key=lambda x: -x.times))


def where_text(residual: FloatArray, session: GapSession, layout: TaxelLayout) -> str:
    """Where a residual lies, in a sentence."""
    excess = np.where(np.isfinite(residual), residual**2 - 1, 0.0)
    total = float(excess.sum())
    if total <= 0:
        return "what is left is no more than noise"
    clear = [s for s in shares(residual, session) if s.times >= _CLEAR and s.share > 0.25][:2]
    by_taxel = np.sort(excess.sum(axis=0))[::-1]
    few = int(np.searchsorted(np.cumsum(by_taxel) / total, 0.8)) + 1
    if few <= max(2, len(by_taxel) // 6):
        worst = np.argsort(-excess.sum(axis=0))[:few]
        taxels = "on " + ", ".join("taxel_{}_{}".format(*divmod(int(j), layout.cols)) for j in worst)
    else:
        taxels = "on all taxels"
    if not clear:
        return f"the excess residual lies all over the session, {taxels}"
    parts = " and ".join(f"{100 * min(s.share, 1.0):.0f} % in {s.meaning}" for s in clear)
    return f"of the excess residual lie {parts}, {taxels}"
