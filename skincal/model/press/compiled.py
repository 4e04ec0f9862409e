"""The compiled routine: its entry points, their types, and where they are cached."""

from __future__ import annotations

from typing import Any

from numba.core import types

from skincal.model.press import balance, casting, meet, routine
from skincal.model.press.jit import SETTINGS, cached, reporting_compilation, stamp

_F1, _F2 = types.float64[::1], types.float64[:, ::1]
_F3, _S2 = types.float64[:, :, ::1], types.float32[:, ::1]
_R1, _R2 = (types.Array(types.float64, n, "C", readonly=True) for n in (1, 2))
_I1 = types.int64[::1]
_F, _I, _B = types.float64, types.int64, types.boolean
_FLAGS = types.boolean[::1]
_PLACES = _F2, _B, _F1
"""Types of rows, of the flag for rotations, and of forces."""
_LAW = _F, _F, _F
_OUT = _F2, _F2, _I1, _I1, _F1
_SELECT = _F2, _F2, *_PLACES, *_LAW, _F2, _I1, _I1, _F3, _F1, _F2, _F, _FLAGS, _R1, _F, _F, _I1
_PRESS_CAST = (
    *(_F2, _I1, _F1, _F, *_PLACES, *_LAW, *_OUT),
    *(_I1, _I1, _I1, _I1, types.int32[::1], _R2, _R1, _R1, _F1, _FLAGS),
)
SIGNATURES: dict[str, tuple[Any, Any]] = {
    "depth": (balance.linear_depth, _F(_F1, _F1, _I, _F, _F)),
    "cast": (meet.cast, types.void(_I, _F, _F1, _F2, _F1, _F1)),
    "group": (routine.group, _I(*_PLACES, _F2, _F2, _I1, _I1)),
    "press": (routine.press, types.void(_F2, _I1, _F1, _F2, _I, _F, _F, *_PLACES, *_LAW, *_OUT)),
    "enclose": (casting.enclose, types.void(_F2, _I1, _F2, _F2, _F2, _B, _I1, _F3)),
    "select": (casting.select, types.Tuple((_I1, _S2, _S2))(*_SELECT)),
    "press_cast": (casting.press_cast, types.void(*_PRESS_CAST)),
}
"""Entry points by name, each with its only signature."""


class Routine:
    """The entry points as attributes, each compiled or loaded from the cache at first use.

    The cache is ``NUMBA_CACHE_DIR`` if set, else a folder next to the sources, else the user's cache folder. If none of
    them is writable, every process compiles for itself.
    """

    def __getattr__(self, name: str) -> Any:
        if name not in SIGNATURES:
            raise AttributeError(name)
        with reporting_compilation():
            function, signature = SIGNATURES[name]
            # numba only checks whether the entry point's own file has changed; the digest covers the other files.
            entry = cached(
                getattr(function, "py_func", function), f"{name}_{stamp()[:16]}", SETTINGS, signature
            )
        setattr(self, name, entry)
        return entry
