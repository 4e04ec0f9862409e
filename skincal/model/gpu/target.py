"""Compilation of the CPU routine's device functions for a GPU: the same source, in single or double precision."""

from __future__ import annotations

import importlib
from collections.abc import Callable
from types import CodeType, FunctionType
from typing import Any, Literal, TypeVar, cast

import numba
import numpy as np
from numba.core.registry import CPUDispatcher

from skincal.model.press.jit import SETTINGS

cuda: Any = importlib.import_module("numba.cuda")
"""numba's CUDA target, which has few type annotations."""
Precision = Literal["single", "double"]
_Function = TypeVar("_Function", bound=Callable[..., Any])


def cooperative(function: _Function) -> _Function:
    """Mark a function that all threads of a block call together; it is only compiled for a GPU."""
    return cast(_Function, numba.njit(**SETTINGS)(function))


class Target:
    """A GPU target: turns functions that numba compiled for the CPU into device functions.

    In single precision every constant is rounded to single precision: one double constant would promote its whole
    expression to double precision, which is slow on most GPUs.

    Args:
        precision: precision of all real numbers.
        constants: global names of the functions' modules, with the values for this target.
    """

    def __init__(self, precision: Precision, **constants: int) -> None:
        self._single = precision == "single"
        self.real = np.float32 if self._single else np.float64
        self._constants = {"REAL": numba.float32 if self._single else numba.float64, **constants}
        self._modules: dict[str, dict[str, Any]] = {}

    def kernel(self, function: Callable[..., Any]) -> Any:
        """Return a kernel, to be launched from the host."""
        return cuda.jit(fastmath=SETTINGS["fastmath"])(self.retarget(function))

    def retarget(self, function: Any) -> FunctionType:
        """Return a copy of the function with the constants and globals of this target."""
        code: CodeType = function.__code__
        constants = tuple(self._rounded(value) for value in code.co_consts)
        code = code.replace(co_consts=constants) if self._single else code
        return FunctionType(code, self._names(function.__globals__), function.__name__)

    def _names(self, given: dict[str, Any]) -> dict[str, Any]:
        """Return the globals of a module, cached, with its functions compiled for this target."""
        module = given["__name__"]
        if module not in self._modules:
            names = self._modules[module] = dict(given)
            for name, value in given.items():
                if isinstance(value, CPUDispatcher):
                    fast = value.targetoptions.get("fastmath", False)
                    names[name] = cuda.jit(device=True, fastmath=fast)(self.retarget(value.py_func))
                else:
                    names[name] = self._rounded(value)
            names |= {name: value for name, value in self._constants.items() if name in given}
        return self._modules[module]

    def _rounded(self, value: Any) -> Any:
        return np.float32(value) if self._single and isinstance(value, float) else value
