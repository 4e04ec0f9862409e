"""The last step of every import: a checked dataset that appears complete or not at all."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from skincal.covariates import NORMAL, POSITION, TARGET
from skincal.dataset import Dataset, check_dataset
from skincal.dataset.findings import Findings
from skincal.dataset.meta_file import FILE
from skincal.dataset.model_objects import surface_of
from skincal.dataset.spec import ClockSpec
from skincal.dataset.writing import write_dataset_files
from skincal.errors import InputError, Problem, input_error
from skincal.files import check_input, reason, whole_folder
from skincal.imports.alignment import JoinedClock
from skincal.imports.mapping import Mapping, Quantity
from skincal.imports.mapping_file import Frame
from skincal.imports.press_recording import presses_and_frames
from skincal.imports.recording import Dropped, FloatArray, ReadFile, Recording

if TYPE_CHECKING:
    from skincal.model import Surface


@dataclass(frozen=True)
class Imported:
    """Result of an import: what was read, written and left out.

    Attributes:
        frames: number of frames; 0 where there are none.
        read: files, with their rows or messages.
        dropped: samples that were left out, with reasons.
        assumed: quantities that were assumed, not measured.
        warnings: warnings about the dataset.
        notes: repairs of the recording: clocks that wrap, stamps that are missing.
        clocks: alignment of the clocks of other files with that of the taxels.
    """

    folder: Path
    presses: int
    frames: int
    read: tuple[ReadFile, ...]
    dropped: tuple[Dropped, ...]
    assumed: tuple[str, ...]
    warnings: tuple[Problem, ...]
    notes: tuple[str, ...] = ()
    clocks: tuple[JoinedClock, ...] = ()


def assemble(
    recording: Recording, mapping: Mapping, out: Path, findings: Findings, *, force: bool
) -> Imported:
    """Write the dataset of a recording.

    Raises:
        InputError: the recording cannot be cut into presses, or the result is not a valid dataset.
        OSError: the disk is full, or not writable.
    """
    findings.raise_errors()
    surface = surface_of(mapping.meta.surface, mapping.meshes) if mapping.file.frame.project else None
    found = presses_and_frames(placed(recording, mapping.file.frame, surface), mapping, findings)
    findings.raise_errors()
    assert found is not None
    presses, frames, dropped = found
    files = ", ".join(file.file for file in recording.files)
    meta = replace(
        mapping.meta,
        source=mapping.meta.source or f"imported from {files}",
        assumed=assumed(mapping),
        clock=_clock(recording, mapping),
    )
    dataset = Dataset(meta, presses, frames, mapping.positions, mapping.meshes)
    with whole_folder(out, force=force, marker=FILE) as folder:
        write_dataset_files(dataset, folder)
        checked = check_dataset(folder)
        if checked.dataset is None:
            raise InputError([_traced(problem, folder, mapping) for problem in checked.errors])
    return Imported(
        folder=out,
        presses=len(presses),
        frames=0 if frames is None else len(frames),
        read=recording.files,
        dropped=dropped,
        assumed=meta.assumed,
        warnings=(*findings.warnings, *(_traced(problem, folder, mapping) for problem in checked.warnings)),
        notes=recording.notes,
        clocks=recording.clocks,
    )


def _clock(recording: Recording, mapping: Mapping) -> ClockSpec | None:
    """Return the agreement of the clocks of force and taxels: the mapping's sigma, and that of an estimated offset."""
    given, force = mapping.meta.clock, mapping.quantity("force_n")
    of_force = "" if force is None else force.topic
    found = [clock.sigma_s for clock in recording.clocks if clock.estimated and clock.name == of_force]
    if not found:
        return given
    said = ClockSpec() if given is None else given
    return replace(said, sigma_s=float(np.hypot(said.sigma_s, max(found))))


def assumed(mapping: Mapping) -> tuple[str, ...]:
    """Return assumed quantities: those that the mapping lists, its constants, and positions moved onto the surface."""
    constant = [
        q.target for q in mapping.quantities if q.constant is not None and not isinstance(q.constant, str)
    ]
    found = [*mapping.meta.assumed]
    whole = all(name in constant for name in POSITION)
    if whole:
        found.append("position")
    elif mapping.file.frame.project:
        found.append("position.depth")
    found += [name for name in constant if not (whole and name in POSITION)]
    return tuple(dict.fromkeys(found))


def _traced(problem: Problem, folder: Path, mapping: Mapping) -> Problem:
    """Return a problem of the dataset with the place in the mapping that its column comes from.

    The temporary folder is left out: it no longer exists.
    """
    problem = replace(problem, place=problem.place.removeprefix(f"{folder}/"))
    if problem.place.startswith(f"{FILE},"):
        return replace(problem, place=f"{mapping.path.name}{problem.place.removeprefix(FILE)}")
    names = re.findall(r"\w+", problem.place)
    found = [q for q in mapping.quantities if q.target in names]
    if found:
        origin = "; ".join(dict.fromkeys(_origin(q) for q in found))
    elif any(name.startswith("taxel_") for name in names):
        origin = mapping.taxels.place
    else:
        return replace(problem, place=f"imported {problem.place}")
    return replace(problem, place=f"imported {problem.place} ({origin})")


def _origin(quantity: Quantity) -> str:
    unit = "" if quantity.unit.name == "1" else f', unit "{quantity.unit.name}"'
    return f"{quantity.place}{unit}"


def resolved(mapping: Mapping, named: Sequence[Path], listed: Sequence[str], what: str) -> list[Path]:
    """Return the files to read: those of the command line, else those in the mapping.

    Raises:
        InputError: there are no files, a file does not exist, or the mapping lists one outside its folder.
    """
    files = list(named) or [beside(mapping, name, what) for name in listed]
    if not files:
        fix = "Name them on the command line, or as files in the mapping."
        raise input_error(mapping.path.name, what, "none", fix)
    if missing := [Problem(str(path), what, "no such file") for path in files if not path.exists()]:
        raise InputError(missing)
    return files


def beside(mapping: Mapping, name: str, what: str) -> Path:
    """Return the path of a file, or of a bag's folder, that a mapping names.

    Raises:
        InputError: it lies outside the mapping's folder, or is neither a file nor a folder.
    """
    path = mapping.path.parent / name
    try:
        check_input(path, within=mapping.path.parent)
    except (FileNotFoundError, IsADirectoryError):
        pass
    except OSError as error:
        fix = "Name it on the command line." if what.endswith("to read") else "Copy it there."
        raise input_error(f'{mapping.path.name}, "{name}"', what, reason(error), fix) from error
    return path


def placed(recording: Recording, frame: Frame, surface: Surface | None) -> Recording:
    """Return the recording with its positions, targets and normals in the fingertip frame."""
    columns = dict(recording.columns)
    rotation, translation = frame.rotation, np.asarray(frame.translation_m)
    moves = translation.any() or not np.array_equal(rotation, np.eye(3))
    for names, shift in ((POSITION, True), (TARGET, True), (NORMAL, False)):
        if not any(name in columns for name in names):
            continue
        points = recording.vector(names)
        if moves:
            points = points @ rotation.T + (translation if shift else 0.0)
        if shift and frame.project and surface is not None:
            points = _projected(surface, points)
        columns |= dict(zip(names, points.T, strict=True))
    return replace(recording, columns=columns)


def _projected(surface: Surface, points: FloatArray) -> FloatArray:
    given = np.isfinite(points).all(axis=1)
    result = points.copy()
    if given.any():
        result[given] = surface.project(points[given])
    return result
