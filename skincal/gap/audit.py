"""Which effects these presses can show, how strong they must be, and which look the same.

The distance d' of a case of strength 1 is the length of its whitened change with pose, E, S and the nuisances of every
press projected out: in the direction of the effect the change is d' standard deviations. An effect with r free
directions is found by a chi-square test with r degrees of freedom; the smallest strength is the one at which that test
has the stated power at the stated false alarm, shared evenly among all effects (Bonferroni). Between half and full
strength d' grows like a power, which is extrapolated; below half strength in proportion at least.

Two effects look the same where one imitates the other: the part of a typical case of A that the best values of the
parameters of B within their bounds, forms included, make up. Where the cosine of the two is above 0.95, B is in the
set of names that A cannot be told from. For one parameter each this is the cosine of their directions, for several
that of the principal angle between the case and the other's span.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import cast

import numpy as np
from scipy.optimize import brentq, lsq_linear
from scipy.stats import chi2, ncx2

from skincal.fit.observe import Readout
from skincal.gap.base import BaseColumns, BaseModel
from skincal.gap.noise import NoiseFloor, Whitening, rounding
from skincal.gap.projection import Projection, orthonormal
from skincal.gap.sensitivity import EffectColumns, all_columns, observed_mask
from skincal.inference.session import GapSession
from skincal.model.arrays import FloatArray


@dataclass(frozen=True)
class AuditOptions:
    """What the audit counts with.

    Attributes:
        false_alarm: of the whole list of effects.
        power: at the smallest strength.
        alike: cosine above which two effects look the same.
        position_sigma_m: of the measured place of a press, along each direction [m].
        force_sigma: of the measured force of a press, relative.
        shape_sigma: doubt of each taxel's value in a press, relative and shared by its frames: no contact law is
            better than that.
    """

    false_alarm: float = 0.05
    power: float = 0.9
    alike: float = 0.95
    position_sigma_m: float = 1e-3
    force_sigma: float = 0.005
    shape_sigma: float = 0.02


@dataclass(frozen=True)
class Lost:
    """Where the change of a typical case goes: parts of its square, between 0 and 1."""

    presses: float
    base: float


@dataclass(frozen=True)
class EffectAudit:
    """What these presses tell of one effect.

    Attributes:
        name: of the effect.
        distance: d' at strength 1.
        raw_distance: the same before anything is projected out.
        threshold: d' that is needed.
        smallest_strength: at which it is found; infinite where no strength is.
        lost: what the presses' nuisances and the base model take up.
        lacking: covariates that were not recorded.
        overlaps: cosine with the best imitation by each other effect.
        consistent_with: names that these data cannot tell apart from this one, itself first.
    """

    name: str
    distance: float
    raw_distance: float
    threshold: float
    smallest_strength: float
    lost: Lost
    lacking: tuple[str, ...]
    overlaps: Mapping[str, float]
    consistent_with: tuple[str, ...]

    @property
    def visible(self) -> bool:
        """Whether a typical case is found."""
        return self.smallest_strength <= 1.0


@dataclass(frozen=True, eq=False)
class Linearised:
    """A session's base model and effects, whitened, nuisances and base model projected out.

    Attributes:
        base: the base model's values and slopes.
        weight: (N, J) one over the standard deviation of each observation, zero where not read.
        projection: what takes out the nuisances.
        effects: columns of each effect as they come from the model [counts].
    """

    base: BaseColumns
    weight: FloatArray
    projection: Projection
    effects: Mapping[str, EffectColumns]

    def whitened(self, change: FloatArray) -> FloatArray:
        """Columns (M, p), before the projection, of changes (N, J, p) [counts]."""
        return (change * self.weight[..., None]).reshape(-1, change.shape[-1])


def weights(session: GapSession, floor: NoiseFloor, values: FloatArray, readout: Readout) -> FloatArray:
    """Weights (N, J) [1/counts] of all observations."""
    if session.has_frames:
        frames = session.frames
    else:
        full = np.hypot(floor.frame_counts, rounding(readout))
        frames = np.full(len(session), (full / floor.mean_counts) ** 2)
    noise, worth = np.broadcast_to(floor.sigma_counts, values.shape[1:]), np.empty_like(values)
    for sigma in np.unique(noise).tolist():
        alike = noise == sigma
        worth[:, alike] = Whitening(sigma, readout).weight(values[:, alike], frames)
    return np.where(observed_mask(session, values.shape[1]), worth, 0.0)


def linearise(
    model: BaseModel,
    session: GapSession,
    base: BaseColumns,
    floor: NoiseFloor,
    options: AuditOptions,
    rng: np.random.Generator,
    names: tuple[str, ...] | None = None,
) -> Linearised:
    """Sensitivities of a session, all from one contact model.

    Args:
        model: the base model.
        session: what was observed, or would be.
        base: of ``base_columns``.
        floor: its noise.
        options: priors of the nuisances.
        rng: for cases that vary from taxel to taxel.
        names: of the effects; None: all.
    """
    weight = weights(session, floor, base.values, model.readout)
    prior = np.array([min(options.position_sigma_m, 0.05)] * 2 + [options.force_sigma])
    known = np.nan_to_num
    projection = Projection.of(
        session.press,
        known(base.press * prior) * weight[..., None],
        options.shape_sigma * np.abs(known(base.values)) * weight,
        known(base.base) * weight[..., None],
    )
    return Linearised(base, weight, projection, all_columns(model, session, rng, names))


def audit(linear: Linearised, options: AuditOptions | None = None) -> dict[str, EffectAudit]:
    """The audit of every effect, in the order of the chain."""
    options = options or AuditOptions()
    reduced = _reduce(linear)
    chance = options.false_alarm / len(reduced)
    return {name: _one(name, reduced, linear, chance, options) for name in reduced}


@dataclass(frozen=True, eq=False)
class _Reduced:
    """An effect in coordinates of few dimensions: the columns (n, p), and cases (n, D) at full and half strength."""

    columns: FloatArray
    typical: FloatArray
    half: FloatArray
    raw: float
    pressed: float


def _reduce(linear: Linearised) -> dict[str, _Reduced]:
    """Projected columns of all effects, turned into the space that they span."""
    free = Projection(linear.projection.blocks, np.zeros((linear.weight.size, 0)))
    parts: list[FloatArray] = []
    lengths: dict[str, tuple[float, float]] = {}
    for name, one in linear.effects.items():
        cases = np.moveaxis(np.concatenate([one.typical, one.half]), 0, -1)
        white = linear.whitened(np.nan_to_num(np.concatenate([one.columns, cases], axis=-1)))
        pressed = free.apply(white)
        parts.append(pressed - linear.projection.basis @ (linear.projection.basis.T @ pressed))
        own = slice(one.columns.shape[-1], one.columns.shape[-1] + len(one.typical))
        lengths[name] = (_rms_length(white[:, own]), _rms_length(pressed[:, own]))
    stacked = np.concatenate(parts, axis=1)
    tall = len(stacked) > stacked.shape[1]
    turned = np.asarray(cast("FloatArray", np.linalg.qr(stacked, mode="r"))) if tall else stacked
    found: dict[str, _Reduced] = {}
    at = 0
    for name, one in linear.effects.items():
        first = at + len(one.names)
        second = first + len(one.typical)
        last = second + len(one.half)
        found[name] = _Reduced(
            turned[:, at:first], turned[:, first:second], turned[:, second:last], *lengths[name]
        )
        at = last
    return found


def _rms_length(columns: FloatArray) -> float:
    return float(np.sqrt((columns**2).sum(axis=0).mean()))


def _one(
    name: str, reduced: Mapping[str, _Reduced], linear: Linearised, chance: float, options: AuditOptions
) -> EffectAudit:
    own = reduced[name]
    distance, half = _rms_length(own.typical), _rms_length(own.half)
    needed = threshold(max(1, orthonormal(own.columns).shape[1]), chance, options.power)
    overlaps = {
        other: imitation(own.typical, one.columns, linear.effects[other].least, linear.effects[other].most)
        for other, one in reduced.items()
        if other != name
    }
    same = sorted((o for o, cosine in overlaps.items() if cosine > options.alike), key=lambda o: -overlaps[o])
    return EffectAudit(
        name,
        distance,
        own.raw,
        needed,
        smallest_strength(distance, half, needed),
        _lost(own.raw, own.pressed, distance),
        linear.effects[name].lacking,
        overlaps,
        (name, *same),
    )


def _lost(raw: float, pressed: float, distance: float) -> Lost:
    if raw <= 0:
        return Lost(0.0, 0.0)
    return Lost(max(0.0, 1 - (pressed / raw) ** 2), max(0.0, (pressed**2 - distance**2) / raw**2))


def threshold(freedom: int, false_alarm: float, power: float) -> float:
    """The distance d' at which a chi-square test with so many degrees of freedom has a power."""
    limit = float(chi2.isf(false_alarm, freedom))

    def short(distance: float) -> float:
        return float(ncx2.sf(limit, freedom, distance**2)) - power

    return float(brentq(short, 1e-3, 10.0 + 2 * np.sqrt(limit)))


