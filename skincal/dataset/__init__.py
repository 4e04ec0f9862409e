"""Datasets: a folder of presses, read, checked and written (contract ``skincal-dataset/1``)."""

from skincal.dataset.dataset import Dataset
from skincal.dataset.folder import Check, check_dataset, read_dataset, write_dataset
from skincal.dataset.meta_file import dataset_hash
from skincal.dataset.rest import ACTIVE_COUNTS, active_taxels, idle_means, rest_levels
from skincal.dataset.spec import (
    FORMAT,
    ClockSpec,
    DatasetMeta,
    ForceSpec,
    IndenterSpec,
    MountSpec,
    PositionSpec,
    SensorSpec,
    SurfaceSpec,
)
from skincal.dataset.tables import HOLD, IDLE, LOAD, PHASES, UNLOAD, Frames, Presses, TaxelPositions

__all__ = [
    "ACTIVE_COUNTS", "FORMAT", "HOLD", "IDLE", "LOAD", "PHASES", "UNLOAD", "Check", "ClockSpec", "Dataset",
    "DatasetMeta", "ForceSpec", "Frames", "IndenterSpec", "MountSpec", "PositionSpec", "Presses", "SensorSpec",
    "SurfaceSpec", "TaxelPositions", "active_taxels", "check_dataset", "dataset_hash", "idle_means", "read_dataset",
    "rest_levels", "write_dataset",
]  # fmt: skip
