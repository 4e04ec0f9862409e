"""A calibration in memory, and the model objects that it describes."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Self

import numpy as np
from numpy.typing import NDArray

from skincal.calibration.parts import Effect, Finding, FittedLaw, Interval, Loss, ModelParameters, Provenance
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
from skincal.errors import Problem, WorkError
from skincal.model import Converter, Indenter, Patch, SensorPose, Skin, SkinParameters, Surface, TaxelLayout
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
                frozen = {key: _read_only(column) for key, column in columns.items()}
                object.__setattr__(self, name, frozen)

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


def _read_only(column: NDArray[Any]) -> NDArray[Any]:
    """Return a read-only view; the caller's own array stays writable."""
    view = np.asarray(column).view()
    view.flags.writeable = False
    return view
