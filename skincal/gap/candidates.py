"""What each effect could explain of a session's residual, with sensor and places free to first order.

About a fitted hypothesis the whitened residual r is explained by an effect with parameters phi as far as

    || P (r - w (v(phi) - v(0))) ||²

falls, with v the values of the model itself, not of a line, and P the projection of :mod:`skincal.gap.projection` that
leaves out what the base model, effects named before and the places of presses take up. It is searched by Gauss-Newton
steps from a few forms of each effect. Parameters are found on some presses and scored on others.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np

from skincal.effects import COVARIATES, EFFECTS, Contacted, Effect, Stage
from skincal.gap.free import Coordinate, clipped, coordinates, parameters_at, priors, strengths
from skincal.gap.hypothesis import Hypothesis, Parameters
from skincal.gap.problem import RefitOptions, Slopes
from skincal.gap.projection import Projection
from skincal.gap.reading import Reading
from skincal.inference.session import GapSession
from skincal.gap.together import apart, together
from skincal.model import FlatPunch, Sphere
from skincal.model.arrays import BoolArray, FloatArray, IntArray, as_floats

FORMS: Mapping[str, tuple[Mapping[str, float], ...]] = {
    "hysteresis": ({"width": 0.3}, {"width": 1.5}, {"width": 5.0}),
    "creep": (
        {"time_constant_s": 0.2},
        {"time_constant_s": 1.0},
        {"time_constant_s": 5.0},
        {"time_constant_s": 30.0},
        {"time_constant_s": 2.0, "breadth": 2.0},
    ),
    "rate": ({"fade_s": 0.2}, {"fade_s": 2.0}, {"fade_s": 2.0, "slow_m_per_s": 1e-4}, {"fade_s": 100.0}),
    "latency": ({"filtered": 0.0}, {"filtered": 0.7}),
    "first_cycle": (
        {"cycles": 0.3},
        {"cycles": 1.5},
        {"cycles": 6.0},
        {"cycles": 30.0, "fading_per_n": 1.0},
        {"cycles": 1.0, "tail": 1.0},
    ),
    "baseline_drift": ({"settling_time_s": 60.0}, {"settling_time_s": 400.0}),
    "gain_drift": ({"settling_time_s": 60.0}, {"settling_time_s": 400.0}),
    "saturation": ({"sharpness": 2.0}, {"sharpness": 4.0}, {"sharpness": 15.0}),
    "dead_band": ({"recovery": 0.0}, {"recovery": 1.0}, {"recovery": 0.0, "softness": 0.3}),
    "response_curve": ({"knee_n": 0.05}, {"knee_n": 0.3}, {"knee_n": 1.5}),
    "cover": ({"share": 0.2}, {"share": 0.9}),
    "spread": ({"tail": 0.0}, {"tail": 1.0}),
    "crosstalk": ({"loss": 0.0}, {"loss": 1.0, "reach": 0.05}),
    "force_bias": ({"onset_n": 0.0}, {"onset_n": 0.15}),
    "indenter_radius": ({"coat": 0.0}, {"coat": 1.0}),
    "shear": (
        {"load_exponent": 0.0},
        {"stiffening_per_n": 1.5},
        {"load_exponent": 1 / 3},
        {"load_exponent": 1.0},
    ),
}
"""Forms from which an effect is searched; one start, the default, for all others."""

FEWER: Mapping[str, tuple[frozenset[str], ...]] = {
    "gain_drift": (frozenset({"settling", "settling_time_s"}),),
    "baseline_drift": (frozenset({"settling_counts", "settling_time_s"}),),
}
"""Parameters without which an effect is searched as well: what settles, in the time of presses that are not learned
from, can be anything where something else drifts."""

FIRST_STEP = 0.25
"""A strength's first step [typical values]: some effects are flat at neutral."""
_STEP = 0.03
_FURTHEST = 1.2
OF_PLACES = ("contact_offset", "shear")
"""Effects that move contacts: the places of presses have followed them already, and to first order only."""
_OF_WAY = 0.5
"""What the measured way of a contact within a press may be off, in parts of it; never more than the place itself."""
_NO_WAY = 1e-9
"""A way shorter than this is none [m]."""
_SHORTEST, _SHORTER = 0.04, 0.4


@dataclass(frozen=True, eq=False)
class Start:
    """Where the search for an effect begins: numbers to be found, parameters held beside them, first coordinates."""

    effect: str
    coords: tuple[Coordinate, ...]
    held: Mapping[str, Parameters] = field(default_factory=dict[str, Parameters])
    x: tuple[float, ...] = ()


