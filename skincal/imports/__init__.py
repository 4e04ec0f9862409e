"""Importers: recordings in CSV files and ROS bags become datasets by a mapping file.

Names are loaded when they are asked for: the processes that read foreign files need little of what an import does.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from skincal.imports.importing import Dropped, Imported, ReadFile, bag_topics, import_csv, import_rosbag
    from skincal.imports.templates import template

__all__ = ["Dropped", "Imported", "ReadFile", "bag_topics", "import_csv", "import_rosbag", "template"]


def __dir__() -> list[str]:
    return __all__


def __getattr__(name: str) -> object:
    if name not in __all__:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    from skincal.imports import importing, templates

    return getattr(templates if name == "template" else importing, name)
