"""Decoys: disturbances and faults that are no effect of the skin.

``shuffled``: pose, cycle, speed and temperature are those of other presses. ``positions``: measured places are twice
as far off, still within the slack. ``base``: pose, elasticity and scale far from the nominal ones, which a refit finds.
``noisy``: twice the noise. ``glitches``: a few presses are spoiled. ``jump``: a group of taxels jumps together.
``dying``: a taxel dies half-way; that is an effect, and named one.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from benchmarks.blind.truth.body import Body, image_store
from benchmarks.blind.truth.effect import Effect, Scene
from benchmarks.blind.truth.rig import NOMINAL_Y_M, TAXELS, Floats, Ints
from benchmarks.blind.truth.taxels import DeadTaxel

DECOYS = ("shuffled", "positions", "base", "noisy", "glitches")
FAULTS = ("glitches", "jump", "dying")

ALSO_FINE: Mapping[str, tuple[str, ...]] = {"jump": ("baseline_drift", "taxel_offset", "unknown")}
"""What else may be said of a session, besides what its label expects."""


def disturbed_body(rng: np.random.Generator, body: Body, decoy: str | None) -> Body:
    """The sensor with what the decoy changes of it."""
    if decoy == "positions":
        return replace(body, sigma_m=rng.uniform(0.8e-3, 1.0e-3))
    if decoy == "noisy":
        return replace(body, noise_counts=rng.uniform(1.6, 2.2))
    if decoy != "base":
        return body
    low, high = ((1.8e8, 2.3e8), (9e8, 1.4e9))[rng.integers(2)]
    elasticity = float(np.exp(rng.uniform(np.log(low), np.log(high))))
    sign = rng.choice([-1.0, 1.0], 3)
    return replace(
        body,
        y_m=NOMINAL_Y_M + sign[0] * rng.uniform(2.0e-3, 3.2e-3),
        beta_deg=sign[1] * rng.uniform(6.0, 9.0),
        alpha_deg=sign[2] * rng.uniform(12.0, 17.0),
        elasticity_pa_per_m=elasticity,
        scale_per_n=rng.uniform(40.0, 52.0) if rng.uniform() < 0.5 else rng.uniform(85.0, 105.0),
        images=image_store(body.images.law, elasticity),
    )


def covariate_order(rng: np.random.Generator, presses: int, decoy: str | None) -> Ints:
    """Whose covariates are written to each press (K,)."""
    return rng.permutation(presses) if decoy == "shuffled" else np.arange(presses)


def fault(rng: np.random.Generator, decoy: str | None) -> Effect | None:
    """The effect that a fault is, if it is one."""
    return replace(DeadTaxel.draw(rng), strength=rng.uniform(0.35, 0.65)) if decoy == "dying" else None


def disturbed(rng: np.random.Generator, x: Floats, scene: Scene, decoy: str | None) -> Floats:
    """Counts (N, J) with what is no effect of the skin."""
    if decoy == "glitches":
        return _with_glitches(rng, x, scene)
    if decoy == "jump":
        start = rng.integers(TAXELS)
        group = (start + np.arange(int(rng.integers(3, 7)))) % TAXELS
        late = scene.line.time_s >= rng.uniform(0.3, 0.7) * scene.length_s
        moved = x.copy()
        moved[np.ix_(late, group)] += rng.uniform(3.0, 8.0)
        return moved
    return x


def _with_glitches(rng: np.random.Generator, x: Floats, scene: Scene) -> Floats:
    """A press that slips off half-way, one of another place, and one whose samples jump."""
    spoiled = x.copy()
    presses = rng.choice(len(scene.by_press), int(rng.integers(1, 4)), replace=False)
    for kind, press in zip(rng.permutation(3), presses, strict=False):
        rows = scene.by_press[press]
        if kind == 0:
            spoiled[rows[len(rows) // 2 :]] *= rng.uniform(0.2, 0.5)
        elif kind == 1:
            spoiled[rows] = np.roll(x[rows], int(rng.integers(1, TAXELS)), axis=1)
        else:
            hit = rng.uniform(size=(len(rows), TAXELS)) < 0.04
            spoiled[rows] += np.where(hit, rng.uniform(30, 120, hit.shape), 0.0)
    return spoiled
