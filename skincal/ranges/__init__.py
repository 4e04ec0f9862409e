"""Randomization ranges: what a task randomizes, how widely, and on what basis (contract ``skincal-ranges/1``)."""

from skincal.ranges.files import read_ranges, write_ranges
from skincal.ranges.from_calibration import from_calibration
from skincal.ranges.names import NAMES, Name
from skincal.ranges.parameter import Parameter
from skincal.ranges.presets import PRESETS, Narrowing, narrowing, preset
from skincal.ranges.ranges import JointDraws, Ranges

__all__ = [
    "NAMES", "PRESETS", "JointDraws", "Name", "Narrowing", "Parameter", "Ranges", "from_calibration",
    "narrowing", "preset", "read_ranges", "write_ranges",
]  # fmt: skip
