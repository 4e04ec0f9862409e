"""The tables shared by ``dataset.toml`` and ``calibration.toml``: from TOML to objects, and back."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import asdict
from pathlib import Path
from typing import Any

from skincal.bounded import MOST_TAXELS, UnreadableError, parse_toml, read_text
from skincal.dataset.findings import Findings
from skincal.dataset.kinds import INDENTERS, SURFACES, Kind
from skincal.dataset.spec import (
    ClockSpec,
    DatasetMeta,
    ForceSpec,
    IndenterSpec,
    MountSpec,
    Pair,
    PositionSpec,
    SensorSpec,
    SurfaceSpec,
)
from skincal.dataset.toml_table import MILLIMETRES, TomlTable
from skincal.files import reason

TABLES = ("sensor", "surface", "indenter", "mount", "position", "force", "clock")
OPTIONAL_TABLES = ("force", "clock")
KNOWN = {
    "sensor": (
        "rows", "cols", "taxel_size_m", "pitch_m", "value_min", "value_max", "integer", "unit", "baseline",
        "positions",
    ),
    "surface": ("kind", "radius_m", "file"),
    "indenter": ("kind", "radius_m", "file"),
    "mount": (
        "y_m", "beta_deg", "alpha_deg", "x_m", "y_range_m", "beta_range_deg", "alpha_range_deg", "x_range_m",
    ),
    "position": ("sigma_m", "slack_m"),
    "force": ("scale_sigma",),
    "clock": ("sigma_s",),
}  # fmt: skip
"""Keys of each table."""


def load_toml(
    path: Path, findings: Findings, what: str, within: Path | None = None
) -> Mapping[str, Any] | None:
    """Return the content of a TOML file that describes ``what``; None, with an error added, if it cannot be read."""
    try:
        return parse_toml(read_text(path, within=within))
    except FileNotFoundError:
        fix = "" if what == "mapping" else f"Is this a {what}'s folder?"
        findings.error(str(path), f"the description of the {what}", "no such file", fix)
    except UnreadableError as error:
        # The message holds the line and the column.
        fix = "Correct that line: quote texts, put lists in brackets, give every key and table once."
        findings.error(str(path), error.expected, error.got, fix if error.expected == "TOML" else "")
    except OSError as error:
        findings.error(str(path), f"the description of the {what}", reason(error))
    return None


def tables_of(top: TomlTable) -> dict[str, TomlTable]:
    """Return all shared tables of a file; add an error for each required one that is missing."""
    return {name: table_of(top, name, optional=name in OPTIONAL_TABLES) for name in TABLES}


def meta_from(top: TomlTable, tables: Mapping[str, TomlTable]) -> DatasetMeta:
    """Return the metadata of the shared tables; the caller adds the source and the date."""
    surface = surface_from(tables["surface"])
    return DatasetMeta(
        sensor=sensor_from(tables["sensor"]),
        surface=surface,
        indenter=indenter_from(tables["indenter"]),
        mount=mount_from(tables["mount"], surface),
        position=position_from(tables["position"]),
        force=force_from(tables["force"]) if top.has("force") else None,
        clock=clock_from(tables["clock"]) if top.has("clock") else None,
    )


def table_of(top: TomlTable, name: str, *, optional: bool = False) -> TomlTable:
    """Return one of the shared tables of a file; an empty one, with an error added, if it is missing or not a table."""
    return top.inner(name, KNOWN[name], optional=optional, fix="Add it, as in data/paper-like.")


def check_format(top: TomlTable, expected: str) -> None:
    """Add an error unless the key ``format`` has the expected value."""
    value = top.text("format", f'"{expected}"')
    if value and value != expected:
        top.error(
            "format",
            f'"{expected}"',
            f'"{value}"',
            "Another kind of file, or from a newer version of skincal.",
        )


def plain_table(spec: Any) -> dict[str, Any]:
    """Return a table as TOML writes it; a square size is one number."""
    values = asdict(spec)
    extra = values.pop("extra")
    for key in ("taxel_size_m", "pitch_m"):
        pair = values.get(key)
        if pair is not None and pair[0] == pair[1]:
            values[key] = pair[0]
    plain = {k: list(v) if isinstance(v, tuple) else v for k, v in values.items() if v is not None}
    return {**plain, **extra}


def sensor_from(table: TomlTable) -> SensorSpec:
    """Return ``[sensor]``; here and below, a wrong value adds an error and reads as a placeholder."""
    listed = table.has("positions")
    size = (
        None
        if listed and not table.has("taxel_size_m")
        else _side(table, "taxel_size_m", "the side of a taxel")
    )
    pitch = None if listed and not table.has("pitch_m") else _side(table, "pitch_m", "the distance of taxels")
    rows, cols = (table.whole(key, "a whole number, at least 1", low=1) for key in ("rows", "cols"))
    if max(rows, cols, rows * cols) > MOST_TAXELS:
        table.error("rows", f"at most {MOST_TAXELS} taxels, rows x cols", f"{rows} x {cols}")
        rows, cols = 0, 0
    sensor = SensorSpec(
        rows=rows,
        cols=cols,
        taxel_size_m=size,
        pitch_m=pitch,
        value_min=table.number("value_min", default=None),
        value_max=table.number("value_max", default=None),
        integer=table.flag("integer", default=False),
        baseline=table.choice("baseline", ("raw", "subtracted"), default="raw"),
        positions=table.text("positions", "a file name") if listed else None,
        extra=table.extra,
        unit=table.text("unit", 'a unit of taxel values, like "V"') if table.has("unit") else None,
    )
    _check_sensor(table, sensor)
    return sensor


def _side(table: TomlTable, key: str, what: str) -> Pair | None:
    return table.size_m(key, f"{what} [m], or [du, dv]", low=2e-5, high=0.1)


def _check_sensor(table: TomlTable, sensor: SensorSpec) -> None:
    low, high = sensor.value_min, sensor.value_max
    if low is not None and high is not None and low >= high:
        table.error("value_max", f"more than value_min = {low:g}", f"{high:g}", "Correct one of them.")
    if sensor.pitch_m is None or sensor.taxel_size_m is None or sensor.positions is not None:
        return
    for axis, count, pitch, size in zip(
        "uv", (sensor.cols, sensor.rows), sensor.pitch_m, sensor.taxel_size_m, strict=True
    ):
        if count > 1 and size > pitch * (1 + 1e-9):
            table.error(
                "pitch_m",
                f"at least the taxel's size {size:g} m along {axis}",
                f"{pitch:g} m",
                "Taxels overlap.",
            )


def surface_from(table: TomlTable) -> SurfaceSpec:
    """Return ``[surface]``."""
    return SurfaceSpec(*_shape(table, SURFACES), table.extra)


def indenter_from(table: TomlTable) -> IndenterSpec:
    """Return ``[indenter]``."""
    return IndenterSpec(*_shape(table, INDENTERS), table.extra)


def _shape(table: TomlTable, kinds: Mapping[str, Kind]) -> tuple[str, float | None, str | None]:
    """Return the kind, and its radius [m] or the name of its mesh file."""
    name = table.choice("kind", tuple(kinds))
    if name not in kinds:
        return "", None, None
    kind, radius, file = kinds[name], None, None
    if kind.radius:
        radius = table.length_m("radius_m", kind.radius, low=kind.least_m, high=1.0)
    else:
        table.absent("radius_m", f'kind = "{name}" has none')
    if kind.mesh:
        file = table.text("file", "the name of the mesh file") or None
    else:
        table.absent("file", f'kind = "{name}" has none')
    return name, radius, file


def mount_from(table: TomlTable, surface: SurfaceSpec) -> MountSpec:
    """Return ``[mount]`` of a sensor on a surface."""
    plane = surface.is_plane
    for key in ("beta_deg", "beta_range_deg") if plane else ("x_m", "x_range_m"):
        table.absent(
            key,
            "on a plane it is x_m, x_range_m" if plane else "off the plane it is beta_deg, beta_range_deg",
        )
    y, y_range = _centre(table, "y")
    x, x_range = _centre(table, "x") if plane else (None, None)
    beta, beta_range = _angle(table, "beta") if surface.kind and not plane else (None, None)
    alpha, alpha_range = _angle(table, "alpha")
    return MountSpec(
        y_m=y,
        alpha_deg=alpha,
        y_range_m=y_range,
        alpha_range_deg=alpha_range,
        beta_deg=beta,
        beta_range_deg=beta_range,
        x_m=x,
        x_range_m=x_range,
        extra=table.extra,
    )


def _centre(table: TomlTable, axis: str) -> tuple[float, Pair]:
    value = table.length_m(
        f"{axis}_m", f"{axis} of the patch's centre [m]", low=0.0, high=1.0, positive=False
    )
    bounds = table.range(f"{axis}_range_m", "[low, high] in metres", limit=1.0, fix=MILLIMETRES)
    _check_inside(table, f"{axis}_m", value, f"{axis}_range_m", bounds)
    return value, bounds


def _angle(table: TomlTable, name: str) -> tuple[float, Pair]:
    value = table.number(f"{name}_deg", "an angle in degrees, within ±180", low=-180, high=180)
    bounds = table.range(f"{name}_range_deg", "[low, high] in degrees", limit=180)
    _check_inside(table, f"{name}_deg", value, f"{name}_range_deg", bounds)
    return value, bounds


def _check_inside(table: TomlTable, key: str, value: float, range_key: str, bounds: Pair) -> None:
    # Comparisons with the NaN of a placeholder are false, so that nothing is reported twice.
    if value < bounds[0] or value > bounds[1]:
        expected = f"a value within {range_key} = [{bounds[0]:g}, {bounds[1]:g}]"
        table.error(key, expected, f"{value:g}", f"Widen {range_key}, or correct {key}.")


def position_from(table: TomlTable) -> PositionSpec:
    """Return ``[position]``."""
    sigma = table.length_m("sigma_m", "a standard deviation [m], 0 or more, or inf", low=0.0, high=0.1,
                           positive=False, inf=True)  # fmt: skip
    slack = table.length_m("slack_m", "a bound [m], 0 or more", low=0.0, high=0.1, positive=False,
                           inf=math.isinf(sigma))  # fmt: skip
    for key, value in (("sigma_m", sigma), ("slack_m", slack)):
        if value < 0:
            table.error(key, "0 or more", f"{value:g}")
    return PositionSpec(sigma, slack, table.extra)


def force_from(table: TomlTable) -> ForceSpec:
    """Return ``[force]``."""
    return ForceSpec(
        table.number(
            "scale_sigma", "a relative standard deviation, 0 to 0.5", default=0.0, low=0.0, high=0.5
        ),
        table.extra,
    )


def clock_from(table: TomlTable) -> ClockSpec:
    """Return ``[clock]``."""
    return ClockSpec(
        table.number("sigma_s", "a standard deviation [s], 0 or more", default=0.0, low=0.0), table.extra
    )
