"""Keeps the sessions of a blind test that have been run in one file, so that it can go on elsewhere and later.

    python -m benchmarks.blind pack DIR --out benchmarks/results/blind_sessions_23.jsonl.gz
    python -m benchmarks.blind unpack benchmarks/results/blind_sessions_23.jsonl.gz --out DIR

The file holds the study (its first line says of which code it is), what was said of each session, and its label, sealed
as it was. Unpacked, ``run`` goes on with the sessions that are missing, and ``score`` opens the labels.
"""

from __future__ import annotations

import argparse
import base64
import gzip
import json
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from benchmarks.blind.bench import RunError, write_whole

Record = dict[str, Any]

PATHS = ("calibration", "next_presses_plan")
"""What a verb says of where it wrote, which is nowhere any more."""


def packed(folder: Path) -> bytes:
    """Pack the results that ``run`` left in a folder into one file; equal sessions give equal bytes.

    Raises:
        RunError: the folder is none that ``run`` wrote.
    """
    study = folder / "study.json"
    if not study.exists():
        raise RunError(f"{folder}: expected a folder that `python -m benchmarks.blind run` wrote")
    lines = [json.loads(study.read_text(encoding="utf-8"))]
    for file in sorted((folder / "results").glob("*.json")):
        label = (folder / "labels" / f"{file.stem}.sealed").read_bytes()
        said = json.loads(file.read_text(encoding="utf-8"))
        for verb in ("fit", "diagnose"):
            for name in PATHS:
                said.get(verb, {}).get("json", {}).pop(name, None)
        lines.append({"label": base64.b64encode(label).decode("ascii"), "result": said})
    text = "".join(json.dumps(line) + "\n" for line in lines)
    return gzip.compress(text.encode(), mtime=0)


def unpack(file: Path, folder: Path) -> int:
    """Writes what :func:`packed` holds to a folder, beside what is there already; returns how many sessions.

    Raises:
        RunError: no such file, or a folder that holds another study.
    """
    try:
        study, *lines = (json.loads(line) for line in gzip.decompress(file.read_bytes()).splitlines())
    except (OSError, EOFError, ValueError) as error:
        raise RunError(f"{file}: expected what `python -m benchmarks.blind pack` wrote: {error}") from error
    check_study(folder, study)
    for line in lines:
        name = line["result"]["session"]
        write_whole(folder / "labels" / f"{name}.sealed", base64.b64decode(line["label"]))
        write_whole(
            folder / "results" / f"{name}.json", (json.dumps(line["result"], indent=1) + "\n").encode()
        )
    return len(lines)


def check_study(folder: Path, study: Record) -> None:
    """Says which test a folder holds, or refuses one that holds another.

    Raises:
        RunError: it does.
    """
    file = folder / "study.json"
    if not file.exists():
        write_whole(file, (json.dumps(study, indent=1) + "\n").encode())
        return
    found = json.loads(file.read_text(encoding="utf-8"))
    if found != study:
        raise RunError(f"{file}: holds the test {found}, not {study}; give another --out")


def main(verb: str, arguments: Sequence[str]) -> int:
    """Packs or unpacks; returns the exit status."""
    raw = argparse.RawDescriptionHelpFormatter
    parser = argparse.ArgumentParser(
        prog=f"python -m benchmarks.blind {verb}", description=__doc__, formatter_class=raw
    )
    source, target = ("folder", "file") if verb == "pack" else ("file", "folder")
    parser.add_argument("source", type=Path, help=f"{source} to read")
    parser.add_argument("--out", type=Path, required=True, help=f"{target} to write")
    given = parser.parse_args(arguments)
    try:
        if verb == "pack":
            write_whole(given.out, packed(given.source))
        else:
            print(f"{unpack(given.source, given.out)} sessions", file=sys.stderr)
    except RunError as error:
        print(error, file=sys.stderr)
        return 2
    return 0
