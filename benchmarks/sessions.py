"""Synthetic sessions like the paper's, each with its truth: what the fit is judged on and the sample data are made of.

A session follows the paper's protocol (Kasolowsky & Baeuml, IROS 2024, section III): 60 places drawn from a grid of
1 mm over the patch, each pressed once with 1 to 4 N by a sphere of 6 mm; the sensor's pose is not quite the nominal
one. What is then read is spoiled as on a real rig: measured positions are off at random and by a constant, forces by
half a percent, and a hold is the mean of 25 frames that are noisy, rounded and clipped.

The images follow either skincal's own law, the elastic foundation, or that of an elastic layer
(:mod:`skincal.inference.elastic_layer`), which the fit does not know.
"""

from __future__ import annotations

from dataclasses import dataclass, fields, replace
from datetime import UTC, datetime
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from skincal.dataset import (
    Dataset,
    DatasetMeta,
    IndenterSpec,
    MountSpec,
    PositionSpec,
    Presses,
    SensorSpec,
    SurfaceSpec,
)
from skincal.inference.elastic_layer import Layer, Press
from skincal.model import (
    Contacts,
    Converter,
    Cylinder,
    Patch,
    SensorPose,
    Skin,
    SkinParameters,
    Sphere,
    TaxelLayout,
)

Floats = NDArray[np.float64]
Law = Literal["foundation", "layer"]

CYLINDER_RADIUS_M, SPHERE_RADIUS_M = 0.0115, 0.006
TAXEL_M, PITCH_M, TAXELS = 0.0025, 0.004, 4
Y_M, Y_RANGE_M = 0.0235, (0.0195, 0.0275)
BETA_RANGE_DEG, ALPHA_RANGE_DEG = (-12.0, 12.0), (-20.0, 20.0)
SLACK_M, SIGMA_M = 0.002, 0.001
GRID_M, GRID_HALF = 1e-3, 7
FORCES_N, FORCE_ERROR = (1.0, 4.0), 0.005
CONSTANT_ERROR_M = 0.4e-3
FRAMES, FRAME_NOISE = 25, 1.0
CREATED = datetime(2026, 11, 20, 12, tzinfo=UTC)

RESOLUTION_M = 0.1e-3
"""Of the tactile points that a foundation is summed over: a skin is continuous, and with the 0.25 mm that simulation
affords the sum is off by about as much as the noise of a hold mean."""

SUBDIVISIONS = 25
"""Points a side that the pressure of a layer is summed at over a taxel."""


@dataclass(frozen=True)
class LayerRanges:
    """Uniform bounds of a layer: thickness h [m] and Poisson's ratio nu, low and high."""

    thickness_m: tuple[float, float] = (1e-3, 2.5e-3)
    poisson: tuple[float, float] = (0.3, 0.45)


@dataclass(frozen=True)
class Truth:
    """Truth of a session.

    Attributes:
        law: of the contact.
        y_m: position of the sensor's centre along the axis [m].
        beta_deg: the same round it [°].
        alpha_deg: turn [°].
        elasticity_pa_per_m: E [Pa/m]; of a layer, which is no foundation, M/h, its stiffness under even pressure.
        scale_per_n: S [1/N].
        position_sigma_m: random error of measured positions along each direction [m].
        constant_arc_m: constant error of measured positions round the surface [m].
        constant_y_m: the same along the axis [m].
        thickness_m: h of the layer [m]; None for the foundation.
        poisson: nu of the layer; None for the foundation.
    """

    law: Law
    y_m: float
    beta_deg: float
    alpha_deg: float
    elasticity_pa_per_m: float
    scale_per_n: float
    position_sigma_m: float
    constant_arc_m: float
    constant_y_m: float
    thickness_m: float | None = None
    poisson: float | None = None

    @property
    def as_positions_tell(self) -> Truth:
        """The same session with the constant error moved into the pose: all that a fit can find."""
        turn = float(np.degrees(self.constant_arc_m / CYLINDER_RADIUS_M))
        y, beta = self.y_m + self.constant_y_m, self.beta_deg + turn
        return replace(self, y_m=y, beta_deg=beta, constant_y_m=0.0, constant_arc_m=0.0)

    def plain(self) -> dict[str, Any]:
        """Return the fields that have a value, by name."""
        return {f.name: getattr(self, f.name) for f in fields(self) if getattr(self, f.name) is not None}