@dataclass(frozen=True, eq=False)
class Found:
    """What an effect explains.

    Attributes:
        start: what was searched.
        x: (n,) where the search ended.
        learned: fall of the squared residual on the presses learned from, projected.
        scored: the same on other presses.
    """

    start: Start
    x: FloatArray
    learned: float
    scored: float

    @property
    def effect(self) -> str:
        """Its name."""
        return self.start.effect

    @property
    def parameters(self) -> dict[str, dict[str, FloatArray]]:
        """Parameters by effect."""
        return parameters_at(self.start.coords, self.x, self.start.held)


@dataclass(frozen=True, eq=False)
class Bench:
    """Values of a session under effects beside those of a hypothesis; contacts are kept.

    Attributes:
        hypothesis: sensor, places, and effects that are there already.
        session: with presses where they are measured.
        cache: contacts by what they depend on; filled as needed.
    """

    hypothesis: Hypothesis
    session: GapSession
    cache: dict[object, Contacted] = field(default_factory=dict[object, Contacted])

    @property
    def sizes(self) -> dict[str, int]:
        """Numbers in a parameter of each shape."""
        pose = self.session.samples.pose
        poses = 1 if pose is None else max(1, int(pose.max(initial=0)) + 1)
        return {"scalar": 1, "per-taxel": self.hypothesis.skin.skin.patch.layout.taxels, "per-pose": poses}

    @property
    def lacking(self) -> tuple[str, ...]:
        """Covariates that were not recorded."""
        return tuple(name for name in COVARIATES if not self.session.samples.has(name))

    def values(self, effects: Mapping[str, Parameters]) -> FloatArray:
        """Observations (N, J) [counts] with more effects."""
        skin = self.hypothesis.skin
        if effects:
            skin = skin.with_effects({**self.hypothesis.effects, **effects})
        points = any(a.effect.stage == Stage.SPREAD and not a.neutral for a in skin.effects)
        early = tuple(a.key for a in skin.effects if a.effect.stage <= Stage.CONTACT and not a.neutral)
        key = (early, points, skin.has_memory)
        if key not in self.cache:
            placed = self.hypothesis.placed(self.session)
            samples = placed.remembered if skin.has_memory else placed.samples
            made = skin.contact(samples, points=points)
            if early and len(self.cache) > 8:
                return self.session.means(skin.finish(made))
            self.cache[key] = made
        return self.session.means(skin.finish(self.cache[key]))

    def starts(self, name: str) -> list[Start]:
        """Where to search for an effect; nowhere if data or indenters do not allow it."""
        effect = EFFECTS[name]
        if name in self.hypothesis.effects or not self.fits(effect) or name == "dead_taxel":
            return []
        looked = self.session.taxels
        found: list[Start] = []
        ways = [(forms, frozenset[str]()) for forms in FORMS.get(name, ({},))]
        ways += [({}, left_out) for left_out in FEWER.get(name, ())]
        for forms, left_out in ways:
            coords = coordinates(effect, self.sizes, self.lacking, forms)
            fewer = tuple(c for c in coords if c.parameter.name not in left_out)
            if left_out and strengths(fewer).sum() == strengths(coords).sum():
                continue
            coords = fewer
            if looked is not None:
                coords = tuple(
                    c for c in coords if c.parameter.shape != "per-taxel" or c.index in set(looked.tolist())
                )
            if any(c.is_strength for c in coords):
                found.append(Start(name, coords))
        return found

    def fits(self, effect: Effect) -> bool:
        """Whether the effect can act on these indenters: that of a mesh has no radius."""
        balls = all(isinstance(i, Sphere | FlatPunch) for i in self.session.samples.indenters)
        return effect.name != "indenter_radius" or balls


