"""Null sessions by way of the cache: what they depend on, and what is kept of them."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from skincal.diagnose.cache import Arrays, Cache
from skincal.gap.candidates import Scene
from skincal.gap.library import Library
from skincal.gap.models import Material, Model
from skincal.gap.null import Null, simulate_null
from skincal.model.arrays import FloatArray

_SCORE, _SIGNATURE, _MEAN, _BEYOND = "score ", "signature ", "mean", "beyond"


@dataclass(frozen=True, eq=False)
class Kept:
    """Stages of one diagnosis that are looked up before they are worked out.

    Attributes:
        cache: where.
        model: the base model, fitted.
        material: the session, split.
        seed: of the randomness.
    """

    cache: Cache
    model: Model
    material: Material
    seed: int

    def null(
        self,
        scene: Scene,
        library: Library,
        errors: Mapping[str, FloatArray],
        draws: int,
        rng: np.random.Generator,
        signatures: Mapping[str, FloatArray],
    ) -> Null:
        """See :func:`skincal.gap.null.simulate_null`."""

        def make() -> Arrays:
            null = simulate_null(scene, self.material, library, errors, draws, rng, signatures)
            return {
                **{_SCORE + name: own for name, own in null.scores.items()},
                **{_SIGNATURE + name: own for name, own in null.signatures.items()},
                _MEAN: np.array(null.mean_square),
                _BEYOND: null.beyond,
            }

        starts = [(name, [s.coords for s, _ in own]) for name, own in library.columns.items()]
        names = (*errors, starts, *signatures, draws, self.seed)
        found = self.cache.get(
            "null", [names, *errors.values(), scene.law, scene.nuisance, *self._protocol()], make
        )
        laws = tuple(law for law in errors for _ in range(draws))
        scores, signs = _part(found, _SCORE), _part(found, _SIGNATURE)
        return Null(laws, scores, float(found[_MEAN]), signs, found[_BEYOND])

    def _protocol(self) -> list[object]:
        """All that the residual of a session without noise depends on."""
        m, model = self.material, self.model.hypothesis.model
        samples = m.session.samples
        return [
            samples.contacts.points_m,
            samples.contacts.normals,
            samples.contacts.force_n,
            samples.indenters,
            *(
                getattr(samples, name)
                for name in ("indenter", "touching", "time_s", "phase", "speed_m_per_s")
            ),
            *(getattr(samples, name) for name in ("cycle", "met_n", "pose", "temperature_c", "shear_n")),
            m.session.row,
            m.session.observation,
            m.session.taxels,
            m.reading.sigma_counts,
            m.reading.frames,
            m.reading.further,
            m.reading.trust,
            m.reading.lift,
            m.reading.readout,
            m.learn,
            m.score,
            m.options,
            (model.surface, model.pose, model.elasticity_pa_per_m, np.asarray(model.scale_per_n).tolist()),
            (model.layout.centres_m, model.layout.sizes_m, model.resolution_m, model.rule),
            {name: {k: v.tolist() for k, v in own.items()} for name, own in self.model.held.items()},
        ]


def _part(found: Arrays, prefix: str) -> dict[str, FloatArray]:
    return {name.removeprefix(prefix): own for name, own in found.items() if name.startswith(prefix)}
