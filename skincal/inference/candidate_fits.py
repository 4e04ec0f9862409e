"""Joint fits of the base model with candidates, and their comparison."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cache
from itertools import islice
from weakref import WeakKeyDictionary

import numpy as np

from skincal.effects import effect
from skincal.fitting.tasks import Mapper
from skincal.inference.columns import FreeParameter, free_parameters, parameters_from_step
from skincal.inference.constants import CONSTANTS as C
from skincal.inference.fit import Fitted, Fitter, law_widths
from skincal.inference.forward import LAW, State
from skincal.inference.score import Score
from skincal.inference.search_result import CandidateScore, SelectedEffect
from skincal.inference.start import FitTask, run_fit
from skincal.model.arrays import FloatArray, IntArray

Parameters = Mapping[str, FloatArray]

_LEAST_PART = 1e-3
"""An effect can do what its slopes promise if it does at least this part of it."""


@dataclass(eq=False)
class CandidateFits:
    """Fits of one session with effects.

    Attributes:
        fitter: of the session.
        smooth: its fitter for finite steps (:func:`skincal.inference.candidate_scores.smooth_fitter`).
        folds: (B,) fold of each block.
        covariates: names of those that the session has.
        known: effects of the calibration, which are never removed.
        mapper: runs independent fits side by side.
    """

    fitter: Fitter
    smooth: Fitter
    folds: IntArray
    covariates: frozenset[str]
    known: frozenset[str] = frozenset()
    mapper: Mapper = map
    _reduced: dict[tuple[Fitted, str], Fitted] = field(default_factory=dict, init=False)
    _scores: WeakKeyDictionary[Fitted, FloatArray] = field(default_factory=WeakKeyDictionary, init=False)

    # ------------------------------------------------------------------ comparison

    def score(self, fit: Fitted) -> FloatArray:
        """Return the held-out log-likelihood (B,) of each block; cached."""
        if fit not in self._scores:
            self._scores[fit] = fit.held_out_scores(self.folds)
        return self._scores[fit]

    def gain(self, new: Fitted, old: Fitted) -> Score:
        """Return the score of a fit less that of another."""
        return Score(self.score(new) - self.score(old))

    def shortlist(self, fit: Fitted, scores: Sequence[CandidateScore]) -> list[tuple[SelectedEffect, Fitted]]:
        """Fit the most promising candidates jointly, and return the best with its equivalents.

        Candidates near the best after a few steps are run_fit to convergence before they are compared: the base has
        absorbed part of the missing effect, and may have far to come back.
        """
        start_values = cache(lambda t: self.start_values(fit, t))
        order = sorted(scores, key=lambda t: -t.clipped_gain)
        gain = next((t.gain for t in sorted(scores, key=lambda t: -t.gain) if start_values(t)), 0.0)
        clipped = next((t.clipped_gain for t in order if start_values(t)), 0.0)
        able = (
            (t, values)
            for t in order
            if t.clipped_gain > C.contend * clipped or t.gain > C.contend * gain
            if (values := start_values(t))
        )
        tried = list(islice(able, C.contenders))
        fits: list[tuple[CandidateScore, Fitted]] = []
        for (t, _), new in zip(tried, self.fit_jointly(fit, tried), strict=True):
            joint = self.gain(new, fit)
            # Evidence is a little from many presses, or much from some: a few presses alone are none.
            significant = max(t.significance, joint.significance) > C.sure or joint.without_best > t.limit
            if joint.total > t.limit and significant:
                fits.append((t, new))
        near = self._equivalent(fit, fits)
        ends = self.fit_to_end([(x.state, x.free) for _, x in near])
        gains = {t: (x, self.gain(x, fit).total) for (t, _), x in zip(near, ends, strict=True)}
        fits = self._equivalent(fit, [(t, x) for t, (x, total) in gains.items() if total > t.limit])
        out = list[tuple[SelectedEffect, Fitted]]()
        for t, x in fits:
            others = [(u.name, y) for u, y in fits if u is not t]
            names = (t.name, *(name for name, _ in others))
            out.append((SelectedEffect(t.name, names, gains[t][1], t.limit, t.p_value, tuple(others)), x))
        return out

    def _equivalent(
        self, fit: Fitted, fits: Sequence[tuple[CandidateScore, Fitted]]
    ) -> list[tuple[CandidateScore, Fitted]]:
        """Keep the fit with the best score and those not significantly worse, best first."""
        before, scores = self.score(fit), [self.score(x) for _, x in fits]
        best = max(scores, key=np.sum, default=before)
        near: list[tuple[float, int]] = []
        for i, ((t, _), own) in enumerate(zip(fits, scores, strict=True)):
            behind = Score(best - own)
            if own is best or is_equivalent(behind, t.name, Score(own - before).total):
                near.append((behind.total, i))
        return [fits[i] for _, i in sorted(near)]

    # ------------------------------------------------------------------ fits

    def fit_jointly(self, fit: Fitted, tried: Sequence[tuple[CandidateScore, Parameters]]) -> list[Fitted]:
        """Fit the model with one more effect each, a few steps from its start values."""
        return list(self.mapper(run_fit, [self._joint_task(fit, t, values) for t, values in tried]))

    def fit_to_end(self, begin: Sequence[tuple[State, tuple[FreeParameter, ...]]]) -> list[Fitted]:
        """Fit from states, with their free parameters, to convergence."""
        tasks = [FitTask(self.fitter, (state,), free, to_end=True) for state, free in begin]
        return list(self.mapper(run_fit, tasks))

    def without(self, fit: Fitted, names: Sequence[str], *, few_steps: bool = False) -> list[Fitted]:
        """Refit without each of some effects: to convergence (cached), or a few steps."""
        new = names if few_steps else [n for n in names if (fit, n) not in self._reduced]
        begin = list[tuple[State, tuple[FreeParameter, ...]]]()
        for name in new:
            effects = {n: v for n, v in fit.state.effects.items() if n != name or n in self.known}
            free = tuple(f for f in fit.free if f.effect != name)
            begin.append((replace(fit.state, effects=effects), free))
        if few_steps:
            tasks = [FitTask(self.fitter, (state,), free, C.few_steps) for state, free in begin]
            return list(self.mapper(run_fit, tasks))
        self._reduced.update({(fit, n): x for n, x in zip(new, self.fit_to_end(begin), strict=True)})
        return [self._reduced[fit, n] for n in names]

    def restarted(self, fit: Fitted) -> Fitted:
        """Refit from the prior pose if the base has left it, and return the better of both fits.

        A base that has absorbed a missing effect can stop at another pose with all presses moved, or at far too stiff
        a skin under an implausible contact law; there the fit also restarts from softer skins.
        """
        start, begin = self.fitter.priors.start, list[float]()
        sd = np.sqrt(np.diag(fit.covariance)[:4])
        if (np.abs(self.fitter.base_offset(fit.state)[:4]) >= C.alike * sd).any():
            begin.append(start.log_e)
        if _has_implausible_law(fit.state):
            begin += [fit.state.log_e - much for much in C.softer]
        anew = replace(fit.state, pose=start.pose, law=np.zeros(len(LAW)), move=start.move)
        ends = self.fit_to_end([(replace(anew, log_e=x), fit.free) for x in begin])
        return min([fit, *ends], key=Fitted.loss)

    def _joint_task(self, fit: Fitted, scored: CandidateScore, values: Parameters) -> FitTask:
        """Make the task of a joint fit; it begins at the best of several states of the base."""
        more = free_parameters(scored.name, values, scored.candidate.start, self.covariates)
        had = {(f.effect, f.parameter.name, f.index) for f in fit.free}
        free = (*fit.free, *(f for f in more if (f.effect, f.parameter.name, f.index) not in had))
        values = self._from_onset(fit, scored, values)
        at = [replace(x, effects={**x.effects, scored.name: values}) for x in (fit.state, scored.moved_base)]
        # Presses may have followed what shifts contacts: they then begin where they were before.
        back = self.fitter.forward.contact_shifts(fit.state) - self.fitter.forward.contact_shifts(at[0])
        if back.any():
            at.append(replace(at[0], move=fit.state.move + np.pad(back, ((0, 0), (0, 1)))))
        if _has_implausible_law(fit.state):
            # The missing effect has bent the law as far as it goes, and the elasticity with it.
            ways = (0.0, *(side * much for much in C.softer for side in (1, -1)))
            at += [replace(at[0], law=np.zeros(len(LAW)), log_e=at[0].log_e + way) for way in ways]
        return FitTask(self.fitter, tuple(at), free, C.joint_steps)

    def _from_onset(self, fit: Fitted, scored: CandidateScore, values: Parameters) -> Parameters:
        """Set the onset of an effect that begins within the session: the changepoint with the least loss."""
        name, alone, f = scored.name, scored.candidate.start.alone, self.fitter.forward
        onset = next((p.name for p in effect(name).parameters if p.role == "onset"), "")
        if onset not in values:
            return values

        def since(moment_s: float) -> dict[str, FloatArray]:
            at = np.array(values[onset])
            at[... if alone is None else alone] = moment_s
            return {**values, onset: at}

        ever = replace(fit.state, effects={**fit.state.effects, name: since(0.0)})
        more = (self.fitter.profile_presses(ever).loss - self.fitter.profile_presses(fit.state).loss)[:-1]
        begin = np.full(len(more), np.inf)
        np.minimum.at(begin, f.row[f.row >= 0], f.samples.elapsed_s[f.row >= 0])
        order = np.argsort(begin)[: int(np.isfinite(begin).sum())]
        first = int(np.argmin(np.cumsum(more[order][::-1])[::-1]))
        return since(float(begin[order[first]]) if first else 0.0)

    def start_values(self, fit: Fitted, scored: CandidateScore) -> Parameters | None:
        """Scale a candidate's linear step until its equation does what the slopes promise.

        Returns:
            Parameters; None where bounds keep the effect from doing any of it, as where the opposite is missing.
        """
        f, c, before = self.smooth.forward, scored.candidate, fit.state.effects.get(scored.name)
        wanted = c.columns.times(scored.coefficients)
        _, slope = f.noise.written(fit.prediction.values + fit.state.rest)
        best: tuple[float, Parameters | None] = (1 - _LEAST_PART) * float((wanted**2).sum()), None
        for scale in C.scales:
            values = parameters_from_step(scored.name, c.start, scale * scored.coefficients, before)
            changed = f.with_effects(fit.prediction, {**fit.state.effects, scored.name: values})
            off = float(((f.mean @ ((changed - fit.prediction.values) * slope) - wanted) ** 2).sum())
            if off < best[0]:
                best = off, values
        return best[1]


def is_equivalent(behind: Score, name: str, gain: float) -> bool:
    """Return whether an effect is not significantly behind the best, or only by what its equation error can cost.

    Args:
        behind: score of the best less its own.
        name: of the effect.
        gain: of the effect [nats].
    """
    return behind.total < max(C.alike * max(behind.error, 1.0), equation_loss(name, gain))


def equation_loss(name: str, gain: float) -> float:
    """Return what an effect with such a gain can lose by the error of its equation [nats]."""
    return 0.5 * effect(name).equation_error ** 2 * gain


def _has_implausible_law(state: State) -> bool:
    """Return whether the contact law is none of an elastic layer."""
    return bool((np.abs(state.law) > C.like_none * law_widths()).any())
