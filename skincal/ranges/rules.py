"""Rules between the parameters of a set, and for joint draws; every violation is reported at once."""

from __future__ import annotations

from collections.abc import Collection, Mapping

import numpy as np
from numpy.typing import NDArray

from skincal.errors import Problem
from skincal.ranges.names import Name, expected_names, find, suggestion
from skincal.ranges.parameter import SOURCES, Parameter, as_tuple


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
