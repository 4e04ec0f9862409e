"""Keeps the finished sessions of a study, so that it can be interrupted, resumed and grown."""

from __future__ import annotations

import json
from collections.abc import Iterable
from pathlib import Path
from typing import Any

Record = dict[str, Any]
Key = tuple[str, int]
"""Law and index of a session."""


class Store:
    """The sessions that are done, one a line; the first line says which study they belong to.

    Args:
        path: of the file; made with the first session.
        study: what the sessions depend on, besides law and index.

    Raises:
        ValueError: the file holds another study.
    """

    def __init__(self, path: Path, study: Record) -> None:
        self.path, self.records = path, list[Record]()
        # As it comes back from the file: tuples are lists there.
        self._study = json.loads(json.dumps(study))
        if not path.exists():
            return
        whole = path.read_text(encoding="utf-8")
        # A line without its end was cut off when the run was.
        lines = [json.loads(line) for line in whole[: whole.rfind("\n") + 1].splitlines()]
        if lines and lines[0] != self._study:
            raise ValueError(
                f"{path} holds the sessions of another study (seed, version or options); use another --out"
            )
        path.write_text(whole[: whole.rfind("\n") + 1], encoding="utf-8")
        self.records = lines[1:]

    @property
    def done(self) -> set[Key]:
        """The sessions that are kept."""
        return {(r["law"], r["index"]) for r in self.records}

    def add(self, record: Record) -> None:
        """Keeps one more session."""
        with self.path.open("a", encoding="utf-8") as file:
            if file.tell() == 0:
                file.write(json.dumps(self._study) + "\n")
            file.write(json.dumps(record) + "\n")
        self.records.append(record)

    def of(self, keys: Iterable[Key]) -> list[Record]:
        """Records of these sessions, in their order."""
        by_key = {(r["law"], r["index"]): r for r in self.records}
        return [by_key[key] for key in keys]
