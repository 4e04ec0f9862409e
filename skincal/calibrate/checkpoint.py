"""Checkpoints: parts of an interrupted fit, stored next to its output until the fit is done."""

from __future__ import annotations

import hashlib
import json
import logging
import re
import shutil
from contextlib import suppress
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any

import numpy as np

from skincal.bounded import read_arrays
from skincal.files import whole_file
from skincal.fitting.fit_options import FitOptions, SearchBox
from skincal.fitting.general_table import SkinTable, TableReach
from skincal.fitting.grid import GridSlab
from skincal.version import __version__

_log = logging.getLogger("skincal")

_TABLE_FIELDS = ("shares", "lit", "plane", "anchor_m", "slot", "log_ratio", "centre")
"""Arrays of an image table."""
_READ_ERRORS = (OSError, ArithmeticError, LookupError, TypeError, ValueError)
"""Exceptions that reading a damaged file may raise."""

_OWN_FILES = re.compile(r"(turn|table)-.*\.npz|\.(turn|table)-.*\.part")
"""Names of the files that a fit stores in its folder."""

_SLAB_FIELDS = ("mse_counts2", "scale_per_n", "slack_rms_m")
"""Arrays of a turn of the grid."""


_LATER = frozenset(
    {"bound_counts2", "level", "draws", "rounds", "round_size", "enough_draws", "per_taxel", "law_spreads_m"}
)
"""Options that act only after the grid, so that they may change between runs."""


def fit_key(dataset_sha256: str, method: str, options: FitOptions, box: SearchBox) -> str:
    """Return a hash of what the evaluated grid depends on."""
    early = {name: value for name, value in asdict(options).items() if name not in _LATER}
    depends = [__version__, dataset_sha256, method, early, asdict(box)]
    return hashlib.sha256(json.dumps(depends, sort_keys=True).encode()).hexdigest()


def checkpoint_folder(out: Path) -> Path:
    """Return the folder of the checkpoint of a fit with output ``out``."""
    return out.parent / f".{out.name}.fit"


class Checkpoint:
    """A folder with one file for each turn of the grid and for each part of an image table."""

    def __init__(self, folder: Path, key: str) -> None:
        self.folder, self.key = folder, key

    def load(self) -> dict[int, GridSlab]:
        """Return the stored turns of this fit; a damaged file counts as absent."""
        slabs: dict[int, GridSlab] = {}
        for file in sorted(self.folder.glob("turn-*.npz")) if self.folder.is_dir() else []:
            try:
                arrays = read_arrays(file, self.folder)
                fields = [arrays[name] for name in _SLAB_FIELDS]
                whole = len({(field.shape, field.dtype) for field in fields}) == 1
                if str(arrays["key"]) == self.key and whole and fields[0].dtype == np.float64:
                    slabs[int(arrays["turn"])] = GridSlab(*fields)
            except _READ_ERRORS:
                continue
        if self.folder.is_dir() and not slabs:
            _log.warning("%s: nothing of this fit; it begins anew", self.folder)
        return slabs

    def keep(self, turn: int, slab: GridSlab) -> None:
        """Store one turn; the file is written completely or not at all.

        Raises:
            OSError: the disk is full, or not writable; it names the file.
        """
        self._write(f"turn-{turn:03d}.npz", turn=turn, **{name: getattr(slab, name) for name in _SLAB_FIELDS})

    def _write(self, name: str, **arrays: Any) -> None:
        """Write arrays with the key of the fit to a file."""
        self.folder.mkdir(parents=True, exist_ok=True)
        with whole_file(self.folder / name, force=True) as temporary, temporary.open("wb") as stream:
            np.savez(stream, key=self.key, **arrays)

    def table(self, name: str) -> SkinTable | None:
        """Return a stored image table of this fit; None if there is none, or it is damaged."""
        try:
            arrays = read_arrays(self.folder / f"table-{name}.npz", self.folder)
            if str(arrays["key"]) != self.key:
                return None
            reach = TableReach(*arrays["reach"].tolist())
            reach = replace(reach, levels=int(reach.levels))
            return SkinTable(**{field: arrays[field] for field in _TABLE_FIELDS}, reach=reach)
        except _READ_ERRORS:
            return None

    def keep_table(self, name: str, table: SkinTable) -> None:
        """Store an image table; the file is written completely or not at all.

        Raises:
            OSError: the disk is full, or not writable; it names the file.
        """
        arrays = {field: getattr(table, field) for field in _TABLE_FIELDS}
        reach = np.array(list(asdict(table.reach).values()), dtype=np.float64)
        self._write(f"table-{name}.npz", reach=reach, **arrays)

    def remove(self) -> None:
        """Remove the stored files after the fit, and the folder if it is then empty."""
        with suppress(OSError):
            for one in list(self.folder.iterdir()):
                if not _OWN_FILES.fullmatch(one.name):
                    continue
                if one.is_dir():
                    shutil.rmtree(one, ignore_errors=True)
                else:
                    one.unlink()
            self.folder.rmdir()
