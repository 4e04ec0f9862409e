"""Parameters that may be randomized: full name, unit, shape, meaning, and the rules that sets of them keep.

A parameter that a file leaves out is not randomized: the simulation uses its nominal value.
"""

from __future__ import annotations

import difflib
import math
from collections.abc import Collection, Mapping
from dataclasses import dataclass, replace
from typing import Final, Literal

import numpy as np
from numpy.typing import NDArray

from skincal.effects import EFFECTS
from skincal.errors import Problem
from skincal.ranges.parameter import SOURCES, Parameter, as_tuple

Shape = Literal["scalar", "joint", "joint_12", "joint_3", "xyz", "taxel", "pose"]
"""Shape of a draw: one number; one per joint, per joint 1 and 2, per joint 3; a vector; one per taxel.

``pose``: one for all hand poses if the figures are numbers, one per pose if they are lists.
"""

_SHAPES: Final[dict[str, Shape]] = {"scalar": "scalar", "per-taxel": "taxel", "per-pose": "pose"}


@dataclass(frozen=True)
class Name:
    """A parameter that may be randomized.

    Attributes:
        path: full name with its tables: ``skin.y_m``.
        unit: unit for people; ``1`` for a pure number.
        shape: shape of one draw.
        meaning: what is drawn.
        least: smallest sensible value.
        most: largest sensible value; bounds beyond it mostly mean a wrong unit.
    """

    path: str
    unit: str
    shape: Shape
    meaning: str
    least: float = -math.inf
    most: float = math.inf

    @property
    def table(self) -> str:
        """The table that holds the parameter: ``object.marble``."""
        return self.path.rpartition(".")[0]


_FINGER: Final = (
    Name("joint_offset_rad", "rad", "joint", "added to the measured joint angles", -math.pi, math.pi),
    Name("joint_noise_rad", "rad", "joint", "added to the measured joint angles", -math.pi, math.pi),
    Name("k_p_nm_per_rad", "N m/rad", "joint", "stiffness of the joint controller", 0.0),
    Name("k_d_nms_per_rad", "N m s/rad", "joint", "damping of the joint controller", 0.0),
    Name(
        "parasitic_stiffness_nm_per_rad", "N m/rad", "joint",
        "stiffness K_e of the drive between motor and joint", 0.0,
    ),
    Name("stick_friction_12_nm", "N m", "joint_12", "stick friction of joints 1 and 2 of a finger", 0.0),
    Name("stick_friction_3_nm", "N m", "joint_3", "stick friction of joint 3 of a finger", 0.0),
    Name("lateral_friction", "1", "scalar", "friction coefficient of the fingertips", 0.0),
)  # fmt: skip

_OBJECT: Final = (
    Name("position_m", "m", "xyz", "added to the initial position", -1.0, 1.0),
    Name("mass_kg", "kg", "scalar", "mass", 0.0, 10.0),
    Name("radius_m", "m", "scalar", "radius", 0.0, 0.5),
    Name("lateral_friction", "1", "scalar", "friction coefficient against sliding", 0.0),
    Name("spinning_friction", "m", "scalar", "torque against spinning, over normal force", 0.0),
    Name("rolling_friction", "m", "scalar", "torque against rolling, over normal force", 0.0),
    Name("random_force_n", "N", "xyz", "force that disturbs the object"),
)

_BOLT_ANGLES: Final = (
    Name("psi_deg", "°", "scalar", "added to the initial angle psi", -180.0, 180.0),
    Name("theta_deg", "°", "scalar", "added to the initial angle theta", -180.0, 180.0),
    Name("phi_deg", "°", "scalar", "added to the initial angle phi", -180.0, 180.0),
)

