"""Calibrations: results of a fit, as a folder that loads into the simulator (``skincal-calibration/1``)."""

from skincal.calibration.calibration import (
    MARGIN_M,
    Calibration,
    Columns,
    effect_from,
    effects_of,
    skin_of,
    stream_of,
)
from skincal.calibration.files import SLACK_COLUMNS, read_calibration, write_calibration
from skincal.calibration.matching import check_same_sensor, sensor_differences
from skincal.calibration.parts import (
    EFFECT_NAMES,
    Effect,
    Finding,
    FittedLaw,
    Interval,
    Loss,
    ModelParameters,
    Provenance,
)
from skincal.calibration.toml_file import FORMAT

__all__ = [
    "EFFECT_NAMES", "FORMAT", "MARGIN_M", "SLACK_COLUMNS", "Calibration", "Columns", "Effect", "Finding",
    "FittedLaw", "Interval", "Loss", "ModelParameters", "Provenance", "check_same_sensor", "effect_from",
    "effects_of", "read_calibration", "sensor_differences", "skin_of", "stream_of", "write_calibration",
]  # fmt: skip
