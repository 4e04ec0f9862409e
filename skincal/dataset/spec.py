"""The tables of ``dataset.toml`` as frozen objects: sensor, surface, indenter, mount, position, force, clock."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field, fields
from datetime import date, datetime
from typing import Annotated, Any, ClassVar, Literal

from skincal.bounded import MOST_TAXELS
from skincal.dataset.keys import MILLIMETRES, Key, Length, Range, Size, When, Word
from skincal.dataset.kinds import INDENTERS, SURFACES, Kind, named
from skincal.dataset.schema import Table
from skincal.dataset.schema_errors import Violation, missing, superfluous, within

FORMAT = "skincal-dataset/1"

Baseline = Literal["raw", "subtracted"]
Pair = tuple[float, float]
Count = Annotated[int, Key(f"a whole number, 1 to {MOST_TAXELS}", 1, MOST_TAXELS)]
Angle = Annotated[float, Key("an angle in degrees, within ±180", -180, 180)]
AngleRange = Annotated[Pair, Range("[low, high] in degrees", high=180)]
LengthRange = Annotated[Pair, Range("[low, high] in metres", high=1.0, beyond=MILLIMETRES)]
Centre = Annotated[float, Length("a coordinate of the patch's centre [m]", high=1.0, signed=True)]


@dataclass(frozen=True)
class SensorSpec(Table):
    """The taxels and their converter.

    Attributes:
        rows: number of rows; ``r`` grows with ``v``.
        cols: number of columns; ``c`` grows with ``u``.
        taxel_size_m: extent of a taxel along ``(u, v)`` [m]; None if ``positions`` gives it.
        pitch_m: distance of neighbouring centres along ``(u, v)`` [m]; None if ``positions`` gives it.
        value_min: lower clipping point of the converter [counts]; None: unknown.
        value_max: upper clipping point of the converter [counts]; None: unknown.
        integer: whether the converter gives whole numbers.
        unit: unit of a taxel value, for labels (``V``, ``kPa``, ``uT``); None: counts.
        baseline: whether the level at rest has been subtracted from the counts.
        positions: file with the taxels' positions, for a layout without a grid.
    """

    rows: Count
    cols: Count
    taxel_size_m: Annotated[Pair | None, Size("the side of a taxel [m], or [du, dv]", 2e-5, 0.1)] = None
    pitch_m: Annotated[Pair | None, Size("the distance of taxels [m], or [du, dv]", 2e-5, 0.1)] = None
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

    def violations(self) -> Iterator[Violation]:
        """Yield a missing size, a size that exceeds the pitch, and bounds in the wrong order."""
        if self.taxels > MOST_TAXELS:
            yield "rows", f"at most {MOST_TAXELS} taxels, rows x cols", f"{self.rows} x {self.cols}"
        low, high, size, pitch = self.value_min, self.value_max, self.taxel_size_m, self.pitch_m
        if low is not None and high is not None and low >= high:
            yield "value_max", f"more than value_min = {low:g}", high, "Correct one of them."
        if self.positions is not None:
            return
        if size is None:
            yield missing("taxel_size_m", "the side of a taxel [m], or [du, dv]")
        if pitch is None:
            yield missing("pitch_m", "the distance of taxels [m], or [du, dv]")
        counts = (self.cols, self.rows)
        for axis, count, step, side in zip("uv", counts, pitch or (), size or (), strict=False):
            if count > 1 and side > step * (1 + 1e-9):
                yield "pitch_m", f"at least the taxel's size {side:g} m along {axis}", step, "Taxels overlap."


@dataclass(frozen=True)
class _Shape(Table):
    """A kind of surface or indenter with its numbers or its mesh file; '' for a kind that could not be read."""

    kind: str
    radius_m: Annotated[float | None, Length("a radius [m]", 5e-5, 1.0)] = None
    file: str | None = None
    extra: Mapping[str, Any] = field(default_factory=dict)

    kinds: ClassVar[Mapping[str, Kind]] = {}

    @property
    def numbers(self) -> dict[str, float]:
        """The numbers of its kind, by key."""
        return {key: getattr(self, key) for key in self.kinds[self.kind].numbers}

    def __str__(self) -> str:
        sizes = (f"{key.removesuffix('_m')} {1e3 * value:g} mm" for key, value in self.numbers.items())
        return f"{self.kind} of {', '.join(sizes)}" if self.numbers else self.kind

    def violations(self) -> Iterator[Violation]:
        """Yield a number or a mesh that the kind needs and lacks, or cannot have."""
        if (kind := self.kinds.get(self.kind)) is None:
            return
        every = {key for other in self.kinds.values() for key in other.numbers}
        for key in (*sorted(every), "file"):
            expected = "the name of the mesh file" * kind.mesh if key == "file" else kind.numbers.get(key)
            value = getattr(self, key)
            if expected and not value:
                yield missing(key, expected)
            elif value is not None and not expected:
                yield superfluous(key, f'kind = "{self.kind}" has none', value)


@dataclass(frozen=True)
class SurfaceSpec(_Shape):
    """The surface that carries the sensor: a kind of ``skincal.dataset.kinds``."""

    kind: Annotated[str, Word(options=SURFACES)]
    kinds: ClassVar[Mapping[str, Kind]] = SURFACES

    @property
    def is_plane(self) -> bool:
        """True if the sensor's position is ``x_m``, ``y_m`` instead of ``beta_deg``, ``y_m``."""
        return self.kind in SURFACES and SURFACES[self.kind].plane

    @property
    def across(self) -> str:
        """Key of the sensor's position across the finger: ``beta_deg``, on a plane ``x_m``."""
        return "x_m" if self.is_plane else "beta_deg"

    def mount_violations(self, mount: MountSpec) -> Iterator[Violation]:
        """Yield coordinates of ``[mount]`` that are missing, or that this surface does not have."""
        names = {
            "x_m": "x of the patch's centre [m]",
            "x_range_m": "[low, high] in metres",
            "beta_deg": "an angle in degrees, within ±180",
            "beta_range_deg": "[low, high] in degrees",
        }
        yield from self.across_violations(mount, "mount", names)

    def across_violations(self, spec: Any, table: str, names: Mapping[str, str]) -> Iterator[Violation]:
        """Yield keys of the position across that a table lacks, or that belong to another kind of surface."""
        if self.kind not in SURFACES:
            return
        reason = f"{'on a plane' if self.is_plane else 'off the plane'} it is {self.across}"
        for key, expected in names.items():
            value, wanted = getattr(spec, key), key.startswith(self.across[:2])
            if wanted and value is None:
                yield from within((table,), [missing(key, expected)])
            elif value is not None and not wanted:
                yield from within((table,), [superfluous(key, reason, value)])


