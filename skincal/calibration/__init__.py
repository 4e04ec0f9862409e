"""Calibrations: what a fit found, as a folder that loads into the simulator (``skincal-calibration/1``)."""

from skincal.calibration.calibration import Calibration, Columns
from skincal.calibration.effects import EFFECT_NAMES
from skincal.calibration.files import read_calibration, write_calibration
from skincal.calibration.parts import Effect, Finding, Interval, Loss, ModelParameters, Provenance
from skincal.calibration.tables import SLACK_COLUMNS
from skincal.calibration.toml_file import FORMAT

__all__ = [
    "EFFECT_NAMES",
    "FORMAT",
    "SLACK_COLUMNS",
    "Calibration",
    "Columns",
    "Effect",
    "Finding",
    "Interval",
    "Loss",
    "ModelParameters",
    "Provenance",
    "read_calibration",
    "write_calibration",
]
