"""Loops over time, compiled: each sample needs what the one before has left behind."""

from __future__ import annotations

from collections.abc import Callable
from functools import cached_property
from typing import Any


class Loop:
    """Plain scalar code on arrays that are passed in, compiled or loaded when it is needed; so is numba imported."""

    def __init__(self, function: Callable[..., None], signature: str) -> None:
        """Take the code, and numba's signature of what it takes."""
        self._function, self._signature = function, signature

    def __call__(self, *arrays: Any) -> None:
        """Run it."""
        self._compiled(*arrays)

    def prepare(self) -> None:
        """Compile it."""
        _ = self._compiled

    @cached_property
    def _compiled(self) -> Any:
        from skincal.model.press.jit import cached, reporting_compilation

        settings = {"nogil": True, "error_model": "numpy"}
        with reporting_compilation():
            return cached(self._function, self._function.__name__, settings, self._signature)
