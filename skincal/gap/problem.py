"""A session to be fitted: what a hypothesis leaves, how that changes with every number, and the next step downhill.

Presses hang together by the sensor only, so their numbers are eliminated press by press (a Schur complement), and a
step costs little more than the model itself.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Self

import numpy as np

from skincal.effects import EFFECTS, Contacted, EffectSkin, Samples, Stage
from skincal.fit.tasks import Mapper
from skincal.gap.downhill import bounded_step
from skincal.gap.free import Coordinate, clipped, parameters_at, priors, room
from skincal.gap.hypothesis import PLACE, Hypothesis, Parameters, memory_samples
from skincal.gap.reading import Reading
from skincal.inference.session import GapSession
from skincal.gap.together import apart, together
from skincal.model import Cylinder, Plane
from skincal.model.arrays import BoolArray, FloatArray, as_floats

BASE_SIZE = 5
_STEPS = np.array([5e-5, 5e-5, 0.01, 0.02, 0.02])
"""Steps of differences: across, along [m], alpha [rad], logarithms of E and S."""
MOST_STEP = np.array([5e-4, 5e-4, 0.05, 0.4, 0.7])
"""The longest step of the base model at a time."""
_OF_PLACE = np.array([0, 0, 3])
"""Those for the place of a press along u and v, and for the logarithm of its force."""
_MOST_PLACE_M = 3e-4
_MOST_COORDINATE = 1.0
_COORDINATE_STEP = 0.03
_RIDGE = 1e-6
_WORTH_SENDING = 500
"""Indenters set down on the skin from which on a contact is sent to another process: the way there costs time as
well."""


Keep = Callable[[str, Sequence[object], Callable[[], Mapping[str, FloatArray]]], Mapping[str, FloatArray]]
"""Gives arrays of a kind that some parts determine, made by a function or kept from before."""


def afresh(
    kind: str, parts: Sequence[object], make: Callable[[], Mapping[str, FloatArray]]
) -> Mapping[str, FloatArray]:
    """A :data:`Keep` that keeps nothing."""
    del kind, parts
    return make()


@dataclass(frozen=True)
class RefitOptions:
    """How a refit goes.

    Attributes:
        position_sigma_m: of the measured place of a press, along each direction [m].
        force_sigma: of its measured force, relative.
        steps: at most.
        settle: steps in which only presses move.
        enough: the objective's fall in a step below which it is found, absolute.
        base: whether the base model may move.
        mapper: works out pieces that do not depend on each other; that of a pool of processes uses more cores. What is
            found does not depend on it.
        keep: may know already where a fit ended.
    """

    position_sigma_m: float = 1e-3
    force_sigma: float = 0.005
    steps: int = 8
    settle: int = 2
    enough: float = 2.0
    base: bool = True
    mapper: Mapper = field(default=map, repr=False, compare=False)
    keep: Keep = field(default=afresh, repr=False, compare=False)

    @property
    def place_prior(self) -> FloatArray:
        """(3,) standard deviations of what a press has of its own."""
        return np.array([self.position_sigma_m, self.position_sigma_m, self.force_sigma])

    @property
    def alone(self) -> Self:
        """The same for a piece of work that one process does by itself."""
        return replace(self, mapper=map)


@dataclass(frozen=True, eq=False)
class Slopes:
    """Whitened values and slopes of a hypothesis.

    Attributes:
        values: (N, J) before the converter [counts].
        residual: (N, J) whitened.
        base: (N, J, 5) whitened slopes by across, along, alpha, log E, log S.
        place: (N, J, 3) whitened slopes by the place and force of the own press.
        effect: (N, J, n) whitened slopes by the coordinates of effects.
    """

    values: FloatArray
    residual: FloatArray
    base: FloatArray
    place: FloatArray
    effect: FloatArray


@dataclass(frozen=True, eq=False)
class Look:
    """A hypothesis with what its presses do: every slope starts from there."""

    hypothesis: Hypothesis
    x: FloatArray
    contacted: Contacted
    values: FloatArray


@dataclass(frozen=True, eq=False)
class RefitProblem:
    """What is minimised, and the pieces of a step.

    Attributes:
        session: what was pressed.
        reading: what was read.
        options: priors and limits.
        coords: numbers of effects to be found.
        learn: (N,) observations that sensor and effects are learned from; None: all of them.
        fixed: parameters that stay as they are.
    """

    session: GapSession
    reading: Reading
    options: RefitOptions
    coords: tuple[Coordinate, ...]
    learn: BoolArray | None
    fixed: Mapping[str, Parameters]

    def at(self, hypothesis: Hypothesis, x: FloatArray) -> Hypothesis:
        """A hypothesis with the effects at some coordinates (n,)."""
        return hypothesis.with_effects(parameters_at(self.coords, x, self.fixed))

    def look(self, hypothesis: Hypothesis, x: FloatArray) -> Look:
        """What a hypothesis does, with the effects at some coordinates (n,)."""
        here = self.at(hypothesis, x)
        contacted = self._contact(here)
        return Look(here, x, contacted, self.session.means(here.skin.finish(contacted)))

    def wants_base(self, step: int) -> bool:
        """Whether a step, or what comes out after the last one, needs slopes by the base model."""
        return step >= self.options.steps or (self.options.base and step >= self.options.settle)

    def moved(self, look: Look, base: FloatArray, coords: FloatArray, places: FloatArray) -> Look:
        """A step further: of the sensor (5,), coordinates (n,) and places (P, 3)."""
        here, x = look.hypothesis, look.x
        y = clipped(self.coords, x + coords) if len(x) else x
        there = here.moved(base) if base.any() else here
        # Tactile points and what was worked out of them stay where the sensor did.
        there = (
            there.with_places(here.places + places)
            if not base.any()
            else replace(there, places=here.places + places)
        )
        return self.look(there, y)

    def judged(self, look: Look) -> tuple[float, FloatArray]:
        """What is minimised, and what each press (P,) adds of it.

        Presses that are not learned from have no say in the first, so not in whether a step is taken either.
        """
        residual = self.reading.residual(look.values)
        costs = cost_of_presses(look.hypothesis, residual, self.session, self.options)
        x = look.x
        shared = float(((x / priors(self.coords)) ** 2).sum()) if len(x) else 0.0
        places = (look.hypothesis.places / self.options.place_prior) ** 2
        if self.learn is not None:
            residual = residual[self.learn]
            places = places[np.unique(self.session.press[self.learn & (self.session.press >= 0)])]
        return float((residual**2).sum()) + float(places.sum()) + shared, costs

    def slopes(self, look: Look, *, base: bool = True) -> Slopes:
        """Slopes there; those by the base model are zero where they are not asked for."""
        here, values = look.hypothesis, look.values
        weight = self.reading.weight(values)[..., None]
        changed = [
            here.with_places(here.places + step * np.eye(PLACE)[k])
            for k, step in enumerate(_STEPS[_OF_PLACE])
        ]
        explicit = self._explicit(here) if base else []
        steps = [*_STEPS[_OF_PLACE], *_STEPS[explicit]]
        changed += [here.moved(_STEPS[k] * np.eye(BASE_SIZE)[k]) for k in explicit]
        groups = together(self.coords, here.effects)
        effects = [self._changed(look, group) for group in groups]
        # What acts after the contact needs no new one.
        early = [k for k, group in enumerate(groups) if self._stage(group[0]) <= Stage.SPREAD]
        contacts = self._contacts([*changed, *(effects[k][0] for k in early)], look.contacted)
        moved = [
            self._change(contact, other.skin, values, step)
            for contact, other, step in zip(contacts[: len(changed)], changed, steps, strict=True)
        ]
        place, by_sensor = moved[:PLACE], dict(zip(explicit, moved[PLACE:], strict=True))
        sensor = [np.zeros_like(values)] * BASE_SIZE
        if base:
            sensor = self._of_sensor(look, place, by_sensor, contacts[PLACE - 1])
        felt = dict(zip(early, contacts[len(changed) :], strict=True))
        columns = np.zeros((*values.shape, len(look.x)))
        for k, (group, (other, steps)) in enumerate(zip(groups, effects, strict=True)):
            change = self._change(felt.get(k, look.contacted), other.skin, values, 1.0)
            coords = [self.coords[n] for n in group]
            columns[..., group] = apart(change, coords, steps, self.session.taxels)
        # A press beyond the rim of a mesh has no image: the prior of its place alone pulls at it, and that leads back.
        weight = np.nan_to_num(weight)
        return Slopes(
            values,
            np.nan_to_num(self.reading.residual(values)),
            np.nan_to_num(np.stack(sensor, axis=-1)) * weight,
            np.nan_to_num(np.stack(place, axis=-1)) * weight,
            np.nan_to_num(columns) * weight,
        )

    def _contact(self, here: Hypothesis) -> Contacted:
        return here.skin.contact(memory_samples(here, here.placed(self.session)))

    def _contacts(self, those: Sequence[Hypothesis], like: Contacted) -> list[Contacted]:
        """The contacts of hypotheses that press as another did."""
        pairs = [(one.skin, memory_samples(one, one.placed(self.session))) for one in those]
        # Loads point by point, which a spread needs, are too many to be sent from one process to another.
        spread = any(a.effect.stage == Stage.SPREAD for one in those for a in one.skin.effects)
        mapper = self.options.mapper
        sent = mapper is not map and not spread
        sent = sent and any(one.skin.casts(like) >= _WORTH_SENDING for one in those)
        found = (mapper if sent else map)(_contact_of, pairs)
        return [one.skin.own(contact) for one, contact in zip(those, found, strict=True)]

    def _change(self, contact: Contacted, skin: EffectSkin, values: FloatArray, step: float) -> FloatArray:
        return as_floats((self.session.means(skin.finish(contact)) - values) / step)

    def _explicit(self, here: Hypothesis) -> list[int]:
        """Numbers of the base model that need contacts of their own."""
        shifts = [] if isinstance(here.model.surface, Cylinder | Plane) else [0, 1]
        soft = [3] if any(a.effect.stage <= Stage.SPREAD for a in here.skin.effects) else []
        return [*shifts, 2, *soft]

    def _of_sensor(
        self, look: Look, place: list[FloatArray], explicit: Mapping[int, FloatArray], forced: Contacted
    ) -> list[FloatArray]:
        """Slopes (N, J) by the five numbers of the sensor.

        Args:
            look: where.
            place: slopes by the three numbers of each press.
            explicit: slopes by numbers of the sensor that are known already.
            forced: all presses with a force that is larger by the step of log E.
        """
        here, values, step = look.hypothesis, look.values, float(_STEPS[3])
        skin = here.skin
        # On a cylinder or a plane a sensor that moves is a press that moves the other way.
        found = {0: -place[0], 1: -place[1], **explicit}
        if 3 not in found:
            # Loads are F times a function of F / E: on softer skin they are those of a larger force, made smaller.
            softer = replace(look.contacted, loads_n=forced.loads_n * np.exp(-step))
            found[3] = self._change(softer, skin, values, -step)
        scale = here.moved(_STEPS[4] * np.eye(BASE_SIZE)[4]).model.scale_per_n
        scaled = replace(skin.skin.parameters, scale_per_n=scale)
        other = replace(skin, skin=replace(skin.skin, parameters=scaled))
        found[4] = self._change(look.contacted, other, values, float(_STEPS[4]))
        return [found[k] for k in range(BASE_SIZE)]

    def _stage(self, k: int) -> Stage:
        return EFFECTS[self.coords[k].effect].stage

    def _changed(self, look: Look, group: Sequence[int]) -> tuple[Hypothesis, FloatArray]:
        """A hypothesis with some coordinates changed, and by how much each of them."""
        y = look.x.copy()
        highest = np.array([self.coords[k].bounds[1] for k in group])
        steps = np.where(y[group] + _COORDINATE_STEP <= highest, _COORDINATE_STEP, -_COORDINATE_STEP)
        y[group] += steps
        return self.at(look.hypothesis, y), steps

    def step(
        self, look: Look, slopes: Slopes, damping: FloatArray, *, free: bool
    ) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Steps of base (5,), coordinates (n,) and places (P, 3); each press with a damping of its own (P,)."""
        here, x = look.hypothesis, look.x
        normal, right, presses = self._normal(here, slopes, damping)
        shared = np.zeros(len(right))
        which = np.arange(len(right)) if free else np.arange(BASE_SIZE, len(right))
        if len(x):
            inverse = 1 / priors(self.coords) ** 2
            normal[BASE_SIZE:, BASE_SIZE:] += np.diag(inverse)
            right[BASE_SIZE:] -= inverse * x
        if len(which) and (free or len(x)):
            shared[which] = self._within(x, normal[np.ix_(which, which)], right[which])
        most = np.concatenate([MOST_STEP, np.full(len(x), _MOST_COORDINATE)])
        shared /= max(1.0, float(np.max(np.abs(shared) / most, initial=0.0)))
        places = np.zeros_like(here.places)
        for row, (inverse, cross, own) in presses.items():
            places[row] = self.options.place_prior * (inverse @ (own - cross @ shared))
        length = np.hypot(places[:, 0], places[:, 1])
        places *= np.minimum(1.0, _MOST_PLACE_M / np.maximum(length, 1e-12))[:, None]
        return shared[:BASE_SIZE], shared[BASE_SIZE:], places

    def _within(self, x: FloatArray, normal: FloatArray, right: FloatArray) -> FloatArray:
        """The step that solves normal equations within bounds; the last numbers are the coordinates."""
        low, high = np.full((2, len(right)), [[-np.inf], [np.inf]])
        if len(x):
            low[-len(x) :], high[-len(x) :] = room(self.coords, x)
        return bounded_step(normal + _RIDGE * np.diag(np.diag(normal) + 1e-12), right, low, high)

    def _normal(
        self, here: Hypothesis, slopes: Slopes, damping: FloatArray
    ) -> tuple[FloatArray, FloatArray, dict[int, tuple[FloatArray, FloatArray, FloatArray]]]:
        shared = np.concatenate([slopes.base, slopes.effect], axis=-1)
        use = np.ones(len(shared), dtype=np.bool_) if self.learn is None else self.learn
        flat = shared[use].reshape(-1, shared.shape[-1])
        normal, right = flat.T @ flat, flat.T @ slopes.residual[use].ravel()
        prior = self.options.place_prior
        presses: dict[int, tuple[FloatArray, FloatArray, FloatArray]] = {}
        for row in np.unique(self.session.press[self.session.press >= 0]).tolist():
            rows = np.flatnonzero(self.session.press == row)
            own = (slopes.place[rows] * prior).reshape(-1, PLACE)
            curve = own.T @ own
            curve = curve + np.eye(PLACE) + float(damping[row]) * np.diag(np.diag(curve))
            pull = own.T @ slopes.residual[rows].ravel() - here.places[row] / prior
            cross = own.T @ shared[rows].reshape(-1, shared.shape[-1])
            inverse = as_floats(np.linalg.inv(curve))
            presses[row] = (inverse, cross, pull)
            if use[rows].all():
                normal -= cross.T @ inverse @ cross
                right -= cross.T @ inverse @ pull
        return normal, right, presses

    def covariance(self, here: Hypothesis, slopes: Slopes) -> FloatArray:
        """(5 + n, 5 + n) of sensor and coordinates, places integrated out."""
        normal, _, _ = self._normal(here, slopes, np.zeros(len(here.places)))
        if self.coords:
            normal[BASE_SIZE:, BASE_SIZE:] += np.diag(1 / priors(self.coords) ** 2)
        return as_floats(np.linalg.pinv(normal, hermitian=True))


def cost_of_presses(
    hypothesis: Hypothesis, residual: FloatArray, session: GapSession, options: RefitOptions
) -> FloatArray:
    """Squared residual and squared move (P,) of each press.

    Args:
        hypothesis: places of presses.
        residual: (N, J) whitened.
        session: says which press each observation is of.
        options: priors of places.
    """
    own = session.press >= 0
    squares = np.bincount(session.press[own], (residual[own] ** 2).sum(axis=1), len(hypothesis.places))
    return squares + ((hypothesis.places / options.place_prior) ** 2).sum(axis=1)


def _contact_of(pair: tuple[EffectSkin, Samples]) -> Contacted:
    skin, samples = pair
    return skin.contact(samples)
