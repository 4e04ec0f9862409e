"""A calibration in memory, and the model objects that it describes: the skin, with and without its effects."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Self

import numpy as np
from numpy.typing import ArrayLike, NDArray

from skincal.calibration.parts import (
    Effect,
    Finding,
    FittedLaw,
    Interval,
    Loss,
    ModelParameters,
    Numbers,
    Provenance,
)
from skincal.dataset import (
    Dataset,
    IndenterSpec,
    MountSpec,
    PositionSpec,
    SensorSpec,
    SurfaceSpec,
    TaxelPositions,
)
from skincal.dataset.dataset import converter_of, indenter_of, layout_of, surface_of
from skincal.effects import EffectSkin, SkinStream, effect
from skincal.effects.registry import Missing
from skincal.errors import Problem, WorkError
from skincal.model import Converter, Indenter, Patch, SensorPose, Skin, SkinParameters, Surface, TaxelLayout
from skincal.model.arrays import FloatArray, frozen
from skincal.shown import Shown
from skincal.units import rad

MARGIN_M = 8e-3
"""Margin of a calibrated skin around its taxels [m]."""

Columns = Mapping[str, NDArray[Any]]
"""A table: arrays of one length by name."""


@dataclass(frozen=True, eq=False)
class Calibration(Shown):
    """The result of a fit: the best skin, and how far to trust it (contract ``skincal-calibration/1``).

    Attributes:
        sensor: taxels and converter, as in the dataset.
        surface: surface that carries the sensor.
        indenter: the indenter.
        model: best parameters.
        intervals: low and high of each of them, by name; infinite if the data do not bound it.
        loss: quality of the fit.
        provenance: provenance of the calibration.
        effects: effects beyond the base model; empty at first.
        contact_law: how the contact differs from the elastic foundation; None: not at all.
        findings: findings of the fit, for the user.
        mount: prior knowledge of the pose; None: not given.
        position: accuracy of the measured contact positions; None: not given.
        draws: posterior draws, parameters by name, one row per draw; None: none stored.
        grid: the evaluated grid, one row per combination; None: not stored.
        slack: one row per press (:data:`skincal.calibration.SLACK_COLUMNS`); None: not stored.
        positions: positions of taxels that form no grid; None for a grid.
        meshes: content of the mesh files that ``surface`` and ``indenter`` name, by file name.
        extra: unknown keys.
        warnings: warnings about the files it was read from.
        folder: folder it was read from; None for a calibration made in memory.
    """

    sensor: SensorSpec
    surface: SurfaceSpec
    indenter: IndenterSpec
    model: ModelParameters
    intervals: Mapping[str, Interval]
    loss: Loss
    provenance: Provenance
    effects: tuple[Effect, ...] = ()
    contact_law: FittedLaw | None = None
    findings: tuple[Finding, ...] = ()
    mount: MountSpec | None = None
    position: PositionSpec | None = None
    draws: Columns | None = None
    grid: Columns | None = None
    slack: Columns | None = None
    positions: TaxelPositions | None = None
    meshes: Mapping[str, bytes] = field(default_factory=dict[str, bytes])
    extra: Mapping[str, Any] = field(default_factory=dict[str, Any])
    warnings: tuple[Problem, ...] = ()
    folder: Path | None = None

    def __post_init__(self) -> None:
        # Plain dictionaries, not proxies: a calibration is pickled for worker processes.
        object.__setattr__(self, "intervals", dict(self.intervals))
        for name in ("draws", "grid", "slack"):
            columns: Columns | None = getattr(self, name)
            if columns is not None:
                # Views: the caller's own arrays stay writable.
                own = {key: frozen(np.asarray(column).view()) for key, column in columns.items()}
                object.__setattr__(self, name, own)

    def __repr__(self) -> str:
        best = ", ".join(f"{name} {value:.4g}" for name, value in self.model.best().items())
        effects = ", ".join(effect.name for effect in self.effects) or "no effects"
        return f"<Calibration {best}; {effects}>"

    @classmethod
    def of_dataset(
        cls,
        dataset: Dataset,
        *,
        model: ModelParameters,
        intervals: Mapping[str, Interval],
        loss: Loss,
        provenance: Provenance,
        **rest: Any,
    ) -> Self:
        """Return a calibration of the sensor that a dataset describes."""
        meta = dataset.meta
        return cls(
            sensor=meta.sensor,
            surface=meta.surface,
            indenter=meta.indenter,
            mount=meta.mount,
            position=meta.position,
            positions=dataset.positions,
            meshes=dataset.meshes,
            model=model,
            intervals=intervals,
            loss=loss,
            provenance=provenance,
            **rest,
        )

    def pose(self) -> SensorPose:
        """Return the best pose of the patch."""
        model = self.model
        return SensorPose(
            y_m=model.y_m,
            alpha_rad=rad(model.alpha_deg),
            beta_rad=rad(model.beta_deg or 0.0),
            x_m=model.x_m or 0.0,
        )

    def layout(self) -> TaxelLayout:
        """Return the layout of the taxels."""
        return layout_of(self.sensor, self.positions)

    def surface_model(self) -> Surface:
        """Return the surface that carries the sensor."""
        return surface_of(self.surface, self.meshes)

    def indenter_model(self, radius_m: float | None = None) -> Indenter:
        """Return the indenter; a radius [m] overrides that of ``[indenter]``."""
        return indenter_of(self.indenter, self.meshes, radius_m)

    def converter(self) -> Converter:
        """Return the sensor's converter."""
        return converter_of(self.sensor)

    def parameters(self) -> SkinParameters:
        """Return E and the scale of the best skin."""
        scale = self.model.scale_per_taxel_per_n
        return SkinParameters(
            elasticity_pa_per_m=self.model.elasticity_pa_per_m,
            scale_per_n=self.model.scale_per_n if scale is None else np.array(scale),
        )

    def skin(self, resolution_m: float = 0.25e-3, margin_m: float = MARGIN_M) -> Skin:
        """Return the best skin of a calibration without effects; :func:`skincal.calibration.skin_of` accepts any.

        Raises:
            WorkError: the calibration has effects, without which the images would be wrong.
        """
        if self.effects:
            names = ", ".join(effect.name for effect in self.effects)
            raise WorkError(
                f"the calibration has effects beyond the base model: {names}. "
                "Use skincal.calibration.skin_of(calibration), which has them."
            )
        return self.base_skin(resolution_m, margin_m)

    def base_skin(self, resolution_m: float = 0.25e-3, margin_m: float = MARGIN_M) -> Skin:
        """Return the best skin without its effects.

        Raises:
            ValueError: the patch does not fit on its surface.
        """
        patch = Patch.build(self.surface_model(), self.layout(), self.pose(), resolution_m, margin_m)
        law = None if self.contact_law is None else self.contact_law.law
        return Skin(patch, self.parameters(), self.converter(), contact=law)

    def identified(self, name: str) -> bool:
        """Return whether the data bound a parameter on both sides.

        Args:
            name: a key of ``intervals``: ``y_m``, ``elasticity_pa_per_m``.
        """
        return bool(np.isfinite(self.intervals.get(name, (-np.inf, np.inf))).all())


