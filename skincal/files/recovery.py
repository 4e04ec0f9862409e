"""Recovery from killed processes: remove or restore what they left next to an output."""

from __future__ import annotations

import logging
import os
import re
import shutil
from contextlib import suppress
from pathlib import Path

from skincal.files.locks import lock
from skincal.files.manifest import NAME, TEMPORARY

_log = logging.getLogger("skincal")


def recover(path: Path) -> None:
    """Remove leftovers of killed processes next to an output, and restore an output that was moved away.

    What another process is writing now stays. Actions are logged as warnings.
    """
    named = re.compile(TEMPORARY.format(name=re.escape(path.name)))
    left: list[Path] = []
    with suppress(OSError):
        left = sorted(
            one for one in path.parent.iterdir() if named.fullmatch(one.name) and not one.is_symlink()
        )
    parts = [one for one in left if one.suffix == ".part"]
    swept = [part for part in parts if _remove_abandoned(part)]
    if len(swept) < len(parts):
        return  # another process may be between two moves
    for old in (one for one in left if one.suffix == ".old"):
        if os.path.lexists(path):
            shutil.rmtree(old, ignore_errors=True)
            swept.append(old)
        else:
            old.rename(path)
            _log.warning("%s: restored; an interrupted run had moved it away", path)
    if swept:
        names = ", ".join(one.name for one in swept)
        _log.warning("%s: removed leftovers of interrupted runs: %s", path, names)


def _remove_abandoned(part: Path) -> bool:
    """Remove a temporary folder that no process writes into; return whether it was removed."""
    try:
        descriptor = lock(part / NAME, create=True, strict=True)
    except OSError:
        return False
    if descriptor is None:
        return False
    try:
        shutil.rmtree(part, ignore_errors=True)
    finally:
        os.close(descriptor)
    return True
