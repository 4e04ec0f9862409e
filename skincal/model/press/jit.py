"""Compilation of the routine: numba's settings, and its cache.

Device functions are scalar code on arrays that the caller passes in, so that another target (a GPU) can compile the
same source.
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

from skincal import progress

_Function = TypeVar("_Function", bound=Callable[..., Any])

SETTINGS: dict[str, Any] = {
    "nogil": True,
    "error_model": "numpy",
    "no_cfunc_wrapper": True,
    "fastmath": {"reassoc", "contract", "nsz", "arcp", "nnan"},
}
"""Sums may be vectorised. Unlike ``fastmath=True``, these flags preserve infinity. Device functions neither receive nor
produce NaN."""

_INLINED: dict[str, Any] = {"forceinline": True, "no_cpython_wrapper": True, **SETTINGS}
"""Without a wrapper for calls from Python, which doubles the compile time; a call from Python would crash."""
_EXACT: dict[str, Any] = {**_INLINED, "fastmath": False}
_modules: set[str] = set()


def device(function: _Function) -> _Function:
    """Compile a function that only compiled functions call, by inlining it into each of them.

    Without inlining it would be optimised both by itself and within its callers. The process that compiles would then
    use one version and processes that read the cache the other, with sums in a different order.
    """
    _modules.add(function.__module__)
    return cast(_Function, numba.njit(**_INLINED)(function))


def plain_device(function: _Function) -> _Function:
    """Compile as :func:`device` does, but with exact arithmetic, for a function that checks for NaN."""
    _modules.add(function.__module__)
    return cast(_Function, numba.njit(**_EXACT)(function))


def stamp() -> str:
    """Return a digest of the sources of all device functions."""
    sources = [inspect.getsource(sys.modules[name]) for name in sorted(_modules)]
    return hashlib.sha256("".join(sources).encode()).hexdigest()


def cached(function: Any, name: str, settings: dict[str, Any], *signature: Any) -> Any:
    """Compile an entry point, or load it from the cache.

    Args:
        function: function that Python calls.
        name: name of the cache file.
        settings: numba's settings.
        signature: the only signature, compiled at once; default: compiled at the first call.
    """
    function.__qualname__ = name
    try:
        return numba.njit(*signature, cache=True, **settings)(function)
    except RuntimeError:  # no folder to cache in
        return numba.njit(*signature, **settings)(function)


class _Listener(event.Listener):
    """Report once per process that something is compiled."""

    reported = False

    def on_start(self, event: Any) -> None:
        """See :class:`numba.core.event.Listener`."""
        if progress.on_compile is not None and not self.reported:
            progress.on_compile()
        self.reported = True

    def on_end(self, event: Any) -> None:
        """See :class:`numba.core.event.Listener`."""


_LISTENER = _Listener()


def reporting_compilation() -> AbstractContextManager[None]:
    """Return a context that reports a compilation once per process (:mod:`skincal.progress`)."""
    install: Any = event.install_listener  # pyright: ignore[reportUnknownMemberType, reportUnknownVariableType]
    return install("numba:compile", _LISTENER)
