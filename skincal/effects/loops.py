"""Loops over time, compiled: each sample needs what the one before has left behind."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any


def loop(function: Callable[..., None], name: str, signature: str) -> Any:
    """Compile a loop, or load it; numba is imported only then.

    Args:
        function: plain scalar code on arrays that are passed in.
        name: of the cache file.
        signature: numba's, of what it takes.
    """
    from skincal.model.press.jit import cached, telling

    with telling():
        return cached(function, name, {"nogil": True, "error_model": "numpy"}, signature)