@dataclass(frozen=True, eq=False)
class Scene:
    """A fitted session on which candidates are tried.

    Attributes:
        bench: makes values.
        zero: (N, J) values of the hypothesis as it is [counts].
        residual: (N, J) whitened.
        weight: (N, J) what a count is worth.
        slopes: of the hypothesis.
        prior: (3,) of the places of presses.
        press: (N,) rows of presses.
        law: (N, J, m) whitened directions in which the contact law may err, projected out as the sensor is.

    The residual is that at the *measured* places, to first order: where presses had to move to fit, what moved them is
    in it, and the projection takes out as much of it as the prior of the places allows. An effect that lives in the
    positions would leave no trace otherwise.
    """

    bench: Bench
    zero: FloatArray
    residual: FloatArray
    weight: FloatArray
    slopes: Slopes
    prior: FloatArray
    press: IntArray
    law: FloatArray

    @classmethod
    def of(
        cls,
        hypothesis: Hypothesis,
        slopes: Slopes,
        session: GapSession,
        reading: Reading,
        options: RefitOptions,
        law: FloatArray | None = None,
    ) -> Scene:
        """A scene about a refit's end."""
        own = np.where((session.press >= 0)[:, None], hypothesis.places[np.maximum(session.press, 0)], 0.0)
        return cls(
            Bench(hypothesis, session),
            slopes.values,
            slopes.residual + (slopes.place * own[:, None, :]).sum(axis=-1),
            reading.weight(slopes.values),
            slopes,
            options.place_prior,
            session.press,
            np.zeros((*slopes.values.shape, 0)) if law is None else law,
        )

    @cached_property
    def nuisance(self) -> FloatArray:
        """(N, J, 3 or 5) what place and force of a press, and its way within the press, do at one standard deviation.

        Where a contact moves as the force rises, joint angles do not tell that way much better than the place itself:
        errors of the joints change along it. There and back they are taken to be the same, so that what differs between
        loading and unloading stays evidence of memory.
        """
        way = np.minimum(_OF_WAY * self.bench.session.paths_m, self.prior[:2].min())
        place = self.slopes.place * self.prior
        if way.max(initial=0.0) < _NO_WAY:
            return place
        return np.concatenate([place, self.slopes.place[..., :2] * way[:, None, None]], axis=-1)

    def part(self, rows: BoolArray, *, told: bool = False) -> View:
        """The scene as some observations (N,) show it.

        Args:
            rows: which they are.
            told: whether sensor and effects are known from others, and not found on these.
        """
        of_others = [] if told else [self.slopes.base, self.slopes.effect]
        shared = np.concatenate([*of_others, self.law], axis=-1)
        press: IntArray = self.press[rows]
        projection = Projection.of(press, self.nuisance[rows], np.zeros_like(self.zero[rows]), shared[rows])
        return View(rows, self.weight[rows], projection, projection.apply(self.residual[rows].reshape(-1, 1)))


@dataclass(frozen=True, eq=False)
class View:
    """Some observations of a scene, with what is not of interest projected out.

    Attributes:
        rows: (N,) which they are.
        weight: (n, J) of them.
        projection: of their whitened residuals.
        residual: (n J, 1) whitened and projected.
    """

    rows: BoolArray
    weight: FloatArray
    projection: Projection
    residual: FloatArray

    def seen(self, change: FloatArray) -> FloatArray:
        """Changes (N, J) or (N, J, p) of values, whitened and projected (n J, p)."""
        some = change[self.rows]
        some = some[..., None] if some.ndim == 2 else some
        return self.projection.apply((some * self.weight[..., None]).reshape(-1, some.shape[-1]))

    def fall(self, change: FloatArray) -> float:
        """By how much a change (N, J) lowers the squared residual."""
        left = self.residual - self.seen(change)
        return float((self.residual**2).sum() - (left**2).sum())


def search(scene: Scene, start: Start, learn: View, score: View, steps: int = 5) -> Found:
    """The parameters of an effect that explain most, by damped Gauss-Newton steps from a start.

    Args:
        scene: what is to be explained.
        start: of the search.
        learn: observations that parameters are found on.
        score: observations that they are scored on.
        steps: at most.
    """
    coords = start.coords
    x = clipped(coords, np.array(start.x)) if start.x else np.zeros(len(coords))
    strong, prior = strengths(coords), priors(coords)

    def change(at: FloatArray) -> FloatArray:
        return np.nan_to_num(scene.bench.values(parameters_at(coords, at, start.held)) - scene.zero, nan=0.0)

    def cost(seen: FloatArray, at: FloatArray) -> float:
        return float(((learn.residual - seen) ** 2).sum() + ((at / prior) ** 2).sum())

    now = change(x)
    seen = learn.seen(now)
    best = cost(seen, x)
    for step in range(steps):
        free = np.flatnonzero(strong) if step == 0 else np.arange(len(x))
        lengths = _lengths(coords, x, first=step == 0)
        columns = learn.seen(_slopes(scene, change, start, free, x, lengths, now))
        curve = columns.T @ columns + np.diag(1 / prior[free] ** 2)
        pull = columns.T @ (learn.residual - seen)[:, 0] - x[free] / prior[free] ** 2
        move = np.zeros(len(x))
        move[free] = np.linalg.solve(curve + 1e-9 * np.diag(np.diag(curve)), pull)
        limit = np.where(strong, np.inf, _FURTHEST)
        move = np.clip(move, -limit, limit)
        before, share = best, 1.0
        while share > _SHORTEST and best == before:
            y = clipped(coords, x + share * move)
            there = change(y)
            after = learn.seen(there)
            if (value := cost(after, y)) < best:
                x, now, seen, best = y, there, after, value
            share *= _SHORTER
        if best == before:
            break
        fall = before - best
        if step > 0 and fall < max(1.0, 2e-3 * float((learn.residual**2).sum() - best)):
            break
    return Found(start, x, learn.fall(now), score.fall(now))


