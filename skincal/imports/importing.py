"""The imports as functions, from a mapping file and a recording to a dataset that appears complete or not at all."""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from skincal.covariates import NORMAL, POSITION, TARGET
from skincal.dataset import Dataset, check_dataset
from skincal.dataset.dataset import surface_of
from skincal.dataset.findings import Findings
from skincal.dataset.folder import write_dataset_files
from skincal.dataset.meta_file import FILE
from skincal.dataset.spec import ClockSpec
from skincal.errors import InputError, Problem, input_error
from skincal.files import refuse_existing, whole_folder
from skincal.imports.alignment import JoinedClock
from skincal.imports.csv_source import read_csv_files
from skincal.imports.mapping import Mapping
from skincal.imports.mapping_file import Frame
from skincal.imports.press_recording import presses_and_frames
from skincal.imports.read_mapping import read_mapping
from skincal.imports.recording import Dropped, ReadFile, Recording

if TYPE_CHECKING:
    from skincal.model import Surface


@dataclass(frozen=True)
class Imported:
    """Result of an import: what was read, written and left out, with reasons.

    There may be no frames. ``assumed`` are quantities that were not measured, ``notes`` repairs of the recording
    (clocks that wrap, stamps that are missing), ``clocks`` the alignment of other files' clocks with that of the
    taxels.
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


def import_csv(
    mapping: str | Path, out: str | Path, files: Sequence[str | Path] = (), *, force: bool = False
) -> Imported:
    """Import text files by a mapping file with a table ``[csv]``; report what was read, written and left out.

    Args:
        mapping: the mapping file.
        out: dataset to create.
        files: the recording, in the order of the session; none: the files that the mapping lists.
        force: whether to replace an existing dataset.

    Raises:
        InputError: the mapping or the recording is wrong; every violation is listed.
        OSError: the disk is full, or not writable; then nothing is left behind.
    """
    return _imported(mapping, "csv", out, files, read_csv_files, force=force)


def import_rosbag(
    mapping: str | Path, out: str | Path, bags: Sequence[str | Path] = (), *, force: bool = False
) -> Imported:
    """Import ROS bags; needs the library rosbags (``pip install skincal[ros]``).

    As :func:`import_csv`, by a mapping with a table ``[bag]``; a bag is a ROS 1 file or a ROS 2 folder.

    Raises:
        InputError: the mapping or a bag is wrong; every violation is listed.
        WorkError: the library is not installed.
        OSError: the disk is full, or not writable; then nothing is left behind.
    """
    from skincal.imports.bag_source import read_bags

    return _imported(mapping, "bag", out, bags, read_bags, force=force)


def bag_topics(bag: str | Path) -> dict[str, tuple[str, int]]:
    """Return type and number of messages of each topic of a bag, by name.

    Raises:
        InputError: the bag cannot be read.
        WorkError: the library rosbags is not installed.
    """
    from skincal.imports.bag_file import opened

    if not Path(bag).exists():
        raise input_error(str(bag), "a bag to read", "no such file")
    with opened(Path(bag), {}) as found:
        counts = Counter[str]()
        for connection in found.reader.connections:
            counts[connection.topic] += connection.msgcount
        return {topic: (found.types[topic], counts[topic]) for topic in sorted(counts)}


def _imported(
    mapping: str | Path, kind: str, out: str | Path, given: Sequence[str | Path],
    read: Callable[[Mapping, Sequence[Path], Findings], Recording], *, force: bool,
) -> Imported:  # fmt: skip
    found, findings = read_mapping(Path(mapping), kind), Findings()
    what = "a CSV file to read" if kind == "csv" else "a bag to read"
    paths = [Path(file) for file in given] or [found.resolve_file(name, what) for name in found.source.files]
    if not paths:
        fix = "Name them on the command line, or as files in the mapping."
        raise input_error(found.path.name, what, "none", fix)
    if missing := [Problem(str(path), what, "no such file") for path in paths if not path.exists()]:
        raise InputError(missing)
    refuse_existing(Path(out), found.path, *paths, force=force, marker=FILE)
    return _assemble(read(found, paths, findings), found, Path(out), findings, force=force)


def _assemble(
    recording: Recording, mapping: Mapping, out: Path, findings: Findings, *, force: bool
) -> Imported:
    """Write the dataset of a recording."""
    surface = surface_of(mapping.meta.surface, mapping.meshes) if mapping.file.frame.project else None
    placed = _placed(recording, mapping.file.frame, surface)
    presses, frames, dropped = presses_and_frames(placed, mapping, findings)
    source = mapping.meta.source or f"imported from {', '.join(file.file for file in recording.files)}"
    clock = _clock(recording, mapping)
    wiring = mapping.taxels.wiring if mapping.taxels.is_rewired else None
    meta = replace(mapping.meta, source=source, assumed=_assumed(mapping), clock=clock, wiring=wiring)
    dataset = Dataset(meta, presses, frames, mapping.positions, mapping.meshes)
    with whole_folder(out, force=force, marker=FILE) as folder:
        write_dataset_files(dataset, folder)
        checked = check_dataset(folder)
        if checked.dataset is None:
            raise InputError([_traced(problem, folder, mapping) for problem in checked.errors])
    warnings = (*findings.warnings, *(_traced(problem, folder, mapping) for problem in checked.warnings))
    return Imported(
        out, len(presses), 0 if frames is None else len(frames), recording.files, dropped, meta.assumed, warnings,
        recording.notes, recording.clocks,
    )  # fmt: skip


def _clock(recording: Recording, mapping: Mapping) -> ClockSpec | None:
    """Return the agreement of the clocks of force and taxels: the mapping's sigma, and that of an estimated offset."""
    given, force = mapping.meta.clock, mapping.quantity("force_n")
    found = [one.sigma_s for one in recording.clocks if one.estimated and force and one.name == force.topic]
    if not found:
        return given
    given = given or ClockSpec()
    return replace(given, sigma_s=float(np.hypot(given.sigma_s, max(found))))


