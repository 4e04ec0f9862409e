"""Importers: recordings in CSV files and ROS bags become datasets by a mapping file.

Names are loaded when they are asked for: the processes that read foreign files need little of what an import does.
"""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from skincal.imports.importing import Dropped, Imported, ReadFile, bag_topics, import_csv, import_rosbag

__all__ = ["Dropped", "Imported", "ReadFile", "bag_topics", "import_csv", "import_rosbag", "template"]


def __dir__() -> list[str]:
    return __all__


def __getattr__(name: str) -> object:
    if name not in __all__:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    from skincal.imports import importing

    return getattr(importing, name)


def template(kind: str) -> str:
    """Return a working mapping file with comments: ``csv``, ``rosbag``, or that of a public data set.

    Raises:
        InputError: there is no file of that name.
    """
    from skincal.dataset.findings import meant
    from skincal.errors import input_error

    files = {path.stem: path for path in sorted((Path(__file__).parent / "templates").glob("*.toml"))}
    if kind not in files:
        raise input_error("template", f"one of {', '.join(files)}", f'"{kind}"', meant(kind, files))
    return files[kind].read_text(encoding="utf-8")
