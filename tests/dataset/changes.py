"""Changes of datasets that several tests make."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np

from skincal.dataset import Dataset


def with_sensor(dataset: Dataset, **changes: Any) -> Dataset:
    """The dataset with other values of ``[sensor]``."""
    sensor = replace(dataset.meta.sensor, **changes)
    return replace(dataset, meta=replace(dataset.meta, sensor=sensor))


def with_presses(dataset: Dataset, **changes: Any) -> Dataset:
    """The dataset with other values of its presses."""
    return replace(dataset, presses=replace(dataset.presses, **changes))


def loads(dataset: Dataset) -> np.ndarray:
    """Counts of the presses above the lowest of each taxel (K, J)."""
    return dataset.presses.counts - dataset.presses.counts.min(axis=0)
