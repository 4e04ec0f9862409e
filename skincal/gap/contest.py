"""Effects of a round against each other: which of them score, and what full fits of them leave."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from skincal.gap.candidates import Found
from skincal.gap.choice_options import ChoiceOptions
from skincal.gap.models import Material, Model, excess_of, extended, scene_of

PValue = Callable[[str, float], float]
"""The p-value of an effect's score, from its name and the score."""


@dataclass(frozen=True, eq=False)
class Contest:
    """Effects of a round against each other.

    Attributes:
        model: that they are added to.
        material: the session.
        p_value: of a score.
        null_mean: mean square of a null session's residual.
        options: when an effect is named.
        left: excess of the model.
    """

    model: Model
    material: Material
    p_value: PValue
    null_mean: float
    options: ChoiceOptions
    left: float

    def scores(self, one: Found) -> bool:
        """Whether an effect explains more of other presses than any does in null sessions."""
        return one.scored > 0 and self.p_value(one.effect, one.scored) <= self.options.significant

    def near(self, one: Found, found: Sequence[Found]) -> bool:
        """Whether an effect is among the few that score about as high as the best; all of them, best first."""
        few = one.scored >= self.options.contend * found[0].scored and one in found[: self.options.contenders]
        return few and self.scores(found[0])

    def fall(self, model: Model) -> float:
        """By how much a model lowers the excess."""
        return self.left - excess_of(model, self.material, self.null_mean)

    def little(self, fits: Mapping[str, Model]) -> bool:
        """Whether none of these explains a good part of what is left."""
        falls = [self.fall(m) for m in fits.values()]
        return max(falls, default=0.0) < self.options.halfway * self.left

    def fits(self, found: Sequence[Found]) -> dict[str, Model]:
        """Full fits of some, each with what was named before."""
        fitted = self._fitted(found, self.material)
        return {one.effect: model for one, model in zip(found, fitted, strict=True)}

    def scored_in_full(self, found: Sequence[Found]) -> list[Found]:
        """The same, best first; what did not score does so by a full fit to the presses that are learned from.

        The search holds sensor and places to first order. Far from where the sensor belongs, a gain that few presses
        show is found many times too large, and holds for no others. Of what chooses, a good part must be explained.
        """
        own = [one for one in found if not self.scores(one)]
        learned = self._fitted(own, replace(self.material, score=np.zeros_like(self.material.score)))
        before = self._of_score(self.model)
        read = float(self.material.reading.seen[self.material.score].sum())
        least = self.options.halfway * (before - self.null_mean * read)
        falls = {one.effect: before - self._of_score(m) for one, m in zip(own, learned, strict=True)}
        again = [
            replace(f, scored=s) if (s := falls.get(f.effect, 0.0)) >= max(least, 1.0) else f for f in found
        ]
        return sorted(again, key=lambda f: -f.scored)

    def _of_score(self, model: Model) -> float:
        return float((scene_of(model, self.material).part(self.material.score).residual ** 2).sum())

    def _fitted(self, found: Sequence[Found], material: Material) -> list[Model]:
        if len(found) == 1:
            return [extended(self.model, found[0], material)]
        tasks = [(self.model, f, material.alone) for f in found]
        return list(material.options.mapper(_extended, tasks))


def _extended(task: tuple[Model, Found, Material]) -> Model:
    return extended(*task)
