"""How every effect changes what is observed: columns of finite differences, all effects of the registry alike.

A strength's column is the secant from neutral to a quarter of its typical value (one percent of its range where
a typical case has none of it), because some effects are flat at neutral: a spread acts by its variance, a saturation
by a power. A form's column is the secant of the effect at typical strength to the form times 1.5 on a logarithmic
scale, or 15 % of its range on a linear one. Forms with one number a taxel have no column.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from skincal.effects import (
    COVARIATES,
    EFFECTS,
    Contacted,
    Effect,
    EffectParameter,
    EffectSkin,
    SpreadEffect,
    Stage,
)
from skincal.effects.base import MemoryEffect
from skincal.effects.samples import DERIVED
from skincal.gap.base import BaseModel
from skincal.inference.session import GapSession
from skincal.model import FlatPunch, Sphere
from skincal.model.arrays import BoolArray, FloatArray, IntArray

STEP = 0.25
"""Step of a strength's column, in typical values."""
_OF_RANGE, _FORM_RANGE, _FORM_FACTOR = 0.01, 0.15, 1.5

Parameters = dict[str, FloatArray]


@dataclass(frozen=True, eq=False)
class EffectColumns:
    """What an effect does to the observations.

    Attributes:
        names: (p,) parameter of each column, with its taxel or pose.
        columns: (N, J, p) change of the values by one step of the parameter [counts].
        least: (p,) how many steps the parameter may go down.
        most: (p,) how many steps it may go up.
        typical: (D, N, J) change of the values by cases of strength 1 [counts]; drawn ones where the effect varies
            from taxel to taxel.
        half: (D, N, J) the same at half that strength.
        lacking: covariates of parameters that were left out, or the effect as a whole.
    """

    names: tuple[str, ...]
    columns: FloatArray
    least: FloatArray
    most: FloatArray
    typical: FloatArray
    half: FloatArray
    lacking: tuple[str, ...] = ()


@dataclass(frozen=True, eq=False)
class Simulator:
    """Observations of a session under effects; the contact without effects is kept.

    Attributes:
        skin: without effects.
        session: that is simulated.
        cache: contacts by what they depend on; filled as needed.
        last: observations under slow effects, by their parameters; filled as needed.
    """

    skin: EffectSkin
    session: GapSession
    cache: dict[tuple[bool, bool], Contacted] = field(default_factory=dict[tuple[bool, bool], Contacted])
    last: dict[tuple[object, ...], FloatArray] = field(default_factory=dict[tuple[object, ...], FloatArray])

    @classmethod
    def of(cls, model: BaseModel, session: GapSession) -> Simulator:
        """The simulator of a model."""
        return cls(model.skin, session)

    def see(self, effect: Effect | None, parameters: Parameters) -> FloatArray:
        """Observations (N, J) [counts]."""
        skin = self.skin if effect is None else self.skin.with_effects({effect.name: parameters})
        memory = isinstance(effect, MemoryEffect)
        samples = self.session.remembered if memory else self.session.samples
        if effect is not None and effect.stage <= Stage.CONTACT:
            asked = skin.effects[0].key
            if asked not in self.last:
                self.last[asked] = self.session.means(skin.values(samples))
            return self.last[asked]
        key = (memory, isinstance(effect, SpreadEffect))
        if key not in self.cache:
            self.cache[key] = self.skin.contact(samples, points=key[1])
        return self.session.means(skin.finish(self.cache[key]))

    @property
    def looked_at(self) -> IntArray:
        """The taxels of the layout that the session looks at."""
        some = self.session.taxels
        return np.arange(self.skin.skin.patch.layout.taxels) if some is None else some

    @property
    def poses(self) -> int:
        """Number of hand poses in the session."""
        pose = self.session.samples.pose
        return 1 if pose is None else max(1, int(pose.max(initial=0)) + 1)


def lacking(effect: Effect, has: set[str]) -> tuple[str, ...]:
    """Covariates that an effect may need and that are not there."""
    return tuple(name for name in effect.all_covariates if name not in has)


