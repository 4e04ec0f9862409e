"""Data of the search: scores of candidates, selected effects, paths, the result."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from skincal.inference.columns import Candidate
from skincal.inference.constants import CONSTANTS as C
from skincal.inference.fit import Fitted
from skincal.inference.forward import State
from skincal.inference.null import Null
from skincal.inference.score import misfit
from skincal.model.arrays import FloatArray


@dataclass(frozen=True, eq=False)
class CandidateScore:
    """Score of an effect that is not in the model, linearised about a fit.

    Attributes:
        name: of the effect.
        gain: held-out gain of its best start [nats].
        error: standard error of the gain [nats].
        significance: gain in standard errors, blocks clipped (:attr:`skincal.inference.score.Score.significance`).
        null_limit: limit of the null; a gain beyond it is worth a joint fit [nats].
        limit: gain that the joint fit must reach: the null's limit, or what errors of the equations of selected
            effects can explain, if that is more [nats].
        p_value: part of null sessions that gain as much.
        candidate: best start, with its columns.
        coefficients: (n,) multiples of the points of that start.
        clipped_gain: gain with the part of every block bounded [nats].
        moved_base: state with the base parameters that the linear step leads to.
    """

    name: str
    gain: float
    error: float
    significance: float
    null_limit: float
    limit: float
    p_value: float
    candidate: Candidate
    coefficients: FloatArray
    clipped_gain: float
    moved_base: State

    @property
    def passes_null(self) -> bool:
        """True if the effect is worth a joint fit."""
        return self.gain > self.null_limit and self.clipped_gain > 0


@dataclass(frozen=True, eq=False)
class SelectedEffect:
    """An effect that the search has added to the model.

    Attributes:
        name: of the effect.
        equivalents: its equivalence set: effects whose fit predicts as well, itself first.
        gain: held-out gain of its joint fit [nats].
        limit: gain that it had to reach [nats].
        p_value: part of null sessions that reach its gain.
        rivals: names and fits of the equivalents, each in its place.
    """

    name: str
    equivalents: tuple[str, ...]
    gain: float
    limit: float
    p_value: float
    rivals: tuple[tuple[str, Fitted], ...] = ()


@dataclass(frozen=True, eq=False)
class SearchPath:
    """A sequence of selected effects, and the rounds that led to it.

    Attributes:
        fit: with the effects.
        selected: in order of selection.
        rounds: scores of the candidates in each round, best first.
        dropped: names of effects that a later one has made redundant.
        is_finished: True if no further effect gains significantly.
    """

    fit: Fitted
    selected: tuple[SelectedEffect, ...] = ()
    rounds: tuple[tuple[CandidateScore, ...], ...] = ()
    dropped: frozenset[str] = frozenset()
    is_finished: bool = False

    @property
    def names(self) -> frozenset[str]:
        """Names of the selected effects."""
        return frozenset(one.name for one in self.selected)


@dataclass(frozen=True, eq=False)
class SearchResult:
    """Result of the search.

    Attributes:
        base: fit without new effects.
        final: fit with the selected effects.
        selected: in order of selection.
        rounds: scores of the candidates in each round, best first.
        null: null distribution about the base model.
    """

    base: Fitted
    final: Fitted
    selected: tuple[SelectedEffect, ...]
    rounds: tuple[tuple[CandidateScore, ...], ...]
    null: Null

    @property
    def misfit(self) -> FloatArray:
        """(3,) misfit of the final model (:func:`skincal.inference.score.misfit`)."""
        return misfit_of(self.final)

    @property
    def excess(self) -> FloatArray:
        """(3,) misfit beyond 1 of the final model, over the limit from the null sessions."""
        return (self.misfit - 1) / (self.null.misfit_limits() - 1)

    @property
    def is_incomplete(self) -> bool:
        """True if the final model misfits by more than chance."""
        return bool((self.excess > 1).any())

    @property
    def is_doubtful(self) -> bool:
        """True if a misfit beyond chance stays that is too large a part of the base model's to be equation error."""
        before, after = np.maximum(misfit_of(self.base) - 1, C.noise), self.misfit - 1
        return bool(((after > C.equation * before) & (self.excess > 1)).any())


def misfit_of(fit: Fitted) -> FloatArray:
    """(3,) misfit of a fit whose equation errors are at their best values."""
    return misfit(fit.chi()[:, None], fit.blocks.count, fit.blocks.press)[0]


def with_selected(selected: tuple[SelectedEffect, ...], new: SelectedEffect) -> tuple[SelectedEffect, ...]:
    """Append an effect; one that is selected again, for other taxels, adds to its gain."""
    again = next((one for one in selected if one.name == new.name), None)
    if again is None:
        return (*selected, new)
    return tuple(replace(one, gain=one.gain + new.gain) if one is again else one for one in selected)