def skin_of(
    calibration: Calibration,
    resolution_m: float = 0.25e-3,
    margin_m: float = MARGIN_M,
    *,
    missing: Missing = "error",
    poses: Sequence[str] | None = None,
) -> EffectSkin:
    """Return the skin of a calibration, with its effects.

    Args:
        calibration: best parameters, and effects beyond the base model.
        resolution_m: longest edge of a tactile point's cell [m].
        margin_m: margin of the skin around the taxels [m].
        missing: policy for a missing covariate: an error, or the effect abstains.
        poses: names of the hand poses that samples number from 0 on; None: those that the calibration names, in its
            order.

    Raises:
        InputError: unknown effects or parameters, or values out of bounds.
        ValueError: the patch does not fit on its surface.
    """
    skin = calibration.base_skin(resolution_m, margin_m)
    return EffectSkin.of(skin, calibration.surface_model(), effects_of(calibration, poses), missing=missing)


def stream_of(
    calibration: Calibration,
    resolution_m: float = 0.25e-3,
    margin_m: float = MARGIN_M,
    *,
    missing: Missing = "error",
    poses: Sequence[str] | None = None,
) -> SkinStream:
    """Return :func:`skin_of` as a stream, for samples that arrive one by one: a simulated hand, an environment."""
    return SkinStream(skin_of(calibration, resolution_m, margin_m, missing=missing, poses=poses))


def effects_of(
    calibration: Calibration, poses: Sequence[str] | None = None
) -> dict[str, dict[str, FloatArray]]:
    """Return parameters by effect, in the form of :meth:`skincal.effects.EffectSkin.with_effects`.

    Args:
        calibration: calibration with or without effects.
        poses: as in :func:`skin_of`. A pose that the calibration does not know gets the neutral value.
    """
    return {
        one.name: {name: _array(one, name, value, poses) for name, value in one.parameters.items()}
        for one in calibration.effects
    }


def _array(one: Effect, name: str, value: Numbers, poses: Sequence[str] | None) -> FloatArray:
    """Return a parameter of an effect as an array, ordered by the given poses if it has one number per pose."""
    array = np.asarray(value, dtype=np.float64)
    parameter = next((p for p in effect(one.name).parameters if p.name == name), None)
    # Without poses the numbers stay as they are: an effect without its covariate abstains.
    if not poses or not one.poses or array.ndim == 0 or parameter is None or parameter.shape != "per-pose":
        return array
    known = dict(zip(one.poses, array.tolist(), strict=True))
    return np.array([known.get(pose, parameter.neutral) for pose in poses], dtype=np.float64)


def effect_from(
    name: str,
    parameters: Mapping[str, ArrayLike],
    intervals: Mapping[str, tuple[ArrayLike, ArrayLike]] | None = None,
    *,
    taxels: int,
    poses: Sequence[str] = (),
) -> Effect:
    """Return an effect of a calibration from the parameters of a skin with effects.

    Args:
        name: name of the effect.
        parameters: numbers, (J,) or (poses,) by parameter.
        intervals: low and high of some of them, of the same shape.
        taxels: number of taxels J.
        poses: names of the hand poses of lists.

    Raises:
        InputError: unknown effects or parameters, or values out of bounds.
    """
    effect(name).checked(parameters, taxels)
    per_pose = any(effect(name).parameter(p).shape == "per-pose" for p in parameters)
    return Effect(
        name,
        {key: _numbers(value) for key, value in parameters.items()},
        {key: (_numbers(low), _numbers(high)) for key, (low, high) in (intervals or {}).items()},
        poses=tuple(poses) if per_pose else (),
    )


def _numbers(value: ArrayLike) -> Numbers:
    """Return a number, or a tuple of numbers."""
    array = np.asarray(value, dtype=np.float64)
    return tuple(float(v) for v in array) if array.ndim else float(array)