def effect_columns(
    simulator: Simulator, effect: Effect, rng: np.random.Generator, draws: int = 4
) -> EffectColumns:
    """What one effect does.

    Args:
        simulator: of the session.
        effect: of the registry.
        rng: for cases that vary from taxel to taxel.
        draws: number of such cases.
    """
    samples = simulator.session.samples
    missing = lacking(effect, {name for name in COVARIATES if samples.has(name)})
    usable = [p for p in effect.parameters if not set(p.needs) & set(missing)]
    nothing = set(effect.covariates) & set(missing) or not _fits(effect, simulator)
    usable = [] if nothing else usable
    zero = simulator.see(None, {})
    columns = _strengths(simulator, effect, usable, zero)
    columns += _forms(simulator, effect, usable, rng)
    varies = any(p.shape == "per-taxel" and p.role == "strength" for p in effect.parameters)
    seeds = rng.integers(0, 2**31, draws if varies else 1)
    full, half = (
        np.stack([_case(simulator, effect, usable, s, int(seed)) - zero for seed in seeds])
        for s in (1.0, 0.5)
    )
    steps = [c.change for c in columns]
    return EffectColumns(
        tuple(c.name for c in columns),
        np.stack(steps, axis=-1) if steps else np.zeros((*zero.shape, 0)),
        np.array([c.least for c in columns]),
        np.array([c.most for c in columns]),
        full,
        half,
        tuple(name for name in missing if name not in DERIVED),
    )


def all_columns(
    model: BaseModel, session: GapSession, rng: np.random.Generator, names: tuple[str, ...] | None = None
) -> dict[str, EffectColumns]:
    """Columns of effects by name, of all of them unless some are named."""
    simulator = Simulator.of(model, session)
    return {name: effect_columns(simulator, EFFECTS[name], rng) for name in names or tuple(EFFECTS)}


@dataclass(frozen=True, eq=False)
class _Column:
    name: str
    change: FloatArray
    least: float
    most: float


def _fits(effect: Effect, simulator: Simulator) -> bool:
    """Whether the effect can act on these indenters: that of a mesh has no radius."""
    balls = all(isinstance(i, Sphere | FlatPunch) for i in simulator.session.samples.indenters)
    return effect.name != "indenter_radius" or balls


def _case(
    simulator: Simulator, effect: Effect, usable: list[EffectParameter], strength: float, seed: int
) -> FloatArray:
    given = effect.at_strength(
        strength, np.random.default_rng(seed), simulator.skin.skin.patch.layout, simulator.poses
    )
    names = {p.name for p in usable}
    return simulator.see(effect, {name: value for name, value in given.items() if name in names})


def step_of(parameter: EffectParameter) -> float:
    """The step of a strength's column, in its unit; towards the inside of its bounds."""
    step = STEP * parameter.typical
    if step == 0:
        step = _OF_RANGE * (parameter.high - parameter.low)
        if parameter.neutral + step > parameter.high:
            step = -step
    return step


def _strengths(
    simulator: Simulator, effect: Effect, usable: list[EffectParameter], zero: FloatArray
) -> list[_Column]:
    found: list[_Column] = []
    for parameter in usable:
        if parameter.role != "strength":
            continue
        step = step_of(parameter)
        ends = sorted(
            ((parameter.low - parameter.neutral) / step, (parameter.high - parameter.neutral) / step)
        )
        size = {
            "scalar": 1,
            "per-taxel": simulator.skin.skin.patch.layout.taxels,
            "per-pose": simulator.poses,
        }[parameter.shape]
        for i in simulator.looked_at.tolist() if parameter.shape == "per-taxel" else range(size):
            value: FloatArray = np.full(size, parameter.neutral)
            value[i] += step
            given = value[0] if parameter.shape == "scalar" else value
            name = parameter.name if parameter.shape == "scalar" else f"{parameter.name}[{i}]"
            change = simulator.see(effect, {parameter.name: np.asarray(given)}) - zero
            found.append(_Column(name, change, *ends))
    return found


def _forms(
    simulator: Simulator, effect: Effect, usable: list[EffectParameter], rng: np.random.Generator
) -> list[_Column]:
    forms = [p for p in usable if p.role == "form" and p.shape == "scalar"]
    if not forms:
        return []
    seed = int(rng.integers(0, 2**31))
    strong = effect.at_strength(
        1.0, np.random.default_rng(seed), simulator.skin.skin.patch.layout, simulator.poses
    )
    strong = {p.name: strong[p.name] for p in usable}
    here, found = simulator.see(effect, strong), list[_Column]()
    for p in forms:
        now = float(strong[p.name])
        if p.scale == "log":
            other = now * _FORM_FACTOR if now * _FORM_FACTOR <= p.high else now / _FORM_FACTOR
            steps = [np.log(end / now) / np.log(other / now) for end in (p.low, p.high)]
        else:
            move = _FORM_RANGE * (p.high - p.low)
            other = now + move if now + move <= p.high else now - move
            steps = [(end - now) / (other - now) for end in (p.low, p.high)]
        change = simulator.see(effect, {**strong, p.name: np.asarray(other)}) - here
        found.append(_Column(p.name, change, float(min(steps)), float(max(steps))))
    return found


def observed_mask(session: GapSession, taxels: int) -> BoolArray:
    """Which values (N, J) were read: all of them in a plan."""
    return (
        np.ones((len(session), taxels), dtype=bool) if session.counts is None else np.isfinite(session.counts)
    )