_SKIN: Final = (
    Name("x_m", "m", "scalar", "centre of the patch on a plane", -1.0, 1.0),
    Name("y_m", "m", "scalar", "centre of the patch along the finger", -1.0, 1.0),
    Name("beta_deg", "°", "scalar", "centre of the patch round the fingertip", -360.0, 360.0),
    Name("alpha_deg", "°", "scalar", "turn of the patch about its normal", -360.0, 360.0),
    Name("x_offset_m", "m", "scalar", "added to the nominal centre, as arc towards +beta or +x", -1.0, 1.0),
    Name("y_offset_m", "m", "scalar", "added to the nominal centre, along +y", -1.0, 1.0),
    Name("elasticity_pa_per_m", "Pa/m", "scalar", "stress over penetration, E", 0.0),
    Name("scale_per_n", "1/N", "scalar", "counts over taxel load, S, common to all taxels", 0.0),
    Name("scale_offset_per_n", "1/N", "taxel", "added to the common scale: S_j = S + this"),
    Name("taxel_offset_counts", "counts", "taxel", "added to the taxel's value"),
    Name("noise_sigma_counts", "counts", "taxel", "standard deviation of the taxel's noise", 0.0),
    Name("taxel_noise_counts", "counts", "taxel", "noise, added to the taxel's value on top of the offset"),
)

_CONTACT_LAW: Final = (
    Name("exponent", "1", "scalar", "power of the penetration that stress grows with", 0.3, 3.0),
    Name("spread_m2", "m²", "scalar", "variance by which pressure spreads", -1e-6, 1e-6),
    Name("radius_scale", "1", "scalar", "radius that a ball seems to have, over its own", 0.5, 2.0),
    Name("reference_radius_m", "m", "scalar", "radius of the ball that E belongs to", 0.0, 0.1),
)

_TABLES: Final = {
    "finger": _FINGER,
    "object.marble": _OBJECT,
    "object.bolt": (*_OBJECT, *_BOLT_ANGLES),
    "skin": _SKIN,
    "skin.contact_law": _CONTACT_LAW,
}
"""Parameters by their table; their names become full in ``NAMES``."""

NAMES: Final[dict[str, Name]] = {
    f"{table}.{one.path}": replace(one, path=f"{table}.{one.path}")
    for table, names in _TABLES.items()
    for one in names
}
"""Every parameter by its full name, in the order of the files; without effects."""

TABLES: Final[tuple[str, ...]] = (*_TABLES, "skin.effects.NAME")

EFFECTS_PREFIX: Final = "skin.effects."


def find(path: str) -> Name | None:
    """Return the parameter of this name, or None. Effects and their parameters come from the registry."""
    if path in NAMES:
        return NAMES[path]
    name, _, parameter = path.removeprefix(EFFECTS_PREFIX).partition(".")
    if not path.startswith(EFFECTS_PREFIX) or name not in EFFECTS:
        return None
    for one in EFFECTS[name].parameters:
        if one.name == parameter:
            unit = "1" if one.unit == "-" else one.unit
            return Name(path, unit, _SHAPES[one.shape], one.description, one.low, one.high)
    return None


def sort_key(path: str) -> tuple[int, str]:
    """Return a key that puts names in the table's order, effects last; draws do not depend on the order in a file."""
    order = list(NAMES)
    return (order.index(path), "") if path in NAMES else (len(order), path)


def expected_names(path: str) -> str:
    """Return the names that an unknown name could have been, for an error message."""
    if path.startswith(EFFECTS_PREFIX):
        name = path.removeprefix(EFFECTS_PREFIX).partition(".")[0]
        if name in EFFECTS:
            return f"one of {', '.join(_parameters_of(name))}"
        return f"skin.effects.NAME.PARAMETER with NAME one of {', '.join(EFFECTS)}"
    table = path.rpartition(".")[0]
    if siblings := [name.path for name in NAMES.values() if name.table == table]:
        return f"one of {', '.join(siblings)}"
    return f"a parameter in one of the tables {', '.join(TABLES)}"


def suggestion(path: str) -> str:
    """Return ``Did you mean ...?``, or ''."""
    known = [*NAMES, *(full for name in EFFECTS for full in _parameters_of(name))]
    close = difflib.get_close_matches(path, known, n=1, cutoff=0.75)
    return f"Did you mean {close[0]}?" if close else ""


def _parameters_of(effect: str) -> list[str]:
    return [f"{EFFECTS_PREFIX}{effect}.{parameter.name}" for parameter in EFFECTS[effect].parameters]


