"""The functions of the compiled routine, made again for a GPU: the same source, in single or double precision."""

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
"""numba's CUDA target, which says little of its types."""
Precision = Literal["single", "double"]
_Function = TypeVar("_Function", bound=Callable[..., Any])


def cooperative(function: _Function) -> _Function:
    """Mark a function that all threads of a block call together; it is compiled for no processor."""
    return cast(_Function, numba.njit(**SETTINGS)(function))


class Target:
    """Makes device functions out of functions that were compiled for the processor.

    In single precision every constant is rounded to it: a constant in double precision would turn what it meets into
    double precision too, which most GPUs compute slowly.

    Args:
        precision: of all real numbers.
        constants: names that functions find in their module, with another value.
    """

    def __init__(self, precision: Precision, **constants: int) -> None:
        self._single = precision == "single"
        self.real = np.float32 if self._single else np.float64
        self._constants = {"REAL": numba.float32 if self._single else numba.float64, **constants}
        self._modules: dict[str, dict[str, Any]] = {}

    def kernel(self, function: Callable[..., Any]) -> Any:
        """Return a kernel, to be launched from the host."""
        return cuda.jit(fastmath=SETTINGS["fastmath"])(self.again(function))

    def again(self, function: Any) -> FunctionType:
        """Return the function with constants and globals of this target."""
        code: CodeType = function.__code__
        constants = tuple(self._rounded(value) for value in code.co_consts)
        code = code.replace(co_consts=constants) if self._single else code
        return FunctionType(code, self._names(function.__globals__), function.__name__)

    def _names(self, given: dict[str, Any]) -> dict[str, Any]:
        """Return the names of a module, one dictionary each, with its functions made for this target."""
        module = given["__name__"]
        if module not in self._modules:
            names = self._modules[module] = dict(given)
            for name, value in given.items():
                if isinstance(value, CPUDispatcher):
                    fast = value.targetoptions.get("fastmath", False)
                    names[name] = cuda.jit(device=True, fastmath=fast)(self.again(value.py_func))
                else:
                    names[name] = self._rounded(value)
            names |= {name: value for name, value in self._constants.items() if name in given}
        return self._modules[module]

    def _rounded(self, value: Any) -> Any:
        return np.float32(value) if self._single and isinstance(value, float) else value