def _slopes(
    scene: Scene,
    change: Callable[[FloatArray], FloatArray],
    start: Start,
    which: IntArray,
    x: FloatArray,
    lengths: FloatArray,
    now: FloatArray,
) -> FloatArray:
    """Slopes (N, J, k) of a change of the values by some coordinates, by differences of these lengths (n,)."""
    beside = {*scene.bench.hypothesis.effects, *start.held}
    found = np.zeros((*now.shape, len(which)))
    some = [start.coords[int(k)] for k in which]
    for group in together(some, beside):
        own = which[group]
        y = x.copy()
        y[own] += lengths[own]
        looked = scene.bench.session.taxels
        found[..., group] = apart(change(y) - now, [some[k] for k in group], lengths[own], looked)
    return found


def _lengths(coords: Sequence[Coordinate], x: FloatArray, *, first: bool) -> FloatArray:
    """Steps of differences (n,), towards the inside of the bounds."""
    lengths = np.array([FIRST_STEP if first and c.is_strength else _STEP for c in coords])
    lengths *= np.array([_towards(c) if first and c.is_strength else 1.0 for c in coords])
    ends = clipped(coords, x + lengths)
    outside = np.abs(ends - x) < 0.5 * np.abs(lengths)
    return np.where(outside, -lengths, lengths)


def _towards(coordinate: Coordinate) -> float:
    """The side of neutral on which a typical case lies."""
    return -1.0 if coordinate.parameter.typical < 0 else 1.0


def straight(scene: Scene, start: Start, learn: View, score: View) -> Found:
    """What an effect explains to first order in its strengths, all of them free.

    An effect that moves contacts is in the places that the fit found, and so in the residual, to first order: there a
    change that is not has nothing to be compared with.
    """
    # A form does nothing without a strength: it stays at its start, until all is fitted in full.
    free = np.flatnonzero(strengths(start.coords))
    columns = secants(scene, start, free)
    seen, scored = learn.seen(columns), score.seen(columns)
    curve = seen.T @ seen + np.diag(1 / priors(start.coords)[free] ** 2)
    x = np.zeros(len(start.coords))
    x[free] = as_floats(np.linalg.solve(curve, seen.T @ learn.residual))[:, 0]
    x = clipped(start.coords, x)

    def fall(view: View, of: FloatArray) -> float:
        return float((view.residual**2).sum() - ((view.residual - of @ x[free, None]) ** 2).sum())

    return Found(start, x, fall(learn, seen), fall(score, scored))


def secants(scene: Scene, start: Start, which: IntArray) -> FloatArray:
    """Change of the values (N, J, k) by some numbers of an effect from neutral, over a quarter of its unit [counts]."""
    coords = start.coords
    highest = np.array([c.bounds[1] for c in coords])
    lowest = np.array([c.bounds[0] for c in coords])
    lengths = np.where(highest >= FIRST_STEP, FIRST_STEP, np.maximum(-FIRST_STEP, lowest))

    def change(at: FloatArray) -> FloatArray:
        return np.nan_to_num(scene.bench.values(parameters_at(coords, at, start.held)) - scene.zero)

    none = np.zeros(len(coords))
    return _slopes(scene, change, start, which, none, lengths, np.zeros_like(scene.zero))


def best_of(scene: Scene, name: str, learn: View, score: View, *, far: bool = False) -> Found | None:
    """The best of all searches for an effect; None where there is nothing to search.

    It is the one that explains most of what is learned from, unless that holds for no other presses.

    Args:
        scene: what is to be explained.
        name: of the effect.
        learn: observations that parameters are found on.
        score: observations that they are scored on.
        far: whether places may be so far off that what is of first order says little of them: effects that move
            contacts are searched as all others then, too.
    """
    ways = [straight] if name in OF_PLACES else [search]
    ways += [search] if far and name in OF_PLACES else []
    found = [way(scene, start, learn, score) for way in ways for start in scene.bench.starts(name)]
    if not found:
        return None
    best = max(found, key=lambda f: f.learned)
    return best if best.scored > 0 else max(found, key=lambda f: f.scored)
