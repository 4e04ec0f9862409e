"""One or more taxels do not answer or are stuck.

    y_j = a_j x_j + (1 - a_j) v_j    from the moment t_j on

with a_j = 1 for a taxel that works and 0 for a dead one, which reads v_j. Values in between describe a weak response.
x_j is the whole value, including its level at rest.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from skincal.effects.effect import SignalEffect, Stage
from skincal.effects.parameter import EffectParameter, Values
from skincal.effects.samples import Samples
from skincal.effects.setting import Setting
from skincal.effects.starts import Scene, Start, start
from skincal.errors import InputError, Problem
from skincal.model import TaxelLayout
from skincal.model.arrays import FloatArray


class DeadTaxel(SignalEffect):
    """The effect ``dead_taxel``, with the equation of the module."""

    name = "dead_taxel"
    stage = Stage.CONVERTER
    meaning = "one or more taxels do not answer or are stuck"
    equation_error = 0.0
    zero_error = 0.0
    parameters = (
        EffectParameter(
            "answer", "-", 1.0, 0.0, 1.0, "a_j: part of the value that shows", typical=-1.0, shape="per-taxel"
        ),
        EffectParameter(
            "stuck_counts",
            "counts",
            0.0,
            -100.0,
            4096.0,
            "v_j: what it reads",
            shape="per-taxel",
            role="form",
        ),
        EffectParameter(
            "from_s",
            "s",
            0.0,
            0.0,
            1e6,
            "t_j: when it begins, after the session did",
            shape="per-taxel",
            role="form",
        ),
    )
    single_taxels = True
    shows = "taxels"
    source = "Stuck-at faults: Isermann, Fault-Diagnosis Systems, 2006."

    def starts(self, scene: Scene) -> tuple[Start, ...]:
        """See :meth:`Effect.starts`."""
        found: list[Start] = []
        for part in (0.0, 0.33, 0.67):
            for j in range(scene.taxels):
                answer, begin = np.ones(scene.taxels), np.zeros(scene.taxels)
                answer[j], begin[j] = 0.0, part * scene.duration_s
                levels = (np.zeros(scene.taxels), scene.top_counts * np.eye(scene.taxels)[j])
                points = [{"answer": answer, "from_s": begin, "stuck_counts": v} for v in levels]
                found.append(replace(start(*points, sigma=(0.5, 0.5)), alone=j))
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
        self, strength: float, rng: np.random.Generator, layout: TaxelLayout, poses: int = 2
    ) -> dict[str, FloatArray]:
        """Return a case (:meth:`Effect.at_strength`); at strength 1 a sixteenth of the taxels, or one, is dead."""
        del poses
        if not (np.isfinite(strength) and strength >= 0):
            raise InputError([Problem(f"strength of effect {self.name}", "a number >= 0", f"{strength:g}")])
        order = np.argsort(np.linalg.norm(layout.centres_m + rng.normal(0, 1e-3, (layout.taxels, 2)), axis=1))
        dead = np.empty(layout.taxels)
        dead[order] = np.clip(strength * max(1, layout.taxels // 16) - np.arange(layout.taxels), 0.0, 1.0)
        return {"answer": 1.0 - dead}

    def apply(self, signal: FloatArray, samples: Samples, values: Values, setting: Setting) -> FloatArray:
        """See :meth:`SignalEffect.apply`."""
        del setting
        missing = 1.0 - values["answer"]
        since = np.where(samples.elapsed_s[:, None] >= values["from_s"], missing, 0.0)
        return signal + since * (values["stuck_counts"] - signal)
