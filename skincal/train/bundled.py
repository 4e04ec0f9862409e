"""The policies and estimators that come with skincal, by name."""

from __future__ import annotations

from pathlib import Path

from skincal.errors import input_error

FOLDER = Path(__file__).parents[1] / "policies"


def bundled_policies() -> dict[str, Path]:
    """Return the file of every policy that comes with skincal, by name."""
    return _bundled(".onnx")


def policy_path(name: str | Path) -> Path:
    """Return the file of a policy: one that exists, or that of a policy that comes with skincal.

    Raises:
        InputError: there is neither.
    """
    return _path(name, ".onnx", "a policy")


def estimator_path(name: str | Path) -> Path:
    """Return the file of an estimator, as :func:`policy_path` does."""
    return _path(name, ".npz", "an estimator")


def _bundled(suffix: str) -> dict[str, Path]:
    return {path.stem: path for path in sorted(FOLDER.glob(f"*{suffix}"))}


def _path(name: str | Path, suffix: str, what: str) -> Path:
    path, known = Path(name), _bundled(suffix)
    if not path.exists() and str(name) not in known:
        choices = f", or one of {', '.join(known)}" if known else ""
        raise input_error(str(name), f"{what} file{choices}", "no such file")
    return path if path.exists() else known[str(name)]
