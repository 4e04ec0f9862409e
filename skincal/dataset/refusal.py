"""The error of a well-formed dataset that cannot be used: which dataset, what is wrong, what to do."""

from __future__ import annotations

from skincal.dataset.dataset import Dataset
from skincal.errors import WorkError
from skincal.units import in_unit


def refusal(dataset: Dataset, reason: str) -> WorkError:
    """Return the error that a dataset cannot be used, with the reason."""
    end = "" if reason.endswith((".", "?")) else "."
    text = in_unit(reason, dataset.meta.sensor.unit)
    return WorkError(f"{dataset.folder or 'the dataset'}: {text}{end}")
