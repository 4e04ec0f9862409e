"""The imports as functions, from a mapping file and a recording to a dataset."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path

from skincal.dataset.findings import Findings
from skincal.dataset.meta_file import FILE
from skincal.errors import input_error
from skincal.files import refuse_existing
from skincal.imports.assembly import Imported, assemble, resolved
from skincal.imports.csv_source import read_csv_files
from skincal.imports.mapping import Mapping
from skincal.imports.read_mapping import read_mapping
from skincal.imports.recording import Recording


def import_csv(
    mapping: str | Path, out: str | Path, files: Sequence[str | Path] = (), *, force: bool = False
) -> Imported:
    """Import text files.

    Args:
        mapping: the mapping file, with a table ``[csv]``.
        out: dataset to create.
        files: the recording, in the order of the session; none: the files that the mapping lists.
        force: whether to replace an existing dataset.

    Returns:
        A report of what was read, written and left out.

    Raises:
        InputError: the mapping or the recording is wrong; every violation is listed.
        OSError: the disk is full, or not writable; then nothing is left behind.
    """
    return _imported(Path(mapping), "csv", Path(out), files, read_csv_files, force=force)


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

    return _imported(Path(mapping), "bag", Path(out), bags, read_bags, force=force)


_READ = {"csv": "a CSV file to read", "bag": "a bag to read"}
"""Expected kind of recording in errors, by the kind of mapping."""


def _imported(
    mapping: Path,
    kind: str,
    out: Path,
    given: Sequence[str | Path],
    read: Callable[[Mapping, Sequence[Path], Findings], Recording | None],
    *,
    force: bool,
) -> Imported:
    """Read a recording by its mapping, and write its dataset."""
    found = read_mapping(mapping, kind)
    paths = resolved(found, [Path(file) for file in given], found.source.files, _READ[kind])
    refuse_existing(out, mapping, *paths, force=force, marker=FILE)
    findings = Findings()
    recording = read(found, paths, findings)
    findings.raise_errors()
    assert recording is not None
    return assemble(recording, found, out, findings, force=force)


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
        counts = {c.topic: 0 for c in found.reader.connections}
        for connection in found.reader.connections:
            counts[connection.topic] += connection.msgcount
        return {topic: (found.types[topic], counts[topic]) for topic in sorted(counts)}
