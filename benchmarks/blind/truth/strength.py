"""Strength g of a hidden effect: RMS of its residual after a refit of the base model, over the noise.

The refit is linear: what the effect changes in what is shown is projected on what the base model could do about it -
turn, elasticity and scale of the sensor, and the place of every press, which a fit may shift within its slack. All
samples with contact and all taxels count alike. An effect of the measured positions alone (``contact_offset``) leaves
no trace in images whose places may be shifted: its g is the RMS of the positions that no pose of the sensor explains,
over the random error of a position. And a press on a dead taxel is explained, linearly, by a place millimetres away,
which no refit would find: for ``dead_taxel`` only the constant part of the places is refitted.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from benchmarks.blind.truth.body import values
from benchmarks.blind.truth.chain import counts, shown
from benchmarks.blind.truth.effect import Effect, Scene
from benchmarks.blind.truth.rig import NOMINAL_Y_M, SIGMA_M, Floats, Ints

_PLACE_STEP_M, _TURN_STEP_DEG, _STIFFER = 0.02e-3, 0.3, 0.03
_TRIES, _NEAR_ENOUGH, _LEAST = 12, 0.02, 1e-6


@dataclass(frozen=True, eq=False)
class Refit:
    """Sensitivities of a scene's base model, for a refit to a change of its images.

    Attributes:
        base: (N, J) what is shown without any effect [counts].
        places: (N, J, 2) change with the place of the contact [counts/m].
        shared: (N, J, 3) change with turn, elasticity and scale, each by its step [counts].
        rows: samples with contact.
    """

    scene: Scene
    base: Floats
    places: Floats
    shared: Floats
    rows: Ints

    @classmethod
    def of(cls, scene: Scene) -> Refit:
        """Compute the sensitivities by finite differences."""
        body, touches = scene.body, scene.touches
        noise = body.noise_counts
        plain = shown(values(body, touches), noise)
        step = _PLACE_STEP_M
        places = [
            (shown(values(body, touches.moved(s, t)), noise) - plain) / step
            for s, t in ((step, 0.0), (0.0, step))
        ]
        turned = replace(body, alpha_deg=body.alpha_deg + _TURN_STEP_DEG)
        stiffer = replace(body, elasticity_pa_per_m=body.elasticity_pa_per_m * (1 + _STIFFER))
        scaled = replace(body, scale_per_n=body.scale_per_n * (1 + _STIFFER))
        shared = [shown(values(other, touches), noise) - plain for other in (turned, stiffer, scaled)]
        rows = np.flatnonzero(scene.touching)
        return cls(scene, plain, np.stack(places, axis=2), np.stack(shared, axis=2), rows)

    def left(self, change: Floats, *, places: bool = True) -> Floats:
        """Return the residual of a change (N, J) [counts] in the samples with contact (M, J)."""
        press = self.scene.line.press[self.rows]
        target, shared = change[self.rows], self.shared[self.rows]
        slack = self.places[self.rows]
        if places:
            stack = np.concatenate([target[:, :, None], shared], axis=2)
            stack = self._without_places(stack, slack, press)
        else:
            stack = np.concatenate([target[:, :, None], shared, slack], axis=2)
        flat = stack.reshape(-1, stack.shape[2])
        best = np.linalg.lstsq(flat[:, 1:], flat[:, 0], rcond=None)[0]
        return (flat[:, 0] - flat[:, 1:] @ best).reshape(target.shape)

    def _without_places(self, stack: Floats, slack: Floats, press: Ints) -> Floats:
        """The same with the best shift of every press taken off each column; shifts are bound by their prior."""
        prior = (self.scene.body.noise_counts / SIGMA_M) ** 2 * np.eye(2)
        found = np.empty_like(stack)
        for number in np.unique(press):
            here = press == number
            a = slack[here].reshape(-1, 2)
            b = stack[here].reshape(len(a), -1)
            shift = np.linalg.solve(a.T @ a + prior, a.T @ b)
            found[here] = (b - a @ shift).reshape(stack[here].shape)
        return found

    def strength(self, effect: Effect) -> float:
        """The g of an effect that is there alone."""
        if effect.in_positions:
            return self._of_positions(effect)
        noise = self.scene.body.noise_counts
        change = shown(counts(self.scene, [effect]), noise) - self.base
        return float(np.sqrt(np.mean(self.left(change, places=not effect.places_held) ** 2))) / noise

    def _of_positions(self, effect: Effect) -> float:
        plan, off = self.scene.plan, effect.reported(self.scene)
        arc, along = plan.column("arc_m"), plan.column("along_m") - NOMINAL_Y_M
        one, zero = np.ones(len(arc)), np.zeros(len(arc))
        moves = np.stack([np.r_[one, zero], np.r_[zero, one], np.r_[-along, arc]], axis=1)
        target = np.r_[off[:, 0], off[:, 1]]
        left = target - moves @ np.linalg.lstsq(moves, target, rcond=None)[0]
        return float(np.sqrt(np.mean(left**2))) / self.scene.body.sigma_m


def of_strength(effect: Effect, refit: Refit, wanted: float) -> tuple[Effect, float]:
    """An effect of the strength g that is wanted, or as near as it can be; and the g that it has.

    g need not grow for ever: what swallows the signal leaves less to be seen. The weakest effect that has g is taken.
    """
    sign = np.sign(effect.strength) or 1.0

    def measured(size: float) -> tuple[float, float]:
        return size, refit.strength(replace(effect, strength=float(sign * size)))

    size = abs(effect.strength)
    while (weak := measured(size))[1] > 0.7 * wanted:
        size *= 0.5 * wanted / weak[1]
    tried = [weak]
    for _ in range(_TRIES):
        size = min(_next_size(tried, wanted), effect.largest)
        tried.append(measured(size))
        ended = size >= effect.largest and tried[-1][1] < wanted
        if ended or tried[-1][1] < tried[-2][1] < wanted or abs(tried[-1][1] / wanted - 1) < _NEAR_ENOUGH:
            break
    size, found = min(tried, key=lambda pair: abs(np.log(max(pair[1], _LEAST) / wanted)))
    return replace(effect, strength=float(sign * size)), found


def _next_size(tried: list[tuple[float, float]], wanted: float) -> float:
    """In proportion, at most twice as strong; between the weakest that is too strong and what is weaker than it."""
    above = [pair for pair in tried if pair[1] >= wanted]
    if not above:
        size, found = tried[-1]
        return size * float(np.clip(wanted / max(found, _LEAST), 1.05, 2.0))
    high = min(above)
    low = max(pair for pair in tried if pair[0] < high[0])
    way = np.log(wanted / max(low[1], _LEAST)) / np.log(high[1] / max(low[1], _LEAST))
    return float(low[0] * (high[0] / low[0]) ** np.clip(way, 0.05, 0.95))
