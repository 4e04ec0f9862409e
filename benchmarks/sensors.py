"""Synthetic sessions of many kinds of sensors, by code that shares nothing with skincal's model, each with its truth.

:mod:`benchmarks.sessions` makes sessions like the paper's. Here the sensor varies: where it rests and whether the
converter clips there, its noise and rounding, its layout and surface, how much its taxels differ, and the way in which
measured positions err. Pressures are summed point by point over each taxel from closed formulas of a rigid sphere on
an elastic foundation; nothing is tabled, and no function of :mod:`skincal.model` or :mod:`skincal.fitting` is used.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from datetime import UTC, datetime

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
    TaxelPositions,
)

Floats = NDArray[np.float64]

SPHERE_M = 0.006
CREATED = datetime(2026, 11, 20, 12, tzinfo=UTC)
POINTS = 25
"""Points along each side of a taxel at which pressure is summed."""


@dataclass(frozen=True)
class Kind:
    """A kind of sensor and rig.

    Attributes:
        rest_counts: level at rest that all taxels share.
        rest_spread_counts: standard deviation of each taxel's own level about it.
        clip: whether the converter clips at 0.
        subtracted: whether the level at rest is taken off before the session is stored.
        integer: whether counts are whole numbers.
        noise_counts: noise of one frame.
        frames: frames in the mean of a hold.
        gain_spread: relative standard deviation of the taxels' scales.
        rows: of taxels.
        cols: of taxels.
        hexagonal: every second row is moved by half a pitch.
        radius_m: of the fingertip; None for a plane.
        presses: in the session.
        position_sigma_m: independent error of measured positions, one sigma.
        constant_m: bound of an error that all presses share.
        smooth_m: standard deviation of an error that changes smoothly over the patch.
        declared_m: what the session says of the error of its positions.
        slack_m: bound of the errors.
        declared_slack_m: bound of the slack that it declares; None for that of the errors.
        force_error: relative error of measured forces.
        step_counts: readings are whole multiples of this.
        loaded_noise: how much the noise of a frame grows with each count of signal.
        dropped: part of the readings that come as 0.
        unit: what a count is multiplied by before it is stored, as for a sensor in volts.
        scale_per_n: low and high of S [counts/N].
    """

    rest_counts: float = 0.0
    rest_spread_counts: float = 0.0
    clip: bool = True
    subtracted: bool = False
    integer: bool = True
    noise_counts: float = 1.0
    frames: int = 1
    gain_spread: float = 0.0
    rows: int = 4
    cols: int = 4
    hexagonal: bool = False
    radius_m: float | None = 0.0115
    presses: int = 60
    position_sigma_m: float = 0.5e-3
    constant_m: float = 0.0
    smooth_m: float = 0.0
    declared_m: float = 1e-3
    slack_m: float = 2e-3
    declared_slack_m: float | None = None
    force_error: float = 0.003
    step_counts: float = 1.0
    loaded_noise: float = 0.0
    dropped: float = 0.0
    unit: float = 1.0
    scale_per_n: tuple[float, float] = (50.0, 75.0)


UNCLIPPED = Kind(rest_counts=20.0, clip=False)
KINDS: dict[str, Kind] = {
    "clip": Kind(),
    "clip-means": Kind(frames=25),
    "rest20": UNCLIPPED,
    "rest40-means": Kind(rest_counts=40.0, clip=False, frames=25),
    "rest600": Kind(rest_counts=600.0, rest_spread_counts=20.0, clip=False),
    "subtracted": Kind(rest_counts=30.0, clip=False, subtracted=True),
    "float": Kind(rest_counts=20.0, clip=False, integer=False, noise_counts=0.3),
    "noise-free": Kind(rest_counts=20.0, clip=False, integer=False, noise_counts=0.0),
    "noise-free-whole": Kind(rest_counts=20.0, clip=False, noise_counts=0.0),
    "noise5": Kind(rest_counts=40.0, clip=False, noise_counts=5.0, scale_per_n=(100.0, 150.0)),
    "gains5": Kind(rest_counts=20.0, clip=False, gain_spread=0.05),
    "3x3": Kind(rest_counts=20.0, clip=False, rows=3, cols=3),
    "6x8": Kind(rest_counts=20.0, clip=False, rows=6, cols=8),
    "8x8": Kind(rest_counts=20.0, clip=False, rows=8, cols=8, radius_m=None),
    "hexagon": Kind(rest_counts=20.0, clip=False, hexagonal=True, rows=5, cols=4),
    "plane": Kind(rest_counts=20.0, clip=False, radius_m=None),
    "volts": Kind(rest_counts=300.0, clip=False, subtracted=True, integer=False, unit=1e-3),
    "smooth": Kind(rest_counts=20.0, clip=False, position_sigma_m=0.3e-3, smooth_m=0.3e-3, constant_m=0.4e-3),
    "steps8": Kind(rest_counts=40.0, clip=False, step_counts=8.0),
    "noise-under-load": Kind(rest_counts=20.0, clip=False, loaded_noise=0.03),
    "drop-outs": Kind(rest_counts=20.0, clip=False, dropped=0.01),
    "constant": Kind(rest_counts=20.0, clip=False, constant_m=1.5e-3, slack_m=4e-3, declared_slack_m=1.2e-3),
}


@dataclass(frozen=True)
class Truth:
    """Truth of a session, with the pose as its positions measure it.

    Attributes:
        across_m: centre round the surface (arc), or x on a plane, with the mean error of positions in it [m].
        y_m: centre along the axis, likewise [m].
        alpha_rad: turn [rad].
        elasticity_pa_per_m: E [Pa/m].
        scale_per_n: S in the session's unit [1/N].
        rest: level of each taxel in the session's unit (J,).
    """

    across_m: float
    y_m: float
    alpha_rad: float
    elasticity_pa_per_m: float
    scale_per_n: float
    rest: Floats = field(repr=False)

    def values(self) -> dict[str, float]:
        """The parameters by the names of the fit."""
        names = ("across_m", "y_m", "alpha_rad", "elasticity_pa_per_m", "scale_per_n")
        return {name: float(getattr(self, name)) for name in names}


def make(rng: np.random.Generator, kind: Kind) -> tuple[Dataset, Truth]:
    """A session of a kind of sensor, and its truth.

    Args:
        rng: the only source of chance.
        kind: of the sensor and the rig.
    """
    pitch, size = 4e-3, 2.5e-3
    centres = _centres(kind, pitch)
    half = np.abs(centres).max(axis=0) + pitch / 2
    y0 = 0.0235 if kind.radius_m else 0.03
    across, along = rng.uniform(-1e-3, 1e-3), y0 + rng.uniform(-1e-3, 1e-3)
    alpha = np.radians(rng.uniform(-10.0, 10.0))
    stiffness = float(np.exp(rng.uniform(*np.log([3e8, 8e8]))))
    scale = rng.uniform(*kind.scale_per_n) * kind.unit
    arc = rng.uniform(-half[0], half[0], kind.presses)
    y = y0 + rng.uniform(-half[1], half[1], kind.presses)
    force = rng.uniform(1.0, 4.5, kind.presses)
    gains = np.exp(kind.gain_spread * rng.standard_normal(len(centres)))
    loads = taxel_loads(kind.radius_m, stiffness, centres, size, (across, along, alpha), arc, y, force)
    rest = (
        kind.rest_counts + kind.rest_spread_counts * rng.standard_normal(len(centres))
    ) * kind.unit  # of each taxel
    counts = _hold_means(rng, kind, scale * gains * loads, rest)
    error = _position_errors(rng, kind, arc, y - y0, half)
    table = Presses(
        np.arange(kind.presses),
        _points(kind.radius_m, arc + error[0], y + error[1]),
        force * (1 + kind.force_error * rng.standard_normal(kind.presses)),
        counts,
    )
    told = Truth(across + error[0].mean(), along + error[1].mean(), alpha, stiffness, scale, rest)
    return Dataset(
        _meta(kind, centres, size, pitch, y0), table, positions=_positions(kind, centres, size)
    ), told


def taxel_loads(
    radius_m: float | None,
    elasticity_pa_per_m: float,
    centres_m: Floats,
    size_m: float,
    pose: tuple[float, float, float],
    arc_m: Floats,
    y_m: Floats,
    force_n: Floats,
) -> Floats:
    """Loads (K, J) [N] of square taxels under a rigid sphere on an elastic foundation.

    Args:
        radius_m: of the cylinder; None for a plane.
        elasticity_pa_per_m: E.
        centres_m: (J, 2) of the taxels in patch coordinates.
        size_m: edge of a taxel.
        pose: centre of the patch across and along [m], turn [rad].
        arc_m: (K,) contacts round the surface.
        y_m: (K,) contacts along it.
        force_n: (K,) normal forces.
    """
    depth = _depths(radius_m, force_n / elasticity_pa_per_m)
    cos, sin = np.cos(pose[2]), np.sin(pose[2])
    side = ((np.arange(POINTS) + 0.5) / POINTS - 0.5) * size_m
    within = np.stack(np.meshgrid(side, side), axis=-1).reshape(-1, 2)
    uv = centres_m[:, None] + within
    s = pose[0] + uv[..., 0] * cos - uv[..., 1] * sin
    t = pose[1] + uv[..., 0] * sin + uv[..., 1] * cos
    area = (size_m / POINTS) ** 2
    out = np.zeros((len(arc_m), len(centres_m)))
    for k in range(len(arc_m)):
        gap, onto_normal, onto_skin = _gap(radius_m, s - arc_m[k], t - y_m[k])
        pressure = np.maximum(depth[k] - gap, 0.0) * onto_normal * onto_skin
        out[k] = elasticity_pa_per_m * area * pressure.sum(axis=1)
    return out


def _gap(radius_m: float | None, s: Floats, t: Floats) -> tuple[Floats, Floats, Floats]:
    """Gap under a sphere that just touches, cosine of the skin's normal, cosine of the sphere's."""
    turn = np.zeros_like(s) if radius_m is None else s / radius_m
    x = s if radius_m is None else radius_m * np.sin(turn)
    drop = np.zeros_like(s) if radius_m is None else radius_m * (1 - np.cos(turn))
    square = SPHERE_M**2 - x**2 - t**2
    root = np.sqrt(np.maximum(square, 0.0))
    gap = np.where((square > 0) & (np.abs(turn) < np.pi / 2), SPHERE_M - root + drop, np.inf)
    return gap, np.maximum(np.cos(turn), 0.0), root / SPHERE_M


def _depths(radius_m: float | None, ratio_m3: Floats) -> Floats:
    """Penetrations (K,) [m] that balance F / E (K,) [m³], by tabling the balance finely."""
    step = 0.02e-3
    axis = np.arange(-4e-3, 4e-3, step) + step / 2
    gap, normal, _ = _gap(radius_m, *np.meshgrid(axis, axis))
    depths = np.linspace(0.0, 1.5e-3, 600)
    held = np.array([(np.maximum(d - gap, 0.0) * normal).sum() * step**2 for d in depths])
    return np.interp(ratio_m3, held, depths)


def _hold_means(rng: np.random.Generator, kind: Kind, signal: Floats, rest: Floats) -> Floats:
    shape = (kind.frames, *signal.shape)
    noise = kind.noise_counts * kind.unit + kind.loaded_noise * signal
    frames = (signal + rest + noise * rng.standard_normal(shape)) / kind.unit
    if kind.integer:
        frames = kind.step_counts * np.rint(frames / kind.step_counts)
    if kind.clip:
        frames = np.clip(frames, 0, None)
    if kind.subtracted:
        frames = frames - (np.rint(rest / kind.unit) if kind.integer else rest / kind.unit)
    if kind.dropped:
        frames = np.where(rng.random(shape) < kind.dropped, 0.0, frames)
    return frames.mean(axis=0) * kind.unit


def _position_errors(
    rng: np.random.Generator, kind: Kind, arc: Floats, along: Floats, half: Floats
) -> tuple[Floats, Floats]:
    """Errors (K,) across and along [m]: independent, constant, and smooth (two waves longer than the patch)."""
    errors = []
    for _ in range(2):
        error = kind.position_sigma_m * rng.standard_normal(len(arc))
        error += rng.uniform(-kind.constant_m, kind.constant_m) if kind.constant_m else 0.0
        for _ in range(2):
            wave = rng.standard_normal(2) / (2 * half.max())
            error += kind.smooth_m * np.sin(wave[0] * arc + wave[1] * along + rng.uniform(0, 2 * np.pi))
        errors.append(np.clip(error, -kind.slack_m, kind.slack_m))
    return errors[0], errors[1]


def _centres(kind: Kind, pitch: float) -> Floats:
    c, r = np.meshgrid(np.arange(kind.cols), np.arange(kind.rows))
    u = (c - (kind.cols - 1) / 2) * pitch
    if kind.hexagonal:
        u = u + np.where(r % 2, pitch / 4, -pitch / 4)
    v = (r - (kind.rows - 1) / 2) * pitch * (np.sqrt(0.75) if kind.hexagonal else 1.0)
    return np.stack([u.ravel(), v.ravel()], axis=1)


def _points(radius_m: float | None, arc: Floats, y: Floats) -> Floats:
    if radius_m is None:
        return np.column_stack([arc, y, np.zeros_like(arc)])
    return np.column_stack([radius_m * np.sin(arc / radius_m), y, radius_m * np.cos(arc / radius_m)])


def _positions(kind: Kind, centres: Floats, size: float) -> TaxelPositions | None:
    if not kind.hexagonal:
        return None
    return TaxelPositions(centres, np.full_like(centres, size))


def _meta(kind: Kind, centres: Floats, size: float, pitch: float, y0: float) -> DatasetMeta:
    sensor = SensorSpec(
        kind.rows,
        kind.cols,
        (size, size),
        (pitch, pitch),
        value_min=0 if kind.clip else None,
        integer=kind.integer,
        baseline="subtracted" if kind.subtracted else "raw",
        positions="taxels.csv" if kind.hexagonal else None,
    )
    across = {"x_m": 0.0, "x_range_m": (-2.5e-3, 2.5e-3)}
    if kind.radius_m:
        across = {"beta_deg": 0.0, "beta_range_deg": (-12.0, 12.0)}
    return DatasetMeta(
        sensor,
        SurfaceSpec("cylinder", kind.radius_m) if kind.radius_m else SurfaceSpec("plane"),
        IndenterSpec("sphere", SPHERE_M),
        MountSpec(y0, 0.0, (y0 - 2.5e-3, y0 + 2.5e-3), (-20.0, 20.0), **across),
        PositionSpec(kind.declared_m, kind.declared_slack_m or kind.slack_m),
        created=CREATED,
        source="skincal's benchmark sensors",
    )