def make_session(
    rng: np.random.Generator,
    law: Law = "foundation",
    presses: int = 60,
    *,
    position_sigma_m: float | tuple[float, float] = (0.5e-3, 1e-3),
    layers: LayerRanges | None = None,
    resolution_m: float = RESOLUTION_M,
    source: str = "",
) -> tuple[Dataset, Truth]:
    """A session and its truth.

    Args:
        rng: the only source of chance; the same state gives the same session.
        law: of the contact.
        presses: how many, at most 225: no place of the grid is pressed twice.
        position_sigma_m: random error of measured positions along each direction [m], or low and high to draw it
            from. An error that would, with the constant one, go beyond the slack is drawn anew.
        layers: what a layer is drawn from; None for the default ranges.
        resolution_m: distance of the tactile points that a foundation is summed over [m].
        source: for ``dataset.toml``.

    Returns:
        The session, and what it was made with.

    Raises:
        ValueError: more presses than the grid has places.
    """
    truth = _draw_truth(rng, law, position_sigma_m, layers or LayerRanges())
    arc, y = _places(rng, presses)
    force = rng.uniform(*FORCES_N, presses)
    measured_arc = (
        arc + truth.constant_arc_m + _errors(rng, truth.position_sigma_m, truth.constant_arc_m, presses)
    )
    measured_y = y + truth.constant_y_m + _errors(rng, truth.position_sigma_m, truth.constant_y_m, presses)
    measured_force = force * (1 + FORCE_ERROR * rng.standard_normal(presses))
    values = truth.scale_per_n * taxel_loads(truth, arc, y, force, resolution_m)
    table = Presses(
        np.arange(presses),
        np.round(_on_cylinder(measured_arc, measured_y), 7),
        np.round(measured_force, 5),
        hold_means(rng, values),
    )
    return Dataset(_meta(source or f"skincal's benchmark sessions, {law} law"), table), truth


def taxel_loads(
    truth: Truth, arc_m: Floats, y_m: Floats, force_n: Floats, resolution_m: float = RESOLUTION_M
) -> Floats:
    """Loads (K, J) [N] of presses at true places round and along the finger (K,) [m], with forces (K,) [N]."""
    if truth.law == "foundation":
        pose = SensorPose(truth.y_m, float(np.radians(truth.alpha_deg)), float(np.radians(truth.beta_deg)))
        surface = Cylinder(CYLINDER_RADIUS_M)
        patch = Patch.build(surface, layout(), pose, resolution_m=resolution_m)
        skin = Skin(patch, SkinParameters(truth.elasticity_pa_per_m, 1.0), Converter.none())
        points = _on_cylinder(arc_m, y_m)
        return skin.loads(Sphere(SPHERE_RADIUS_M), Contacts(points, surface.normal_at(points), force_n))
    return _layer_loads(truth, arc_m, y_m, force_n)


def _layer_loads(truth: Truth, arc_m: Floats, y_m: Floats, force_n: Floats) -> Floats:
    assert truth.thickness_m is not None and truth.poisson is not None
    layer = Layer.of_stiffness(truth.elasticity_pa_per_m, truth.thickness_m, truth.poisson)
    found = Press(CYLINDER_RADIUS_M, SPHERE_RADIUS_M).fields(layer, force_n)
    side = (np.arange(SUBDIVISIONS) + 0.5) / SUBDIVISIONS - 0.5
    within = np.stack(np.meshgrid(side, side), axis=-1).reshape(-1, 2) * TAXEL_M
    c, r = (a.ravel() - (TAXELS - 1) / 2 for a in np.meshgrid(np.arange(TAXELS), np.arange(TAXELS)))
    u, v = np.moveaxis(np.column_stack([c, r])[:, None] * PITCH_M + within, -1, 0)
    cos, sin = np.cos(np.radians(truth.alpha_deg)), np.sin(np.radians(truth.alpha_deg))
    arc = np.radians(truth.beta_deg) * CYLINDER_RADIUS_M + u * cos - v * sin
    along = truth.y_m + u * sin + v * cos
    area = (TAXEL_M / SUBDIVISIONS) ** 2
    return np.stack(
        [f.felt_at(arc - s, along - t).sum(axis=1) * area for f, s, t in zip(found, arc_m, y_m, strict=True)]
    )


