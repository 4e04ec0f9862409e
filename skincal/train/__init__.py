"""Learn policies, write them to files without code, and evaluate them.

What learning needs (torch, Stable-Baselines3) is loaded only when something is learned: a policy file is read and run
without it.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from skincal.train.tasks import PUBLISHED_STEPS, BackendName, PolicyKind, Task

if TYPE_CHECKING:
    from skincal.train.bundled import bundled_policies, policy_path
    from skincal.train.curve import read_curve
    from skincal.train.environments import make_environment, maker, parallel
    from skincal.train.network import Network
    from skincal.train.onnx_file import write_policy
    from skincal.train.policy_file import Description, Policy, read_policy
    from skincal.train.settings import PpoSettings, Settings, Work
    from skincal.train.training_run import Trained, begin, read_run, train
    from skincal.train.watch import Round

_MODULES = {
    "Description": "policy_file",
    "Network": "network",
    "Policy": "policy_file",
    "PpoSettings": "settings",
    "Round": "watch",
    "Settings": "settings",
    "Trained": "training_run",
    "Work": "settings",
    "begin": "training_run",
    "bundled_policies": "bundled",
    "make_environment": "environments",
    "maker": "environments",
    "parallel": "environments",
    "policy_path": "bundled",
    "read_curve": "curve",
    "read_policy": "policy_file",
    "read_run": "training_run",
    "train": "training_run",
    "write_policy": "onnx_file",
}

__all__ = [
    "PUBLISHED_STEPS",
    "BackendName",
    "Description",
    "Network",
    "Policy",
    "PolicyKind",
    "PpoSettings",
    "Round",
    "Settings",
    "Task",
    "Trained",
    "Work",
    "begin",
    "bundled_policies",
    "make_environment",
    "maker",
    "parallel",
    "policy_path",
    "read_curve",
    "read_policy",
    "read_run",
    "train",
    "write_policy",
]


def __dir__() -> list[str]:
    return __all__


def __getattr__(name: str) -> Any:
    """Load a name when it is asked for: help needs no numpy, and policies need no torch."""
    if name not in _MODULES:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    import importlib

    try:
        return getattr(importlib.import_module(f"skincal.train.{_MODULES[name]}"), name)
    except ModuleNotFoundError as error:
        if (error.name or "").startswith("skincal"):
            raise
        from skincal.errors import input_error

        fix = "pip install 'skincal[train]'"
        raise input_error("skincal train", f"the package {error.name}", "nothing", fix) from error
