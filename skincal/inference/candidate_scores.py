"""Scores of candidates: the held-out gain of each effect that is not in the model, by its slopes.

The same linear algebra runs on null sessions, which gives every gain its limit.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from copy import copy
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np

from skincal.effects.parameter import Scene
from skincal.effects.samples import Samples
from skincal.fitting.tasks import Mapper
from skincal.inference.blocks import Whitened
from skincal.inference.columns import Candidate, candidates, starts_of
from skincal.inference.constants import CONSTANTS as C
from skincal.inference.equation_errors import EquationErrors
from skincal.inference.fit import Fitted, Fitter
from skincal.inference.forward import StatePrediction
from skincal.inference.null import FOUNDATION, Null, add_laws, draw_noise, law_parts, law_residuals
from skincal.inference.score import Score, full_step, gains, misfit, whole
from skincal.inference.search_result import CandidateScore
from skincal.inference.slopes import Slopes
from skincal.model.arrays import FloatArray, IntArray

Linearised = tuple[list[Candidate], Whitened, int]
"""Candidates, the model's columns with theirs behind, and how many of the model's are equation errors."""


@dataclass(eq=False)
class CandidateScorer:
    """Scores candidates in one session.

    Attributes:
        fitter: of the session.
        smooth: its fitter for finite steps (:func:`smooth_fitter`).
        base: fit without new effects, about which null sessions are simulated.
        names: effects that may be missing.
        folds: (B,) fold of each block.
        rng: for null sessions.
        null_sessions: how many are simulated.
        mapper: runs independent fits side by side.
        progress: callback for messages.
    """

    fitter: Fitter
    smooth: Fitter
    base: Fitted
    names: Sequence[str]
    folds: IntArray
    rng: np.random.Generator
    null_sessions: int = C.null_sessions
    mapper: Mapper = map
    progress: Callable[[str], None] = lambda _: None
    _last: tuple[Fitted, Linearised] | None = field(default=None, init=False)

    @cached_property
    def scene(self) -> Scene:
        """Scale of the session."""
        return scene_of(self.fitter, self.base)

    @cached_property
    def null(self) -> Null:
        """Gains and misfits of null sessions, simulated about the base model."""
        self.progress("null sessions")
        base, fitter = self.base, self.smooth
        wait_for_laws = law_residuals(fitter, base, self.mapper)
        found, w, errors = self._linearised(base)
        draws = draw_noise(fitter, base, self.rng, self.null_sessions)
        laws = wait_for_laws()
        others = np.reshape([*laws.values()], (len(laws), *fitter.counts.shape))
        w = replace(w, columns=Slopes.joined([w.columns, Slopes.of(np.moveaxis(others, 0, 2))]))
        linear = fitter.linearised(base.prediction, base.free, w, errors, draws=draws, rng=self.rng)
        names = [FOUNDATION, *laws]
        turn = np.arange(self.null_sessions) % len(names)
        b, n = linear.blocks, len(linear.prior)
        sigma = np.array([x for c in found for x in c.start.sigma])
        parts = law_parts(b, linear.prior, linear.pull, sigma, len(laws))[:, None]
        parts = parts * (turn == 1 + np.arange(len(laws))[:, None])
        drawn, drawn_chi = add_laws(b, parts)
        greatest: dict[str, FloatArray] = {}
        for c, each in zip(found, self._gains(linear, found, drawn, np.zeros(n)), strict=True):
            own = each.sum(axis=0)
            greatest[c.name] = np.maximum(greatest[c.name], own) if c.name in greatest else own
        if fitter is not self.fitter:
            # The misfit of data in steps is computed at points; the null's must be, too. Laws leave little beside it.
            draws = draw_noise(self.fitter, base, self.rng, self.null_sessions)
            w, errors = self.fitter.columns_of(base.prediction, base.free)
            linear = self.fitter.linearised(base.prediction, base.free, w, errors, draws=draws, rng=self.rng)
            drawn, drawn_chi = linear.blocks.drawn, linear.blocks.drawn_chi
        return Null(tuple(names[k] for k in turn), greatest, _null_misfit(linear, drawn, drawn_chi))

    def score_candidates(self, fit: Fitted) -> list[CandidateScore]:
        """Score every effect that is not in the model, at its best start; best first."""
        found, w, shared = self._linearised(fit)
        linear = self.smooth.linearised(fit.prediction, fit.free, w, shared)
        errors = EquationErrors.of(self.smooth, fit, w)
        n = len(linear.prior)
        begin = n + np.cumsum([0, *(len(c.columns) for c in found)])
        alone = full_step(*whole(linear.blocks, np.arange(n)), linear.prior, linear.pull)
        best: dict[str, tuple[Score, int]] = {}
        for k, each in enumerate(self._gains(linear, found, linear.blocks.b[:, :, None], linear.pull)):
            s, name = Score(each[:, 0]), found[k].name
            if name not in best or s.total > best[name][0].total:
                best[name] = s, k
        out: list[CandidateScore] = []
        for name, (s, k) in best.items():
            c = found[k]
            own = np.append(np.arange(n), np.arange(begin[k], begin[k + 1]))
            prior = np.append(linear.prior, 1 / np.array(c.start.sigma) ** 2)
            h, b = whole(linear.blocks, own)
            step = full_step(h, b, prior, np.append(linear.pull, np.zeros(len(c.columns))))
            change = np.zeros(len(w.columns))
            change[own] = step
            change[:n] -= alone
            owed = (
                errors.explainable_gain(linear.blocks, change, float(change[own] @ h @ change[own]))
                if errors
                else 0.0
            )
            limit = self.null.limit(name)
            out.append(
                CandidateScore(
                    name=name,
                    gain=s.total,
                    error=s.error,
                    significance=s.significance,
                    null_limit=limit,
                    limit=max(limit, owed),
                    p_value=self.null.p_value(name, s.total),
                    candidate=c,
                    coefficients=step[n:],
                    clipped_gain=s.clipped,
                    moved_base=self.fitter.moved(linear, step, own),
                )
            )
        return sorted(out, key=lambda t: -t.gain)

    def _linearised(self, fit: Fitted) -> Linearised:
        """Linearise a fit with all candidates; that of the base model serves null sessions and the first round."""
        if self._last is not None and self._last[0] is fit:
            return self._last[1]
        prediction, f = fit.prediction, self.smooth.forward
        slope = f.noise.written(prediction.values + prediction.state.rest)[1]
        alone = {x.effect for x in fit.free if x.index is not None}
        alone &= {
            n for n in prediction.state.effects if any(s.alone is not None for s in starts_of(n, self.scene))
        }
        had: set[tuple[str, int | None]] = {(n, None) for n in prediction.state.effects if n not in alone}
        had |= {(x.effect, x.index) for x in fit.free if x.index is not None}
        found = list(candidates(f, prediction, self.scene, slope, self.names, had))
        w, errors = self.smooth.columns_of(prediction, fit.free)
        weight = np.where(w.seen, self.fitter.priors.weights, 0.0) / np.exp(w.log_sd)
        columns = Slopes.joined([w.columns, *(c.columns.weighted(weight) for c in found)])
        self._last = fit, (found, replace(w, columns=columns), errors)
        return self._last[1]

    def _gains(
        self, linear: Fitted, found: Sequence[Candidate], b: FloatArray, pull: FloatArray
    ) -> list[FloatArray]:
        """Held-out gain (B, S) of each candidate."""
        sigma = [np.array(c.start.sigma) for c in found]
        return gains(linear.blocks, b, linear.prior, pull, sigma, self.folds)


def smooth_fitter(fitter: Fitter) -> Fitter:
    """Return a fitter without the steps of a coarse converter: its slopes hold over finite changes, as a line's do."""
    if not fitter.forward.noise.coarse:
        return fitter
    forward = copy(fitter.forward)
    forward.noise = replace(forward.noise, stairs=forward.noise)
    return Fitter(forward, fitter.counts, fitter.priors)


