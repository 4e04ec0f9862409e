"""The error for a well-formed dataset that cannot be used: the dataset, the reason and the advice."""

from __future__ import annotations

from skincal.dataset.dataset import Dataset
from skincal.errors import WorkError
from skincal.units import in_unit


def refusal(dataset: Dataset, reason: str) -> WorkError:
    """Return the error for a dataset that cannot be used for a reason."""
    end = "" if reason.endswith((".", "?")) else "."
    text = in_unit(reason, dataset.meta.sensor.unit)
    return WorkError(f"{dataset.folder or 'the dataset'}: {text}{end}")
