"""Learn policies, write them to files without code, and evaluate them.

What learning needs (torch, Stable-Baselines3) is loaded only when something is learned: a policy file is read and run
without it.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from skincal.tasks import PUBLISHED_STEPS, BackendName, PolicyKind, Task

if TYPE_CHECKING:
    from skincal.train.curve import Round, read_curve
    from skincal.train.learner import make_environment, maker, parallel
    from skincal.train.onnx_file import write_policy
    from skincal.train.policy_file import (
        Description,
        Network,
        Policy,
        bundled_policies,
        policy_path,
        read_policy,
    )
    from skincal.train.settings import PpoSettings, Settings, Work
    from skincal.train.training_run import Trained, begin, read_run, train

_MODULES = {
    "curve": "Round read_curve",
    "learner": "make_environment maker parallel",
    "onnx_file": "write_policy",
    "policy_file": "Description Network Policy bundled_policies policy_path read_policy",
    "settings": "PpoSettings Settings Work",
    "training_run": "Trained begin read_run train",
}

__all__ = [
    "PUBLISHED_STEPS", "BackendName", "Description", "Network", "Policy", "PolicyKind", "PpoSettings",
    "Round", "Settings", "Task", "Trained", "Work", "begin", "bundled_policies", "make_environment",
    "maker", "parallel", "policy_path", "read_curve", "read_policy", "read_run", "train", "write_policy",
]  # fmt: skip


def __dir__() -> list[str]:
    return __all__


def __getattr__(name: str) -> Any:
    """Load a name when it is asked for: help needs no numpy, and policies need no torch."""
    module = next((module for module, names in _MODULES.items() if name in names.split()), None)
    if module is None:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    import importlib

    try:
        return getattr(importlib.import_module(f"skincal.train.{module}"), name)
    except ModuleNotFoundError as error:
        if (error.name or "").startswith("skincal"):
            raise
        from skincal.errors import input_error

        fix = "pip install 'skincal[train]'"
        raise input_error("skincal train", f"the package {error.name}", "nothing", fix) from error
