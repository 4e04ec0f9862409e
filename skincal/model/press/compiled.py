"""The compiled routine: its entry points, their types, and where they are cached."""

from __future__ import annotations

from collections.abc import Callable
from types import SimpleNamespace
from typing import Any

import numba
from numba.core import event, types

from skincal.model.press import routine
from skincal.model.press.jit import SETTINGS, stamp

_F1, _F2 = types.float64[::1], types.float64[:, ::1]
_I1 = types.int64[::1]
_F, _I, _B = types.float64, types.int64, types.boolean
SIGNATURES = {
    "press": types.void(
        _F2, _I1, _F1, _F2, _I, _F, _F, _F2, _B, _I1, _F1, _F, _F, _F, _F2, _F2, _I1, _I1, _F1
    ),
}
"""Entry points by name, with the types of what they take: compiled for these and no others."""


def load(on_compile: Callable[[], None] | None) -> Any:
    """The entry points, by name.

    The cache lies beside the sources, or in the user's cache folder where that cannot be written to, or in
    ``NUMBA_CACHE_DIR``. Where there is no place at all, every process compiles for itself.

    Args:
        on_compile: called once before something is compiled.
    """
    listener = _Listener(on_compile)
    install: Any = event.install_listener  # pyright: ignore[reportUnknownMemberType, reportUnknownVariableType]
    with install("numba:compile", listener):
        return SimpleNamespace(**{name: _compile(name, types_) for name, types_ in SIGNATURES.items()})


def _compile(name: str, signature: Any) -> Any:
    function = getattr(routine, name)
    # Part of the name of the cache file: numba knows only whether the file with the entry point has changed.
    function.__qualname__ = f"{name}_{stamp()[:16]}"
    try:
        return numba.njit(signature, cache=True, **SETTINGS)(function)
    except RuntimeError:  # no folder to cache in
        return numba.njit(signature, **SETTINGS)(function)


class _Listener(event.Listener):
    """Says once that something is compiled."""

    def __init__(self, on_compile: Callable[[], None] | None) -> None:
        self._say = on_compile

    def on_start(self, event: Any) -> None:
        """See :class:`numba.core.event.Listener`."""
        if self._say is not None:
            self._say()
            self._say = None

    def on_end(self, event: Any) -> None:
        """See :class:`numba.core.event.Listener`."""
