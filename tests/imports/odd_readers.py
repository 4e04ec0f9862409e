"""Readers that fail in every way; the process that they run in imports this module and nothing heavy."""

from __future__ import annotations

import os
import signal
import time
from pathlib import Path

from skincal.bounded import UnreadableError
from skincal.errors import InputError, Problem


def double(path: Path, factor: int) -> str:
    print("a library says something")
    return str(path) * factor


def refuse(path: Path) -> None:
    raise InputError([Problem(str(path), "a bag", "none")])


def find_no_array(_: Path) -> None:
    raise UnreadableError("an array", "none")


def crash(_: Path) -> None:
    os.kill(os.getpid(), signal.SIGSEGV)


def hoard(_: Path) -> int:
    return len(bytearray(1 << 40))


def wait(_: Path) -> None:
    time.sleep(600)


def work(_: Path) -> None:
    while True:
        pass
