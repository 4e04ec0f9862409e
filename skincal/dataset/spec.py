"""The content of ``dataset.toml`` as frozen objects: sensor, surface, indenter, mount, position, force, clock."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from datetime import date, datetime
from typing import Any, Literal

from skincal.dataset.kinds import SURFACES

FORMAT = "skincal-dataset/1"

Baseline = Literal["raw", "subtracted"]
Pair = tuple[float, float]


@dataclass(frozen=True)
class SensorSpec:
    """The taxels and their converter.

    Attributes:
        rows: number of rows; ``r`` grows with ``v``.
        cols: number of columns; ``c`` grows with ``u``.
        taxel_size_m: extent of a taxel along ``(u, v)`` [m]; None where ``positions`` gives it.
        pitch_m: distance of neighbouring centres along ``(u, v)`` [m]; None where ``positions`` gives it.
        value_min: lower clipping point of the converter [counts]; None: unknown.
        value_max: upper clipping point of the converter [counts]; None: unknown.
        integer: whether the converter gives whole numbers.
        unit: unit of a taxel value, for labels (``V``, ``kPa``, ``uT``); None: counts.
        baseline: whether the level at rest has been subtracted from the counts.
        positions: file with the taxels' positions, for a layout without a grid.
        extra: unknown keys.
    """

    rows: int
    cols: int
    taxel_size_m: Pair | None = None
    pitch_m: Pair | None = None
    value_min: float | None = None
    value_max: float | None = None
    integer: bool = False
    baseline: Baseline = "raw"
    positions: str | None = None
    extra: Mapping[str, Any] = field(default_factory=dict)
    unit: str | None = None

    @property
    def unit_label(self) -> str:
        """Unit of a taxel value, for labels."""
        return self.unit or "counts"

    @property
    def taxels(self) -> int:
        """Number of taxels J."""
        return self.rows * self.cols

    def taxel_columns(self) -> tuple[str, ...]:
        """Names of the taxel columns in the order of the flat index ``j = r * cols + c``."""
        return tuple(f"taxel_{r}_{c}" for r in range(self.rows) for c in range(self.cols))


@dataclass(frozen=True)
class _Shape:
    """A kind, with its radius [m] or its mesh file; '' for a kind that could not be read."""

    kind: str
    radius_m: float | None = None
    file: str | None = None
    extra: Mapping[str, Any] = field(default_factory=dict)


class SurfaceSpec(_Shape):
    """The surface that carries the sensor: a kind of ``skincal.dataset.kinds``."""

    @property
    def is_plane(self) -> bool:
        """Return whether the sensor's position is ``x_m``, ``y_m`` instead of ``beta_deg``, ``y_m``."""
        return self.kind in SURFACES and SURFACES[self.kind].plane

    @property
    def across(self) -> str:
        """Key of the sensor's position across: ``beta_deg``, on a plane ``x_m``."""
        return "x_m" if self.is_plane else "beta_deg"


class IndenterSpec(_Shape):
    """The indenter: a kind of ``skincal.dataset.kinds``."""


@dataclass(frozen=True)
class MountSpec:
    """Prior knowledge of the sensor's pose: nominal values and the ranges to search.

    On a cylinder and a mesh the centre is ``(y_m, beta_deg)``, on a plane ``(x_m, y_m)``; the other is None.
    """

    y_m: float
    alpha_deg: float
    y_range_m: Pair
    alpha_range_deg: Pair
    beta_deg: float | None = None
    beta_range_deg: Pair | None = None
    x_m: float | None = None
    x_range_m: Pair | None = None
    extra: Mapping[str, Any] = field(default_factory=dict)


@dataclass(frozen=True)
class PositionSpec:
    """Accuracy of the measured contact positions.

    Attributes:
        sigma_m: standard deviation [m]; inf: the positions are unknown.
        slack_m: bound of the shift that the fit may give to a press [m].
        extra: keys that skincal does not know.
    """

    sigma_m: float
    slack_m: float
    extra: Mapping[str, Any] = field(default_factory=dict)


@dataclass(frozen=True)
class ForceSpec:
    """Accuracy of the scale of the measured forces.

    Attributes:
        scale_sigma: relative standard deviation of an error that all forces of the session share.
        extra: keys that skincal does not know.
    """

    scale_sigma: float = 0.0
    extra: Mapping[str, Any] = field(default_factory=dict)


@dataclass(frozen=True)
class ClockSpec:
    """Agreement of the clocks of force and taxels: standard deviation [s]."""

    sigma_s: float = 0.0
    extra: Mapping[str, Any] = field(default_factory=dict)


@dataclass(frozen=True)
class DatasetMeta:
    """The content of ``dataset.toml``.

    Attributes:
        sensor: taxels and converter.
        surface: surface that carries the sensor.
        indenter: the indenter.
        mount: the sensor's nominal pose and the ranges to search.
        position: accuracy of the contact positions.
        force: accuracy of the force scale; None: unknown, taken as exact.
        clock: agreement of the clocks; None: unknown.
        created: date of the recording; None: not given.
        source: free text.
        assumed: names of the quantities that were assumed, not measured.
        extra: unknown keys.
    """

    sensor: SensorSpec
    surface: SurfaceSpec
    indenter: IndenterSpec
    mount: MountSpec
    position: PositionSpec
    force: ForceSpec | None = None
    clock: ClockSpec | None = None
    created: datetime | date | None = None
    source: str = ""
    assumed: tuple[str, ...] = ()
    extra: Mapping[str, Any] = field(default_factory=dict)
