"""Paths of the sample data: in the installed package, or in the checkout that it was installed from."""

from __future__ import annotations

from pathlib import Path
from typing import Final

from skincal.errors import WorkError

NAMES: Final = ("paper-like", "short-plan.toml")


def sample_path(name: str) -> Path:
    """Path of a sample: the dataset ``paper-like``, or the plan ``short-plan.toml``.

    Raises:
        WorkError: the installation lacks it.
    """
    here = Path(__file__).parent
    for folder in (here / "sample_data", here.parent / "data"):
        if (folder / name).exists():
            return folder / name
    raise WorkError(
        f"sample {name}: expected it in the installed package; got nothing. Install skincal again."
    )
