"""A session and its label, from what is asked of it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from typing import Any

import numpy as np

from benchmarks.blind.truth.body import Body, Touches, draw_body
from benchmarks.blind.truth.catalogue import EFFECTS
from benchmarks.blind.truth.chain import counts, read, shown
from benchmarks.blind.truth.decoys import ALSO_FINE, covariate_order, disturbed, disturbed_body, fault
from benchmarks.blind.truth.effect import Effect, Scene
from benchmarks.blind.truth.outside import OUTSIDE
from benchmarks.blind.truth.protocol import HOLD, make_plan, timeline
from benchmarks.blind.truth.rig import SLACK_M, SPHERES_M, Floats, Ints
from benchmarks.blind.truth.spec import Spec
from benchmarks.blind.truth.strength import Refit, of_strength

FORCE_NOISE_N, SHEAR_NOISE_N, TEMPERATURE_NOISE_C = 0.01, 0.012, 0.05
ACHIEVED_FORCE, FORCE_ERROR = 0.014, 0.004
PLACED_M = 0.3e-3
NOTHING_G = 0.05
"""A protocol can leave an effect without any trace (an error of the second hand pose, where there is but one)."""


@dataclass(frozen=True, eq=False)
class Session:
    """Recorded data of a session, and its label.

    Attributes:
        scene: what truly was.
        measured_m: (K, 2) measured places round and along the finger [m].
        force_n, shear_n, temperature_c: measured, sample by sample.
        reading: (N, J) of the sensor [counts].
        order: (K,) whose covariates are written to each press.
        with_frames: whether samples are written, or only means of holds.
        label: what is hidden.
        rest_counts: level at rest.
    """

    scene: Scene
    measured_m: Floats
    force_n: Floats
    shear_n: Floats
    temperature_c: Floats
    reading: Floats
    order: Ints
    with_frames: bool
    label: dict[str, Any]
    rest_counts: float = 0.0

    def of_holds(self, column: Floats) -> Floats:
        """Mean over the hold of every press, of samples (N, ...)."""
        holds = (rows[self.scene.line.phase[rows] == HOLD] for rows in self.scene.by_press)
        return np.stack([column[rows].mean(axis=0) for rows in holds])


def make_session(spec: Spec) -> Session:
    """The session of a spec; the same spec gives the same session."""
    rng = np.random.default_rng([spec.seed, spec.number, *spec.suite.encode()])
    body = disturbed_body(rng, draw_body(rng, spec.law), spec.decoy)
    scene = _scene(rng, body, spec.protocol)
    effects, strengths = _effects(rng, spec, scene)
    clean = disturbed(rng, counts(scene, effects), scene, spec.decoy)
    order = covariate_order(rng, len(scene.plan.presses), spec.decoy)
    reading = read(rng, clean, body.noise_counts, spec)
    touching = scene.touching
    session = Session(
        scene,
        _measured(rng, scene, effects),
        np.maximum(
            scene.touches.force_n * _force_errors(rng, scene) + _noise(rng, scene, FORCE_NOISE_N), 0.0
        ),
        scene.shear_n + _noise(rng, scene, SHEAR_NOISE_N, 2) * touching[:, None],
        _told_temperature(scene, order) + _noise(rng, scene, TEMPERATURE_NOISE_C),
        reading,
        order,
        spec.protocol != "static",
        {},
        spec.rest_counts,
    )
    return replace(session, label=_label(spec, session, clean, effects, strengths))


def _scene(rng: np.random.Generator, body: Body, protocol: str) -> Scene:
    plan = make_plan(rng, protocol, body.depth_m)
    line = timeline(plan, body.depth_m)
    achieved = plan.column("force_n") * (1 + ACHIEVED_FORCE * rng.standard_normal(len(plan.presses)))
    place = np.stack([plan.column("arc_m"), plan.column("along_m")])
    place = place + PLACED_M * rng.standard_normal(place.shape)
    force = achieved[line.near] * line.part
    sphere = np.array([SPHERES_M.index(press.sphere_m) for press in plan.presses])
    touches = Touches(force, place[0][line.near], place[1][line.near], sphere[line.near])
    shear = plan.shear_share[line.near] * force[:, None]
    return Scene(body, plan, line, touches, shear, _temperature(rng, line.time_s))


def _temperature(rng: np.random.Generator, time_s: Floats) -> Floats:
    """A room that warms by a degree or two, and wanders."""
    share = time_s / time_s[-1]
    waves = sum(
        rng.uniform(0.05, 0.25) * np.sin(2 * np.pi * (share * rng.uniform(1, 4) + rng.uniform()))
        for _ in range(3)
    )
    return 24.0 + rng.uniform(0, 0.6) + rng.uniform(1.0, 2.5) * share ** rng.uniform(0.8, 1.6) + waves


def _told_temperature(scene: Scene, order: Ints) -> Floats:
    """Return the recorded temperature (N,): the true one, unless covariates are shuffled between presses."""
    if np.array_equal(order, np.arange(len(order))):
        return scene.temperature_c
    of_press = np.array([scene.temperature_c[rows].mean() for rows in scene.by_press])
    return of_press[order][scene.line.near]


def _effects(rng: np.random.Generator, spec: Spec, scene: Scene) -> tuple[list[Effect], list[float]]:
    wanted = [(EFFECTS[name].draw(rng), g) for name, g in spec.effects]
    if spec.outside is not None:
        kind, g = spec.outside
        wanted.append((OUTSIDE[kind].draw(rng), g))
    broken = fault(rng, spec.decoy)
    if not wanted and broken is None:
        return [], []
    refit = Refit.of(scene)
    found = [of_strength(effect, refit, g) for effect, g in wanted]
    if broken is not None:
        found.append((broken, refit.strength(broken)))
    return [effect for effect, _ in found], [g for _, g in found]


def _measured(rng: np.random.Generator, scene: Scene, effects: Sequence[Effect]) -> Floats:
    """Draw the reported positions (K, 2); an error beyond the slack is drawn anew."""
    body = scene.body
    first = np.array([rows[0] for rows in scene.by_press])
    true = np.column_stack([scene.touches.arc_m[first], scene.touches.along_m[first]])
    error = body.sigma_m * rng.standard_normal(true.shape)
    bound = 0.95 * SLACK_M - np.abs(np.array(body.constant_m))
    while (beyond := np.abs(error) > bound).any():
        error[beyond] = body.sigma_m * rng.standard_normal(int(beyond.sum()))
    return true + error + np.array(body.constant_m) + sum(e.reported(scene) for e in effects)


def _force_errors(rng: np.random.Generator, scene: Scene) -> Floats:
    return scene.of_press(1 + FORCE_ERROR * rng.standard_normal(len(scene.plan.presses)))


def _noise(rng: np.random.Generator, scene: Scene, size: float, columns: int = 0) -> Floats:
    count = len(scene.line.time_s)
    return size * rng.standard_normal((count, columns) if columns else count)


def _label(
    spec: Spec, session: Session, clean: Floats, effects: Sequence[Effect], strengths: Sequence[float]
) -> dict[str, Any]:
    body = session.scene.body
    return {
        "session": spec.name,
        "suite": spec.suite,
        "contact_law": body.images.law.name,
        "layer": asdict(body.images.law),
        "protocol": spec.protocol,
        "truth": body.plain(),
        "constant_position_error_m": dict(zip(("arc", "y"), body.constant_m, strict=True)),
        "truth_as_the_positions_tell_it": body.as_positions_tell(),
        "expected": "unknown"
        if spec.outside
        else "effects"
        if max(strengths, default=0) > NOTHING_G
        else "none",
        "decoy": spec.decoy,
        "also_fine": list(ALSO_FINE.get(spec.decoy or "", ())),
        "outside": spec.outside[0] if spec.outside else None,
        "effects": [
            {"name": effect.name, "strength_g": g, "parameters": dict(effect.plain())}
            for effect, g in zip(effects, strengths, strict=True)
        ],
        "rest_counts": spec.rest_counts,
        "step_counts": spec.step_counts,
        "noise_grows": spec.noise_grows,
        "noise_floor_rmse_counts": _floor(session, clean, spec.rest_counts),
    }


def _floor(session: Session, clean: Floats, rest: float) -> dict[str, float]:
    """Return the residual of the best model: RMS of readings minus their mean."""
    scene = session.scene
    left = session.reading - shown(clean + rest, scene.body.noise_counts, rest)
    return {
        "frame_rmse": _rms(left[scene.touching]),
        "all_frames_rmse": _rms(left),
        "hold_mean_rmse": _rms(session.of_holds(left)),
    }


def _rms(values: Floats) -> float:
    return float(np.sqrt(np.mean(values**2)))