def smallest_strength(distance: float, half: float, needed: float) -> float:
    """The strength at which d' is enough, from d' at strength 1 and at half of it."""
    if not (distance > 1e-6 * needed and half > 0):
        return float("inf")
    growth = float(np.clip(np.log2(distance / half), 0.25, 4.0))
    if needed > half:
        return float((needed / distance) ** (1 / growth))
    # What levels off towards strength 1 begins in proportion; what begins flat goes on by its power.
    return float((needed / half) ** (1 / max(1.0, growth)) / 2)


def imitation(cases: FloatArray, columns: FloatArray, least: FloatArray, most: FloatArray) -> float:
    """The part of cases (n, D) that columns (n, p) imitate with coefficients within bounds: a cosine, 0 to 1."""
    length = np.linalg.norm(columns, axis=0)
    use = length > 1e-9 * max(1e-300, float(np.linalg.norm(cases)))
    total = float((cases**2).sum())
    if not use.any() or total <= 0:
        return 0.0
    unit = columns[:, use] / length[use]
    basis = orthonormal(unit)
    part = float(((basis.T @ cases) ** 2).sum()) / total
    if part > 0.5:
        bounds = (least[use] * length[use], most[use] * length[use])
        left = 0.0
        for case in cases.T:
            best = lsq_linear(basis.T @ unit, basis.T @ case, bounds, method="bvls")
            left += 2 * float(best.cost)
        part -= left / total
    return float(np.sqrt(np.clip(part, 0.0, 1.0)))
