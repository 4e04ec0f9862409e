"""Compilation of the routine: numba's settings, and its cache.

Device functions are plain scalar code on arrays that are passed in, so that another target (a GPU) can compile the same
source.
"""

from __future__ import annotations

import hashlib
import inspect
import sys
from collections.abc import Callable
from contextlib import AbstractContextManager
from typing import Any, TypeVar, cast

import numba
from numba.core import event

from skincal import compiling

_Function = TypeVar("_Function", bound=Callable[..., Any])

SETTINGS: dict[str, Any] = {
    "nogil": True,
    "error_model": "numpy",
    "no_cfunc_wrapper": True,
    "fastmath": {"reassoc", "contract", "nsz", "arcp", "nnan"},
}
"""Sums may be taken in vectors. Infinity keeps its meaning, which ``fastmath=True`` would take away; the routine is not
given NaN, and makes none."""

_INLINED: dict[str, Any] = {"forceinline": True, "no_cpython_wrapper": True, **SETTINGS}
"""Compiling how Python would call a function takes as long again; called from Python without it, it would crash."""
_EXACT: dict[str, Any] = {**_INLINED, "fastmath": False}
_modules: set[str] = set()


def device(function: _Function) -> _Function:
    """Compile a function that only compiled functions call.

    It is compiled into each of them. Called as a function, it would be optimised twice, by itself and in what calls it,
    and the process that compiles would take the one, those that read the cache the other: sums in another order.
    """
    _modules.add(function.__module__)
    return cast(_Function, numba.njit(**_INLINED)(function))


def plain_device(function: _Function) -> _Function:
    """Compile as :func:`device` does, with arithmetic as it is written, for a function that looks for NaN."""
    _modules.add(function.__module__)
    return cast(_Function, numba.njit(**_EXACT)(function))


def stamp() -> str:
    """Return a digest of the sources of all device functions."""
    sources = [inspect.getsource(sys.modules[name]) for name in sorted(_modules)]
    return hashlib.sha256("".join(sources).encode()).hexdigest()


def cached(function: Any, name: str, settings: dict[str, Any], *signature: Any) -> Any:
    """Compile an entry point, or fetch it from the cache.

    Args:
        function: that Python calls.
        name: of the cache file.
        settings: numba's.
        signature: types of what it takes, if it is to be compiled for these alone, and now.
    """
    function.__qualname__ = name
    try:
        return numba.njit(*signature, cache=True, **settings)(function)
    except RuntimeError:  # no folder to cache in
        return numba.njit(*signature, **settings)(function)


class _Listener(event.Listener):
    """Says once in a process that something is compiled."""

    said = False

    def on_start(self, event: Any) -> None:
        """See :class:`numba.core.event.Listener`."""
        if compiling.on_compile is not None and not self.said:
            compiling.on_compile()
        self.said = True

    def on_end(self, event: Any) -> None:
        """See :class:`numba.core.event.Listener`."""


_LISTENER = _Listener()


def telling() -> AbstractContextManager[None]:
    """Within it, call back once in a process when something is compiled (:mod:`skincal.compiling`)."""
    install: Any = event.install_listener  # pyright: ignore[reportUnknownMemberType, reportUnknownVariableType]
    return install("numba:compile", _LISTENER)
