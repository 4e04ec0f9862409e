"""The policies and estimators that come with skincal, by name."""

from __future__ import annotations

from pathlib import Path

from skincal.errors import input_error

FOLDER = Path(__file__).parents[1] / "policies"


def bundled_policies() -> dict[str, Path]:
    """File of every policy that comes with skincal, by name."""
    return {path.stem: path for path in sorted(FOLDER.glob("*.onnx"))}


def policy_path(name: str | Path) -> Path:
    """The file that is meant: one that exists, or a policy that comes with skincal.

    Raises:
        InputError: there is neither.
    """
    path = Path(name)
    if path.exists():
        return path
    known = bundled_policies()
    if str(name) in known:
        return known[str(name)]
    choices = f", or one of {', '.join(known)}" if known else ""
    raise input_error(str(name), f"a policy file{choices}", "no such file")


def estimator_path(name: str | Path) -> Path:
    """The file that is meant: one that exists, or an estimator that comes with skincal.

    Raises:
        InputError: there is neither.
    """
    path, known = Path(name), {path.stem: path for path in sorted(FOLDER.glob("*.npz"))}
    if path.exists() or str(name) not in known:
        if path.exists():
            return path
        raise input_error(str(name), f"an estimator file, or one of {', '.join(known)}", "no such file")
    return known[str(name)]