def hold_means(rng: np.random.Generator, values: Floats) -> Floats:
    """Means of the frames of a hold (K, J) with two decimals, for values (K, J) of any sign [counts]."""
    noisy = values + FRAME_NOISE * rng.standard_normal((FRAMES, *values.shape))
    return np.round(np.clip(np.rint(noisy), 0, 255).mean(axis=0), 2)


def layout() -> TaxelLayout:
    """The paper's taxels."""
    return TaxelLayout.grid(TAXELS, TAXELS, taxel_size_m=TAXEL_M, pitch_m=PITCH_M)


def _draw_truth(
    rng: np.random.Generator, law: Law, sigma_m: float | tuple[float, float], layers: LayerRanges
) -> Truth:
    low, high = np.broadcast_to(np.asarray(sigma_m, dtype=np.float64), (2,))
    truth = {
        "y_m": rng.uniform(22.5e-3, 25e-3),
        "beta_deg": rng.uniform(0.0, 5.0),
        "alpha_deg": rng.uniform(-12.0, 8.0),
        "elasticity_pa_per_m": float(np.exp(rng.uniform(*np.log([250e6, 800e6])))),
        "scale_per_n": rng.uniform(61.0, 76.0),
        "position_sigma_m": rng.uniform(low, high),
        "constant_arc_m": rng.uniform(-CONSTANT_ERROR_M, CONSTANT_ERROR_M),
        "constant_y_m": rng.uniform(-CONSTANT_ERROR_M, CONSTANT_ERROR_M),
    }
    if law == "layer":
        truth |= {"thickness_m": rng.uniform(*layers.thickness_m), "poisson": rng.uniform(*layers.poisson)}
    return Truth(law, **truth)


def _places(rng: np.random.Generator, count: int) -> tuple[Floats, Floats]:
    """Places (K,) round and along the finger [m], on a grid over the patch where it nominally lies."""
    steps = np.arange(-GRID_HALF, GRID_HALF + 1, dtype=np.float64) * GRID_M
    if count > len(steps) ** 2:
        raise ValueError(f"presses: expected at most {len(steps) ** 2}, the places of the grid; got {count}")
    chosen = rng.choice(len(steps) ** 2, count, replace=False)
    return steps[chosen % len(steps)], Y_M + steps[chosen // len(steps)]


def _errors(rng: np.random.Generator, sigma_m: float, constant_m: float, count: int) -> Floats:
    """Random errors (K,) [m], as far to one side as to the other: the constant error stays their mean."""
    bound = SLACK_M - abs(constant_m)
    errors = sigma_m * rng.standard_normal(count)
    while (beyond := np.abs(errors) > bound).any():
        errors[beyond] = sigma_m * rng.standard_normal(int(beyond.sum()))
    return errors


def _on_cylinder(arc_m: Floats, y_m: Floats) -> Floats:
    turn = arc_m / CYLINDER_RADIUS_M
    return np.column_stack([CYLINDER_RADIUS_M * np.sin(turn), y_m, CYLINDER_RADIUS_M * np.cos(turn)])


def _meta(source: str) -> DatasetMeta:
    side, pitch = (TAXEL_M, TAXEL_M), (PITCH_M, PITCH_M)
    return DatasetMeta(
        SensorSpec(TAXELS, TAXELS, side, pitch, value_min=0, value_max=255, integer=True),
        SurfaceSpec("cylinder", CYLINDER_RADIUS_M),
        IndenterSpec("sphere", SPHERE_RADIUS_M),
        MountSpec(Y_M, 0.0, Y_RANGE_M, ALPHA_RANGE_DEG, beta_deg=0.0, beta_range_deg=BETA_RANGE_DEG),
        PositionSpec(SIGMA_M, SLACK_M),
        created=CREATED,
        source=source,
    )