def collection_problems(
    parameters: Mapping[str, Parameter], place: str = "", reported: Collection[str] = ()
) -> list[Problem]:
    """Return every problem of a set of parameters that are valid one by one."""
    found: list[Problem] = []
    for path, parameter in parameters.items():
        name = find(path)
        if name is None:
            found.append(unknown_name(path, place))
            continue
        found += _shape_problems(name, parameter, place)
        found += _bound_problems(name, parameter, place)
        if parameter.sigma_from is not None and parameter.sigma_from not in reported:
            found += _reference_problems(path, parameter, parameters, place)
    return found


def unknown_name(path: str, place: str = "") -> Problem:
    """Return the problem of a name that is not in the table."""
    return Problem(f"{place}[{path}]", expected_names(path), "an unknown name", suggestion(path))


def _shape_problems(name: Name, parameter: Parameter, place: str) -> list[Problem]:
    size = parameter.size
    if size is None or name.shape not in ("scalar", "xyz") or (name.shape == "xyz" and size == 3):
        return []
    expected = "one number" if name.shape == "scalar" else "one number, or three"
    return [Problem(f"{place}[{name.path}]", expected, f"a list of {size}")]


def _bound_problems(name: Name, parameter: Parameter, place: str) -> list[Problem]:
    found: list[Problem] = []
    for key, numbers in parameter.figures().items():
        if key == "sigma":
            continue
        if wrong := [number for number in as_tuple(numbers) if not name.least <= number <= name.most]:
            expected = f"{name.least:g} to {name.most:g}" + (f" {name.unit}" if name.unit != "1" else "")
            fix = f"Is the unit {name.unit}?" if name.unit != "1" else ""
            found.append(Problem(f"{place}[{name.path}] {key}", expected, f"{wrong[0]:g}", fix))
    return found


def _reference_problems(
    path: str, parameter: Parameter, parameters: Mapping[str, Parameter], place: str
) -> list[Problem]:
    """Return the problem of ``sigma_from``: it must name a parameter drawn per episode that is never below 0."""
    reference = str(parameter.sigma_from)
    target = parameters.get(reference)
    where = f"{place}[{path}] sigma_from"
    if target is None:
        return [Problem(where, "the full name of a parameter in this file", repr(reference))]
    if parameter.mode == "episode" or target.mode == "step":
        got = f"{path} per {parameter.mode}, {reference} per {target.mode}"
        return [Problem(where, "a parameter drawn per episode for one drawn per step", got)]
    bounds = [min(as_tuple(numbers)) for key, numbers in target.figures().items() if key in ("low", "value")]
    if not bounds or min(bounds) < 0.0:
        return [Problem(where, "a parameter that is never below 0", reference)]
    return []


def joint_problems(
    columns: tuple[str, ...], draws: NDArray[np.float64], source: str, place: str
) -> list[Problem]:
    """Return every problem of joint draws."""
    found: list[Problem] = []
    for column in columns:
        name = find(column)
        if name is None or name.shape != "scalar" or name.table.partition(".")[0] != "skin":
            expected = "names of single figures of the skin: y_m, elasticity_pa_per_m, ..."
            found.append(Problem(f"{place} columns", expected, repr(column.removeprefix("skin."))))
    if len(set(columns)) != len(columns) or not columns:
        found.append(
            Problem(f"{place} columns", "one or more names, each once", ", ".join(columns) or "none")
        )
    if source not in SOURCES:
        found.append(Problem(f"{place} source", f"one of {', '.join(SOURCES)}", repr(source)))
    if draws.ndim != 2 or not len(draws) or draws.shape[1] != len(columns):
        expected = f"one or more rows of {len(columns)} numbers"
        found.append(Problem(f"{place} draws", expected, f"shape {draws.shape}"))
    elif not np.isfinite(draws).all():
        row = int(np.flatnonzero(~np.isfinite(draws).all(axis=1))[0])
        found.append(Problem(f"{place} draws, row {row + 1}", "finite numbers", str(draws[row].tolist())))
    return found
