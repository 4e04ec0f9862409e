"""Results that take long are made once a test run, by the first of its processes that needs them."""

from __future__ import annotations

import fcntl
import pickle
from collections.abc import Callable
from functools import cache, wraps
from pathlib import Path
from typing import ParamSpec, TypeVar

Given = ParamSpec("Given")
Made = TypeVar("Made")

folders: list[Path] = []
"""The folder that the processes of a run share; none if there is one process."""


def made_once(make: Callable[Given, Made]) -> Callable[Given, Made]:
    """Cache a function of hashable arguments in this process, and in a file for the others."""

    @cache
    @wraps(make)
    def get(*args: Given.args, **named: Given.kwargs) -> Made:
        if not folders:
            return make(*args, **named)
        name = "".join(c if c.isalnum() else "-" for c in f"{make.__module__} {make.__name__} {args} {named}")
        file = folders[0] / f"{name}.pickle"
        with file.with_suffix(".lock").open("w") as lock:
            fcntl.flock(lock, fcntl.LOCK_EX)
            if not file.exists():
                made = pickle.dumps(make(*args, **named))
                file.write_bytes(made)
            return pickle.loads(file.read_bytes())

    return get
