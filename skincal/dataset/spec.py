"""What ``dataset.toml`` says, as frozen objects: sensor, surface, indenter, mount, position, force, clock."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from datetime import date, datetime
from typing import Any, Literal

FORMAT = "skincal-dataset/1"

SurfaceKind = Literal["cylinder", "plane", "mesh"]
IndenterKind = Literal["sphere", "flat", "mesh"]
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
        value_min: where the converter clips below [counts]; None: not known.
        value_max: where the converter clips above [counts]; None: not known.
        integer: whether the converter gives whole numbers.
        unit: what a taxel value is, for labels (``V``, ``kPa``, ``uT``); None: counts.
        baseline: whether the level at rest has been taken off the counts.
        positions: file with the taxels' positions, for a layout that is no grid.
        extra: keys that skincal does not know.
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
        """What a taxel value is, for labels."""
        return self.unit or "counts"

    @property
    def taxels(self) -> int:
        """Number of taxels J."""
        return self.rows * self.cols

    def taxel_columns(self) -> tuple[str, ...]:
        """Return the names of the taxel columns in the order of the flat index ``j = r * cols + c``."""
        return tuple(f"taxel_{r}_{c}" for r in range(self.rows) for c in range(self.cols))


@dataclass(frozen=True)
class SurfaceSpec:
    """The surface that carries the sensor: a cylinder (radius [m]), the plane z = 0 or a mesh (file)."""

    kind: SurfaceKind
    radius_m: float | None = None
    file: str | None = None
    extra: Mapping[str, Any] = field(default_factory=dict)


@dataclass(frozen=True)
class IndenterSpec:
    """What presses: a sphere or a flat punch (radius [m]), or a mesh (file)."""

    kind: IndenterKind
    radius_m: float | None = None
    file: str | None = None
    extra: Mapping[str, Any] = field(default_factory=dict)


@dataclass(frozen=True)
class MountSpec:
    """What is known of the sensor's pose before the fit: nominal values, and the ranges to search.

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
    """What the measured contact positions are worth.

    Attributes:
        sigma_m: standard deviation [m]; inf: nothing is known of them.
        slack_m: bound of the slack that the fit may give to a press [m].
        extra: keys that skincal does not know.
    """

    sigma_m: float
    slack_m: float
    extra: Mapping[str, Any] = field(default_factory=dict)


@dataclass(frozen=True)
class ForceSpec:
    """What the scale of the measured forces is worth.

    Attributes:
        scale_sigma: relative standard deviation of an error that all forces of the session share.
        extra: keys that skincal does not know.
    """

    scale_sigma: float = 0.0
    extra: Mapping[str, Any] = field(default_factory=dict)


@dataclass(frozen=True)
class ClockSpec:
    """How well the clocks of force and taxels are known to agree: standard deviation [s]."""

    sigma_s: float = 0.0
    extra: Mapping[str, Any] = field(default_factory=dict)


@dataclass(frozen=True)
class DatasetMeta:
    """All of ``dataset.toml``.

    Attributes:
        sensor: taxels and converter.
        surface: what carries the sensor.
        indenter: what presses.
        mount: the sensor's nominal pose and the ranges to search.
        position: what the contact positions are worth.
        force: what the scale of the forces is worth; None: not known, taken as exact.
        clock: how well the clocks agree; None: not known.
        created: when the data were taken; None: not said.
        source: free text.
        assumed: what was not measured but assumed.
        extra: keys that skincal does not know.
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