def _assumed(mapping: Mapping) -> tuple[str, ...]:
    """Return assumed quantities: those that the mapping lists, its constants, and positions moved onto the surface."""
    constant = [q.target for q in mapping.quantities if isinstance(q.constant, float | int)]
    whole = {*POSITION} <= {*constant}
    place = ["position"] if whole else ["position.depth"] if mapping.file.frame.project else []
    others = [name for name in constant if not (whole and name in POSITION)]
    return tuple(dict.fromkeys((*mapping.meta.assumed, *place, *others)))


def _traced(problem: Problem, folder: Path, mapping: Mapping) -> Problem:
    """Return a problem of the dataset with the place in the mapping that its column comes from.

    The temporary folder is left out: it no longer exists.
    """
    problem = replace(problem, place=problem.place.removeprefix(f"{folder}/"))
    if problem.place.startswith(f"{FILE},"):
        return replace(problem, place=f"{mapping.path.name}{problem.place.removeprefix(FILE)}")
    names = re.findall(r"\w+", problem.place)
    found = [q for q in mapping.quantities if q.target in names]
    origins = [q.place + ("" if q.unit.name == "1" else f', unit "{q.unit.name}"') for q in found]
    if not found and any(name.startswith("taxel_") for name in names):
        origins = [mapping.taxels.place]
    origin = f" ({'; '.join(dict.fromkeys(origins))})" if origins else ""
    return replace(problem, place=f"imported {problem.place}{origin}")


def _placed(recording: Recording, frame: Frame, surface: Surface | None) -> Recording:
    columns = dict(recording.columns)
    rotation, translation = frame.rotation, np.asarray(frame.translation_m)
    moves = translation.any() or not np.array_equal(rotation, np.eye(3))
    for names, shift in ((POSITION, True), (TARGET, True), (NORMAL, False)):
        if not any(name in columns for name in names):
            continue
        points = recording.vector(names)
        if moves:
            points = points @ rotation.T + (translation if shift else 0.0)
        given = np.isfinite(points).all(axis=1)
        if shift and frame.project and surface is not None and given.any():
            points[given] = surface.project(points[given])
        columns |= dict(zip(names, points.T, strict=True))
    return replace(recording, columns=columns)
