"""One or more taxels do not answer or are stuck.

    y_j = a_j x_j + (1 - a_j) v_j    from the moment t_j on

with a_j = 1 for a taxel that works and 0 for a dead one, which reads v_j. Values in between describe a weak response.
x_j is the whole value, including its level at rest.
"""

from __future__ import annotations

import numpy as np

from skincal.effects.effect import SignalEffect, Stage
from skincal.effects.parameter import (
    MOST_COUNTS,
    TYPICAL_TOP_COUNTS,
    Scene,
    Start,
    Values,
    form,
    onset,
    per_taxel,
    start,
)
from skincal.effects.samples import Samples, Setting
from skincal.model import TaxelLayout
from skincal.model.arrays import FloatArray


class DeadTaxel(SignalEffect):
    name = "dead_taxel"
    stage = Stage.CONVERTER
    meaning = "one or more taxels do not answer or are stuck"
    equation_error = 0.1
    zero_error = 0.0
    parameters = (
        per_taxel("answer", "-", 1.0, 0.0, 1.0, "a_j: part of the value that shows", typical=-1.0),
        form(
            "stuck_counts", "counts", 0.0, -MOST_COUNTS, MOST_COUNTS, "v_j: what it reads", shape="per-taxel"
        ),
        onset("from_s", "s", 0.0, 0.0, 1e6, "t_j: when it begins, after the session did", shape="per-taxel"),
    )
    single_taxels = True
    shows = "taxels"
    source = "Stuck-at faults: Isermann, Fault-Diagnosis Systems, 2006."

    def starts(self, scene: Scene) -> tuple[Start, ...]:
        found: list[Start] = []
        for part in np.linspace(0.0, 0.9, 10):
            for j in range(scene.taxels):
                answer, begin = np.ones(scene.taxels), np.zeros(scene.taxels)
                answer[j], begin[j] = 0.0, part * scene.duration_s
                levels = (np.zeros(scene.taxels), scene.top_counts * np.eye(scene.taxels)[j])
                points = [{"answer": answer, "from_s": begin, "stuck_counts": v} for v in levels]
                found.append(start(*points, sigma=0.5, alone=j))
        return tuple(found)

    def needs(self, values: Values) -> tuple[str, ...]:
        """Return the covariates (:meth:`Effect.needs`): the time, if the fault begins later than the session."""
        late = bool(((values["from_s"] > 0) & (values["answer"] != 1.0)).any())
        return ("time",) if late else ()

    @property
    def all_covariates(self) -> tuple[str, ...]:
        """See :attr:`Effect.all_covariates`."""
        return ("time",)

    def at_strength(
        self,
        strength: float,
        rng: np.random.Generator,
        layout: TaxelLayout,
        poses: int = 2,
        *,
        top_counts: float = TYPICAL_TOP_COUNTS,
    ) -> dict[str, FloatArray]:
        """Return a case (:meth:`Effect.at_strength`); at strength 1 a sixteenth of the taxels, or one, is dead."""
        self.check_strength(strength)
        order = np.argsort(np.linalg.norm(layout.centres_m + rng.normal(0, 1e-3, (layout.taxels, 2)), axis=1))
        dead = np.empty(layout.taxels)
        dead[order] = np.clip(strength * max(1, layout.taxels // 16) - np.arange(layout.taxels), 0.0, 1.0)
        return {"answer": 1.0 - dead}

    def apply(self, signal: FloatArray, samples: Samples, values: Values, setting: Setting) -> FloatArray:
        missing = 1.0 - values["answer"]
        since = np.where(samples.elapsed_s[:, None] >= values["from_s"], missing, 0.0)
        return signal + since * (values["stuck_counts"] - signal)
