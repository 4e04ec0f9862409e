"""``calibration.toml``: the schema of its content, and what a calibration writes."""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import PurePath
from typing import Annotated, Any, Final, cast

import numpy as np

from skincal.calibration.calibration import Calibration
from skincal.calibration.parts import (
    LAW,
    Effect,
    Finding,
    FittedLaw,
    Interval,
    Loss,
    ModelParameters,
    Provenance,
)
from skincal.dataset import IndenterSpec, MountSpec, PositionSpec, SensorSpec, SurfaceSpec
from skincal.dataset.findings import Findings, meant
from skincal.dataset.keys import MILLIMETRES, Key, Range
from skincal.dataset.schema import Table, plain_table
from skincal.dataset.schema_errors import Violation, within
from skincal.effects import EFFECTS
from skincal.model import ContactLaw

FILE: Final = "calibration.toml"
"""Name of the file."""
FORMAT: Final = "skincal-calibration/1"
"""Name and version of the format."""

_ROUNDED: Final = 1e-3
"""Relative tolerance of a value whose interval has no width."""

_ENDS = "[low, high]; -inf or inf where the data give no bound"
Ends = Annotated[Interval, Range(_ENDS, inf=True)]
EndsM = Annotated[Interval, Range(_ENDS, high=1.0, inf=True, beyond=MILLIMETRES)]


@dataclass(frozen=True)
class _Intervals(Table):
    y_m: EndsM
    beta_deg: Ends | None = field(default=None, kw_only=True)
    x_m: EndsM | None = field(default=None, kw_only=True)
    alpha_deg: Ends
    elasticity_pa_per_m: Ends
    scale_per_n: Ends
    rest_counts: Ends | None = None

    def given(self) -> dict[str, Interval]:
        return {name: ends for name, ends in vars(self).items() if ends is not None}


_NEUTRAL: Final = ContactLaw()
"""The elastic foundation."""


@dataclass(frozen=True)
class _Law(Table):
    """``[contact_law]``: the difference from the elastic foundation."""

    exponent: Annotated[float, Key("a number, 0.3 to 3", 0.3, 3.0)] = _NEUTRAL.exponent
    spread_m2: Annotated[float, Key("a number, -1e-6 to 1e-6", -1e-6, 1e-6)] = _NEUTRAL.spread_m2
    radius_scale: Annotated[float, Key("a number, 0.5 to 2", 0.5, 2.0)] = _NEUTRAL.radius_scale
    reference_m: Annotated[float, Key("a number, 1e-6 to 1e-2", 1e-6, 1e-2)] = _NEUTRAL.reference_m
    reference_radius_m: Annotated[float, Key("0, or a radius, up to 0.1", 0.0, 0.1)] = (
        _NEUTRAL.reference_radius_m
    )
    intervals: Mapping[str, Ends] = field(default_factory=dict[str, Interval])

    def violations(self) -> Iterator[Violation]:
        for name in set(self.intervals) - set(LAW):
            yield f"intervals.{name}", f"one of {', '.join(LAW)}", "an unknown name"

    def fitted(self) -> FittedLaw:
        values = {name: value for name, value in vars(self).items() if name != "intervals"}
        return FittedLaw(ContactLaw(**values), self.intervals)


@dataclass(frozen=True, kw_only=True)
class CalibrationFile(Table):
    """The content of ``calibration.toml``; see :class:`skincal.calibration.Calibration`."""

    sensor: SensorSpec
    surface: SurfaceSpec
    indenter: IndenterSpec
    mount: MountSpec | None = None
    position: PositionSpec | None = None
    model: ModelParameters
    intervals: _Intervals
    loss: Loss
    effects: tuple[Effect, ...] = ()
    contact_law: _Law | None = None
    findings: tuple[Finding, ...] = ()
    provenance: Provenance
    extra: Mapping[str, Any] = field(default_factory=dict[str, Any])

    def violations(self) -> Iterator[Violation]:
        """Yield coordinates that the surface does not have, lists of a wrong length, and parameters out of bounds."""
        angle = {"beta_deg": "an angle in degrees", "x_m": "x of the patch's centre [m]"}
        yield from self.surface.across_violations(self.model, "model", angle)
        yield from self.surface.across_violations(self.intervals, "intervals", dict.fromkeys(angle, _ENDS))
        if self.mount is not None:
            yield from self.surface.mount_violations(self.mount)
        scales, taxels = self.model.scale_per_taxel_per_n, self.sensor.taxels
        if scales is not None and taxels and len(scales) != taxels:
            yield ("model", "scale_per_taxel_per_n"), f"S_j [1/N], {taxels} numbers", scales
        yield from effects_violations(self.effects, taxels)

    def parts(self) -> dict[str, Any]:
        """Return the arguments of a calibration."""
        law = None if self.contact_law is None else self.contact_law.fitted()
        return vars(self) | {"intervals": self.intervals.given(), "contact_law": law}

    def warn(self, findings: Findings) -> None:
        """Warn of values farther outside their interval than its width: one of the two has been changed."""
        intervals = self.intervals.given()
        for name, value in self.model.best().items():
            low, high = intervals.get(name, (-math.inf, math.inf))
            beyond = max(low - value, value - high)
            if beyond > max(high - low, _ROUNDED * abs(value)):
                findings.warn(
                    f"{FILE}, [model] {name}",
                    f"a value about its interval, {low:g} to {high:g}",
                    f"{value:g}",
                    "One of them was changed by hand, or belongs to another fit: fit the session again.",
                )


