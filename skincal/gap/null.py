"""What scores come out where nothing is missing: simulated sessions of this protocol, under several contact laws.

A null session is the fitted sensor, or one under a twin's law (:mod:`skincal.gap.twin`) that it would fit, with noise,
rounding and clipping, and with places and forces off as their priors say. What sensor, places and the law's own
directions (:mod:`skincal.gap.law`) can take up is projected out, as it is of data. All sessions share the linearised,
whitened sensitivities of the effects, so a hundred of them cost no more than one: an effect's score is that of its best
form, found on the training presses and scored on the selection presses as with data.

The p-value of a score is the share of null sessions in which *any* effect does as well, each counted in units of what
it reaches itself in one null session of twenty: a list of 22 effects is then no more prone to false alarms than one.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from skincal.gap.candidates import Scene
from skincal.inference.elastic_layer import ContactError
from skincal.gap.hypothesis import Hypothesis
from skincal.gap.library import Library
from skincal.gap.models import Material
from skincal.gap.problem import MOST_STEP
from skincal.gap.projection import Projection
from skincal.gap.signatures import signature_falls
from skincal.gap.twin import Twin
from skincal.model.arrays import FloatArray, as_floats

_UNIT_QUANTILE = 0.95
_LEAST_UNIT = 30.0
"""Less is nothing in any session: a noise that is found two percent too low, or a ramp that is averaged in a bin, makes
scores of ten or twenty."""
_MOVES = 2
"""Steps from a twin's sensor to that of the next."""


@dataclass(frozen=True, eq=False)
class Null:
    """Scores of null sessions.

    Attributes:
        laws: name of the law of each session (D,).
        scores: (D,) by effect.
        mean_square: mean square of a null session's whitened residual, sensor, places and law projected out.
        signatures: what each signature explains of a session (D,).
        beyond: (D,) squared residual of each session beyond the mean of all.
    """

    laws: tuple[str, ...]
    scores: Mapping[str, FloatArray]
    mean_square: float
    signatures: Mapping[str, FloatArray] = field(default_factory=dict[str, FloatArray])
    beyond: FloatArray = field(default_factory=lambda: np.zeros(0))

    def unit(self, name: str) -> float:
        """The score that an effect reaches in one null session of twenty."""
        own = self.scores.get(name)
        return _LEAST_UNIT if own is None else max(_LEAST_UNIT, float(np.quantile(own, _UNIT_QUANTILE)))

    @property
    def best(self) -> FloatArray:
        """(D,) the best score of any effect in each session, in units."""
        return np.max([own / self.unit(name) for name, own in self.scores.items()], axis=0)

    def times_most(self, excess: float) -> float:
        """A squared residual beyond the mean null session's, in units of the most that any of them has."""
        most = float(self.beyond.max(initial=0.0))
        return excess / most if most > 0 else 0.0

    def p_value(self, name: str, score: float) -> float:
        """The chance that any effect does as well in a null session."""
        beaten = int((self.best >= score / self.unit(name)).sum())
        return (1 + beaten) / (1 + len(self.laws))


def law_errors(scene: Scene, material: Material, twins: Sequence[Twin]) -> dict[str, FloatArray]:
    """What twins leave (N, J) of the base model, whitened: of each the sensor whose fit is this very model.

    A twin that is as wide as the fitted law is fitted by another sensor, that of a thick layer by one with a smaller E,
    and what *that* one leaves is something else. So each twin's sensor is moved towards the one of which the slopes of
    the base model explain nothing, in two steps from where that of the twin before ended. Effects of a calibration are
    in the slopes but not in the twins: beside strong ones the steps are a little too long or too short.

    Args:
        scene: of the base model's fit.
        material: the session.
        twins: laws, best in an order in which one is like the next.
    """
    fitted = scene.bench.hypothesis.with_effects({})
    values, rows = fitted.values(material.session), material.known
    slopes, place = scene.slopes.base[rows], scene.nuisance[rows]
    free = Projection.of(
        scene.press[rows], place, np.zeros_like(slopes[..., 0]), np.zeros_like(slopes[..., :1])
    )
    bare = free.apply(slopes.reshape(-1, slopes.shape[-1]))
    found: dict[str, FloatArray] = {}
    other = fitted
    for twin in twins:
        # Where the sensor is not free, as under uniform pressure, its slopes say nothing.
        try:
            for _ in range(_MOVES if material.options.base else 0):
                error = _differs(values, other, material, twin)[rows].reshape(-1, 1)
                step = as_floats(np.linalg.lstsq(bare, free.apply(error)[:, 0], rcond=None)[0])
                other = other.moved(-step / max(1.0, float(np.max(np.abs(step) / MOST_STEP))))
            found[twin.name] = _differs(values, other, material, twin)
        except ContactError:
            # A layer as stiff and as thick as this cannot be pressed on the twin's grid: there is no such twin.
            continue
    return found


def _differs(values: FloatArray, other: Hypothesis, material: Material, twin: Twin) -> FloatArray:
    expected = material.reading.expected(twin.values(other, material.session))
    return material.reading.with_counts(expected).residual(values)


def _misplaced(scene: Scene, draws: int, rng: np.random.Generator) -> FloatArray:
    """What errors of measured places and forces, drawn from their priors, do to residuals (N, J, draws)."""
    moved = rng.standard_normal((scene.bench.session.presses, scene.nuisance.shape[-1], draws))
    moved = np.where((scene.press >= 0)[:, None, None], moved[np.maximum(scene.press, 0)], 0.0)
    return np.einsum("njk,nkd->njd", scene.nuisance, moved)


def simulate_null(
    scene: Scene,
    material: Material,
    library: Library,
    errors: Mapping[str, FloatArray],
    draws: int,
    rng: np.random.Generator,
    signatures: Mapping[str, FloatArray] | None = None,
) -> Null:
    """Scores of all effects in null sessions.

    Args:
        scene: of the base model's fit.
        material: how the session is split.
        library: sensitivities of the effects about it.
        errors: (N, J) whitened residual of each law; zero for the fitted one.
        draws: sessions of each law.
        rng: for noise.
        signatures: columns (N, J, n) of what describes a residual.
    """
    seen = material.reading.seen
    views = scene.part(material.learn), scene.part(material.score)
    laws = tuple(law for law in errors for _ in range(draws))
    drawn = np.concatenate(
        [
            np.where(seen, error, 0.0)[..., None]
            + seen[..., None] * rng.standard_normal((*seen.shape, draws))
            for error in errors.values()
        ],
        axis=-1,
    )
    drawn += _misplaced(scene, len(laws), rng)
    first, second = (view.projection.apply(drawn[view.rows].reshape(-1, drawn.shape[-1])) for view in views)
    scores = {name: library.falls(name, views, (first, second))[1] for name in library.columns}
    whole = scene.part(material.known)
    all_of = whole.projection.apply(drawn[whole.rows].reshape(-1, drawn.shape[-1]))
    squares: FloatArray = (all_of**2).sum(axis=0)
    mean_square = float(squares.mean()) / max(1, int(seen[whole.rows].sum()))
    told = {name: signature_falls(whole, columns, all_of) for name, columns in (signatures or {}).items()}
    return Null(laws, scores, mean_square, told, squares - squares.mean())