@dataclass(frozen=True)
class IndenterSpec(_Shape):
    """The indenter: a kind of ``skincal.dataset.kinds``."""

    kind: Annotated[str, Word(options=INDENTERS)]
    kinds: ClassVar[Mapping[str, Kind]] = INDENTERS


@dataclass(frozen=True)
class MountSpec(Table):
    """Prior knowledge of the sensor's pose: nominal values and the ranges to search.

    On a cylinder and a mesh the centre is ``(y_m, beta_deg)``, on a plane ``(x_m, y_m)``; the other is None.
    """

    y_m: Centre
    alpha_deg: Angle
    y_range_m: LengthRange
    alpha_range_deg: AngleRange
    beta_deg: Angle | None = None
    beta_range_deg: AngleRange | None = None
    x_m: Centre | None = None
    x_range_m: LengthRange | None = None
    extra: Mapping[str, Any] = field(default_factory=dict)

    def violations(self) -> Iterator[Violation]:
        """Yield a nominal value outside of its range."""
        for key in ("y_m", "x_m", "beta_deg", "alpha_deg"):
            name, _, unit = key.partition("_")
            range_key = f"{name}_range_{unit}"
            value, bounds = getattr(self, key), getattr(self, range_key)
            # Comparisons with the NaN of a placeholder are false, so that nothing is reported twice.
            if value is not None and bounds is not None and (value < bounds[0] or value > bounds[1]):
                expected = f"a value within {range_key} = [{bounds[0]:g}, {bounds[1]:g}]"
                yield key, expected, value, f"Widen {range_key}, or correct {key}."