def plain_file(calibration: Calibration) -> dict[str, Any]:
    """Return the content of ``calibration.toml`` as plain tables, without None."""
    names = (
        "sensor", "surface", "indenter", "mount", "position", "loss", "effects", "findings", "provenance",
    )  # fmt: skip
    model, law = calibration.model, calibration.contact_law
    plain = {"format": FORMAT} | {name: _plain(getattr(calibration, name)) for name in names}
    plain |= {"model": model.best() | _plain(model), "intervals": calibration.intervals}
    if law is not None:
        plain["contact_law"] = vars(law.law) | {"intervals": law.intervals}
    return toml_value(plain | dict(calibration.extra))


def _plain(part: Any) -> Any:
    """Return a part, or a list of parts, as tables without empty entries."""
    if isinstance(part, tuple):
        return [_plain(one) for one in cast("tuple[Any, ...]", part)]
    if not isinstance(part, Effect | Finding):
        return part and plain_table(part)
    optional = ("intervals", "poses", "mapping")
    return {key: value for key, value in plain_table(part).items() if value or key not in optional}


def toml_value(value: Any) -> Any:
    """Return a value as TOML has it: numpy values, tuples and paths are converted, None is left out."""
    if isinstance(value, Mapping):
        items = cast("Mapping[Any, Any]", value).items()
        return {str(key): toml_value(item) for key, item in items if item is not None}
    if isinstance(value, np.ndarray | np.generic):
        return toml_value(cast(Any, value).tolist())
    if isinstance(value, PurePath):
        return str(value)
    if isinstance(value, list | tuple | set | frozenset):
        return [toml_value(item) for item in cast("Iterable[Any]", value)]
    return value


def effects_violations(effects: Sequence[Effect], taxels: int) -> Iterator[Violation]:
    """Yield violations of the parameters of effects; ``taxels`` is J, 0 if unknown."""
    for i, effect in enumerate(effects):
        if effect.name in EFFECTS:
            yield from within(("effects", i), _effect(effect, taxels))
        if effect.name and effect.name in [earlier.name for earlier in effects[:i]]:
            fix = "Put its parameters into one table."
            yield ("effects", i, "name"), "each effect once", f"{effect.name} twice", fix


def _effect(effect: Effect, taxels: int) -> Iterator[Violation]:
    """Yield violations of one effect."""
    known = {parameter.name: parameter for parameter in EFFECTS[effect.name].parameters}
    for name, value in effect.parameters.items():
        key, parameter = f"parameters.{name}", known.get(name)
        if parameter is None:
            yield key, f"one of {', '.join(known)}", name, meant(name, known)
        elif (
            fault := parameter.fault(np.nan_to_num(value, nan=parameter.neutral), taxels, len(effect.poses))
        ) is not None:
            yield key, *fault
    for name, (low, high) in effect.intervals.items():
        like = effect.parameters.get(name)
        if like is None:
            expected = f"one of the parameters: {', '.join(effect.parameters) or 'none'}"
            yield f"intervals.{name}", expected, "an unknown name"
        elif not np.shape(low) == np.shape(high) == np.shape(like) or np.any(np.array(low) > np.array(high)):
            size = f", each a list of {len(like)} numbers" if isinstance(like, tuple) else ""
            yield f"intervals.{name}", f"[low, high], in ascending order{size}", (low, high)
    if effect.poses and not any(p.shape == "per-pose" for p in known.values()):
        yield "poses", f"nothing: {effect.name} does not depend on the hand pose", effect.poses
