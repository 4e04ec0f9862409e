"""Why nothing can be done with a dataset that is well formed: which one, what is wrong, what to do."""

from __future__ import annotations

from skincal.dataset.dataset import Dataset
from skincal.errors import WorkError


def refusal(dataset: Dataset, reason: str) -> WorkError:
    """Return the error that says which dataset cannot be used, and why.

    Args:
        dataset: is named by its folder, where it has one.
        reason: what is wrong and what to do; one or a few sentences.
    """
    end = "" if reason.endswith((".", "?")) else "."
    return WorkError(f"{dataset.folder or 'the dataset'}: {reason}{end}")
