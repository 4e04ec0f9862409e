"""Importers: recordings in CSV files and ROS bags become datasets by a mapping file.

Names are loaded when they are asked for: the processes that read foreign files need little of what an import does.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from skincal.imports.assembly import Imported
    from skincal.imports.importing import bag_topics, import_csv, import_rosbag
    from skincal.imports.recording import Dropped, ReadFile
    from skincal.imports.templates import template

_MODULES = {
    "assembly": ("Imported",),
    "importing": ("bag_topics", "import_csv", "import_rosbag"),
    "recording": ("Dropped", "ReadFile"),
    "templates": ("template",),
}

__all__ = ["Dropped", "Imported", "ReadFile", "bag_topics", "import_csv", "import_rosbag", "template"]


def __dir__() -> list[str]:
    return __all__


def __getattr__(name: str) -> object:
    module = next((module for module, names in _MODULES.items() if name in names), None)
    if module is None:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    import importlib

    return getattr(importlib.import_module(f"{__name__}.{module}"), name)
