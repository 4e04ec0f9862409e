"""``calibration.toml``: a strict reader, and a writer."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from datetime import date, datetime
from typing import Any, Final, cast

from skincal.calibration.calibration import Calibration
from skincal.calibration.contact_law_table import contact_law_from, plain_contact_law
from skincal.calibration.effect_tables import effects_from, findings_from, plain_effect
from skincal.calibration.parts import (
    REST,
    Effect,
    Finding,
    FittedLaw,
    Interval,
    Loss,
    ModelParameters,
    Provenance,
)
from skincal.calibration.values import number_list, shown, toml_value
from skincal.dataset import IndenterSpec, MountSpec, PositionSpec, SensorSpec, SurfaceSpec
from skincal.dataset.findings import Findings
from skincal.dataset.meta_tables import (
    check_format,
    indenter_from,
    mount_from,
    plain_table,
    position_from,
    sensor_from,
    surface_from,
    table_of,
)
from skincal.dataset.toml_table import MILLIMETRES, TomlTable

FILE: Final = "calibration.toml"
FORMAT: Final = "skincal-calibration/1"

_SHARED: Final = ("sensor", "surface", "indenter", "mount", "position")
_TOP: Final = (
    "format",
    *_SHARED,
    "model",
    "intervals",
    "loss",
    "effects",
    "contact_law",
    "findings",
    "provenance",
)
_MODEL: Final = (
    "y_m", "beta_deg", "x_m", "alpha_deg", "elasticity_pa_per_m", "scale_per_n", "scale_per_taxel_per_n", REST,
)  # fmt: skip
_INTERVALS: Final = tuple(name for name in _MODEL if name != "scale_per_taxel_per_n")
_LOSS: Final = ("mse_counts2", "valley_mse_counts2", "presses_used")
_ROUNDED: Final = 1e-3
"""Smallest number of digits of values whose interval has no width."""
ELASTICITY_PA_PER_M: Final = (1.0, 1e15)
SCALE_PER_N: Final = (1e-9, 1e12)
"""Bounds of plausible stiffness and counts; beyond, their squares overflow."""
_PROVENANCE: Final = ("dataset_sha256", "dataset", "version", "command", "seed", "time", "options")


@dataclass(frozen=True)
class Meta:
    """The content of ``calibration.toml``; see :class:`skincal.calibration.Calibration`."""

    sensor: SensorSpec
    surface: SurfaceSpec
    indenter: IndenterSpec
    mount: MountSpec | None
    position: PositionSpec | None
    model: ModelParameters
    intervals: Mapping[str, Interval]
    loss: Loss
    effects: tuple[Effect, ...]
    contact_law: FittedLaw | None
    findings: tuple[Finding, ...]
    provenance: Provenance
    extra: Mapping[str, Any]


def meta_from(values: Mapping[str, Any], findings: Findings) -> Meta:
    """Return the content of ``calibration.toml``.

    Args:
        values: the file as TOML.
        findings: collects errors and warnings; with an error, the result has placeholders.
    """
    top = TomlTable(findings, FILE, "", values, _TOP)
    check_format(top, FORMAT)
    shared = {name: table_of(top, name, optional=name in ("mount", "position")) for name in _SHARED}
    sensor, surface = sensor_from(shared["sensor"]), surface_from(shared["surface"])
    model = _model(top.inner("model", _MODEL), surface, sensor.taxels)
    intervals = _intervals(top.inner("intervals", _INTERVALS), surface)
    _check_best(model, intervals, findings)
    return Meta(
        sensor=sensor,
        surface=surface,
        indenter=indenter_from(shared["indenter"]),
        mount=mount_from(shared["mount"], surface) if top.has("mount") else None,
        position=position_from(shared["position"]) if top.has("position") else None,
        model=model,
        intervals=intervals,
        loss=_loss(top.inner("loss", _LOSS, open_keys=True)),
        effects=effects_from(top, findings, FILE, sensor.taxels),
        contact_law=contact_law_from(top, findings, FILE),
        findings=findings_from(top, findings, FILE),
        provenance=_provenance(top.inner("provenance", _PROVENANCE, open_keys=True)),
        extra=top.extra,
    )


def plain_meta(calibration: Calibration) -> dict[str, Any]:
    """Return the content of ``calibration.toml`` as plain tables, without None."""
    shared = {name: getattr(calibration, name) for name in _SHARED}
    plain: dict[str, Any] = {
        "format": FORMAT,
        **{name: plain_table(spec) for name, spec in shared.items() if spec is not None},
        "model": _plain_model(calibration.model),
        "intervals": {name: [float(v) for v in pair] for name, pair in calibration.intervals.items()},
        "loss": {**{key: getattr(calibration.loss, key) for key in _LOSS}, **calibration.loss.extra},
        "effects": [plain_effect(effect) for effect in calibration.effects],
        **plain_contact_law(calibration.contact_law),
        "findings": [finding.plain() for finding in calibration.findings],
        "provenance": _plain_provenance(calibration.provenance),
    }
    return toml_value(plain | dict(calibration.extra))


def _plain_model(model: ModelParameters) -> dict[str, Any]:
    scales = model.scale_per_taxel_per_n
    best = {name: float(value) for name, value in model.best().items()}
    if model.rest_counts is not None:
        best[REST] = float(model.rest_counts)
    return best | ({} if scales is None else {"scale_per_taxel_per_n": list(scales)})


def _plain_provenance(provenance: Provenance) -> dict[str, Any]:
    values = {key: getattr(provenance, key) for key in _PROVENANCE}
    values["options"] = dict(provenance.options)
    return {key: v for key, v in values.items() if v is not None} | dict(provenance.extra)


def _model(table: TomlTable, surface: SurfaceSpec, taxels: int) -> ModelParameters:
    plane = surface.is_plane
    table.absent(
        *(("beta_deg", "on a plane it is x_m") if plane else ("x_m", "off the plane it is beta_deg"))
    )
    return ModelParameters(
        y_m=_centre(table, "y_m"),
        beta_deg=None if plane or not surface.kind else table.number("beta_deg", "an angle in degrees"),
        x_m=_centre(table, "x_m") if plane else None,
        alpha_deg=table.number("alpha_deg", "an angle in degrees"),
        elasticity_pa_per_m=_within(table, "elasticity_pa_per_m", "E [Pa/m]", ELASTICITY_PA_PER_M),
        scale_per_n=_within(table, "scale_per_n", "S [1/N]", SCALE_PER_N),
        scale_per_taxel_per_n=_scales(table, taxels),
        rest_counts=table.number(REST, "the level at rest [counts]") if table.has(REST) else None,
    )


def _check_best(model: ModelParameters, intervals: Mapping[str, Interval], findings: Findings) -> None:
    """Warn of values farther outside their interval than its width: one of the two has been changed."""
    for name, value in model.best().items():
        low, high = intervals.get(name, (-math.inf, math.inf))
        beyond = max(low - value, value - high)
        if beyond > max(high - low, _ROUNDED * abs(value)):
            findings.warn(
                f"{FILE}, [model] {name}",
                f"a value about its interval, {low:g} to {high:g}",
                f"{value:g}",
                "One of them was changed by hand, or belongs to another fit: fit the session again.",
            )


def _centre(table: TomlTable, key: str) -> float:
    expected = f"{key[0]} of the patch's centre [m]"
    return table.length_m(key, expected, low=0.0, high=1.0, positive=False)


def _within(table: TomlTable, key: str, what: str, bounds: Interval) -> float:
    low, high = bounds
    return table.number(key, f"{what}, {low:g} to {high:g}", low=low, high=high)


def _scales(table: TomlTable, taxels: int) -> tuple[float, ...] | None:
    key = "scale_per_taxel_per_n"
    if not table.has(key):
        return None
    values = number_list(table.raw(key))
    if (
        values is None
        or (taxels and len(values) != taxels)
        or not all(0.0 <= value <= SCALE_PER_N[1] for value in values)
    ):
        expected = f"S_j [1/N], {taxels} numbers, 0 to {SCALE_PER_N[1]:g}"
        table.error(key, expected, shown(table.raw(key)))
        return None
    return values


def _intervals(table: TomlTable, surface: SurfaceSpec) -> dict[str, Interval]:
    across = surface.across
    names = ("y_m", across, "alpha_deg", "elasticity_pa_per_m", "scale_per_n") if surface.kind else ()
    other = "beta_deg" if surface.is_plane else "x_m"
    table.absent(other, f"on this surface it is {across}")
    rest = (REST,) if table.has(REST) else ()
    return {name: _interval(table, name) for name in (*names, *rest)}


def _interval(table: TomlTable, name: str) -> Interval:
    expected = "[low, high], in ascending order; -inf or inf where the data give no bound"
    nothing = (float("-inf"), float("inf"))
    if not table.has(name):
        table.error(name, expected, "nothing", f"Add {name} = [..., ...] to [intervals].")
        return nothing
    values = number_list(table.raw(name), infinite=True)
    if values is None or len(values) != 2 or not values[0] <= values[1]:
        table.error(name, expected, table.raw(name))
        return nothing
    if name in ("y_m", "x_m") and any(1.0 < abs(v) < float("inf") for v in values):
        table.error(name, "[low, high] in metres, within ±1", table.raw(name), MILLIMETRES)
    return values


def _loss(table: TomlTable) -> Loss:
    return Loss(
        mse_counts2=table.number("mse_counts2", "a mean square [counts²], 0 or more", low=0.0),
        valley_mse_counts2=table.number(
            "valley_mse_counts2", "a mean square [counts²], 0 or more, or inf", low=0.0, inf=True
        ),
        presses_used=table.whole("presses_used", "a whole number, 0 or more", low=0),
        extra=table.extra,
    )


def _provenance(table: TomlTable) -> Provenance:
    seed = table.raw("seed")
    if seed is not None and (not isinstance(seed, int) or isinstance(seed, bool)):
        table.error("seed", "a whole number", seed)
    options = table.raw("options")
    if options is not None and not isinstance(options, dict):
        table.error("options", "a table", shown(options))
    return Provenance(
        dataset_sha256=table.text("dataset_sha256", "the dataset's hash"),
        dataset=table.text("dataset", "a text", default=""),
        version=table.text("version", "a text", default=""),
        command=table.text("command", "a text", default=""),
        seed=seed,
        time=_time(table),
        options=cast("dict[str, Any]", options) if isinstance(options, dict) else {},
        extra=table.extra,
    )


def _time(table: TomlTable) -> datetime | None:
    value = table.raw("time")
    if value is None or isinstance(value, datetime):
        return value
    if isinstance(value, date):
        return datetime(value.year, value.month, value.day)
    table.error("time", "a date and time like 2026-11-20T12:00:00Z", shown(value))
    return None
