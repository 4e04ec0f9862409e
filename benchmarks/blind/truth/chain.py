"""From what is commanded to what the sensor would read without noise, through hidden effects."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from scipy.special import ndtr

from benchmarks.blind.truth.body import ContactChange, values
from benchmarks.blind.truth.effect import Effect, Scene, Stage
from benchmarks.blind.truth.rig import TOP_COUNTS, Floats
from benchmarks.blind.truth.spec import Spec


def counts(scene: Scene, effects: Sequence[Effect] = ()) -> Floats:
    """Compute the taxels' readings (N, J) [counts] before noise, rounding and clipping."""
    touches = scene.touches
    for effect in effects:
        touches = effect.touches(touches, scene)
    moves = [m for m in (effect.moves(scene) for effect in effects) if m is not None]
    x = values(scene.body, touches, _change(effects), sum(moves[1:], moves[0]) if moves else None)
    for stage in Stage:
        for effect in (e for e in effects if e.stage is stage):
            x = effect.signal(x, scene)
    return x


def _change(effects: Sequence[Effect]) -> ContactChange:
    """Combine the contact changes of all effects."""
    whole = ContactChange()
    for change in (effect.change() for effect in effects):
        if change is not None:
            whole = replace(
                whole,
                hardening=change.hardening or whole.hardening,
                sheet_m=float(np.hypot(whole.sheet_m, change.sheet_m)),
                sphere_added_m=tuple(np.add(whole.sphere_added_m, change.sphere_added_m).tolist()),
            )
    return whole


def shown(x: Floats, noise_counts: float, rest_counts: float = 0.0) -> Floats:
    """Mean of what the converter shows of a value under noise: clipping lifts what is near zero."""
    top = (x - TOP_COUNTS - round(rest_counts)) / noise_counts
    return _rectified(x, noise_counts) - noise_counts * (top * ndtr(top) + _bell(top))


def _rectified(x: Floats, noise_counts: float) -> Floats:
    low = x / noise_counts
    return noise_counts * (low * ndtr(low) + _bell(low))


def _bell(x: Floats) -> Floats:
    return np.exp(-0.5 * x**2) / np.sqrt(2 * np.pi)


def read(rng: np.random.Generator, x: Floats, noise_counts: float, spec: Spec | None = None) -> Floats:
    """Return the sensor's readings of values (N, J): with noise, rounded, clipped, above the rest level."""
    rest, step, grows = (
        (0.0, 1, 0.0) if spec is None else (spec.rest_counts, spec.step_counts, spec.noise_grows)
    )
    noisy = x + rest + np.hypot(noise_counts, grows * np.maximum(x, 0.0)) * rng.standard_normal(x.shape)
    return np.clip(step * np.rint(noisy / step), 0, TOP_COUNTS + round(rest))