def _null_misfit(linear: Fitted, drawn: FloatArray, drawn_chi: FloatArray) -> FloatArray:
    """Misfit (S, 3) of the base model in null sessions, its parameters fitted to each."""
    b, n = linear.blocks, len(linear.prior)
    h = b.products.between(np.arange(n), np.arange(n))
    c = np.linalg.solve(h.sum(axis=0) + np.diag(linear.prior), drawn[:, :n].sum(axis=0))
    chi = drawn_chi - 2 * np.einsum("pns,ns->ps", drawn[:, :n], c) + np.einsum("ns,pns->ps", c, h @ c)
    return misfit(chi, b.count, b.press)


def scene_of(fitter: Fitter, base: Fitted) -> Scene:
    """Return the scale of a session, by the fit of the base model."""
    s, prediction = fitter.forward.samples, base.prediction
    on = s.touching
    load = float(np.quantile(prediction.loads[on].max(axis=1), 0.95)) if on.any() else 1.0
    span = float(s.elapsed_s.max(initial=0.0))
    speed = s.speed_m_per_s
    return Scene(
        taxels=prediction.values.shape[1],
        poses=1 if s.pose is None else int(s.pose.max(initial=0)) + 1,
        top_counts=top_counts(prediction, s),
        top_n=max(load, 1e-9),
        force_n=float(np.median(s.contacts.force_n[on])) if on.any() else 1.0,
        duration_s=max(span, 1.0),
        speed_m_per_s=1e-3 if speed is None or not np.isfinite(speed).any() else float(np.nanmedian(speed)),
    )


def top_counts(prediction: StatePrediction, samples: Samples) -> float:
    """Return the 95 % quantile over touching samples of the largest value above rest [counts]."""
    on = samples.touching
    return max(float(np.quantile(prediction.values[on].max(axis=1), 0.95)), 1e-12) if on.any() else 1.0