@dataclass(frozen=True)
class PositionSpec(Table):
    """Accuracy of the measured contact positions.

    Attributes:
        sigma_m: standard deviation [m]; inf: the positions are unknown.
        slack_m: bound of the shift that the fit may give to a press [m].
    """

    sigma_m: Annotated[float, Length("a standard deviation [m], 0 or more, or inf", 0.0, 0.1, inf=True)]
    slack_m: Annotated[float, Length("a bound [m], 0 or more", 0.0, 0.1, inf=True)]
    extra: Mapping[str, Any] = field(default_factory=dict)

    def violations(self) -> Iterator[Violation]:
        """Yield an infinite bound if the positions are known."""
        if math.isinf(self.slack_m) and math.isfinite(self.sigma_m):
            yield "slack_m", "a bound [m], 0 or more, at most 0.1 m", self.slack_m


@dataclass(frozen=True)
class ForceSpec(Table):
    """Accuracy of the measured forces: relative standard deviation of an error of scale, common to a session."""

    scale_sigma: Annotated[float, Key("a relative standard deviation, 0 to 0.5", 0.0, 0.5)] = 0.0
    extra: Mapping[str, Any] = field(default_factory=dict)


@dataclass(frozen=True)
class ClockSpec(Table):
    """Agreement of the clocks of force and taxels: standard deviation [s]."""

    sigma_s: Annotated[float, Key("a standard deviation [s], 0 or more", 0.0)] = 0.0
    extra: Mapping[str, Any] = field(default_factory=dict)


@dataclass(frozen=True)
class Description(Table):
    """The tables that describe a sensor and its rig, in ``dataset.toml``, a hand's file or a mapping.

    Attributes:
        force: accuracy of the force scale; None: unknown, taken as exact.
        clock: agreement of the clocks; None: unknown.
    """

    sensor: SensorSpec
    surface: SurfaceSpec
    indenter: IndenterSpec
    mount: MountSpec
    position: PositionSpec
    force: ForceSpec | None = None
    clock: ClockSpec | None = None

    def violations(self) -> Iterator[Violation]:
        """Yield coordinates of the mount that its surface does not have."""
        yield from self.surface.mount_violations(self.mount)

    @property
    def force_scale_sigma(self) -> float:
        """Relative standard deviation of an error of the force scale; 0 if it is unknown."""
        return 0.0 if self.force is None else self.force.scale_sigma

    def hand_violations(self) -> Iterator[Violation]:
        """Yield a surface or an indenter that a hand cannot have."""
        for table in ("surface", "indenter"):
            shape = getattr(self, table)
            if (kind := shape.kinds.get(shape.kind)) is not None and not kind.on_hand:
                expected = f"{named(shape.kinds, 'on_hand')}: contacts are found in closed form"
                yield (table, "kind"), expected, f'"{shape.kind}"'

    def meta(self, **others: Any) -> DatasetMeta:
        """Return the metadata of a dataset with these tables, and other fields."""
        return DatasetMeta(**{one.name: getattr(self, one.name) for one in fields(Description)}, **others)


@dataclass(frozen=True)
class DatasetMeta(Description):
    """The content of ``dataset.toml``: a description, and where the data come from.

    Attributes:
        created: date of the recording; None: not given.
        source: free text.
        assumed: names of the quantities that were assumed, not measured.
        wiring: for each taxel, its index in the image of the source, if the mapping of an import reordered them.
    """

    created: Annotated[datetime | date | None, When()] = None
    source: str = ""
    assumed: Annotated[tuple[str, ...], Key('a list of texts like ["force_n"]')] = ()
    wiring: Annotated[tuple[int, ...] | None, Key("the indices of all taxels, each once")] = None
    extra: Mapping[str, Any] = field(default_factory=dict)

    def violations(self) -> Iterator[Violation]:
        """Yield a wiring that is no order of the taxels."""
        yield from super().violations()
        if self.wiring is not None and sorted(self.wiring) != [*range(self.sensor.taxels)]:
            yield "wiring", f"the indices 0 to {self.sensor.taxels - 1}, each once", self.wiring
