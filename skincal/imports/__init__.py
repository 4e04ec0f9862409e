"""Importers: recordings in CSV files and ROS bags become datasets by a mapping file."""

from skincal.imports.assembly import Imported
from skincal.imports.importing import bag_topics, import_csv, import_rosbag
from skincal.imports.recording import Dropped, ReadFile
from skincal.imports.templates import template

__all__ = ["Dropped", "Imported", "ReadFile", "bag_topics", "import_csv", "import_rosbag", "template"]
