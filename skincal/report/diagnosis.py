"""The report of a diagnosis: what other programs read."""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from skincal.dataset import Dataset
    from skincal.diagnose.diagnosis import Diagnosis

SUMMARY = "diagnosis.json"


def write_diagnosis_report(
    found: Diagnosis, dataset: Dataset, folder: Path, told: Mapping[str, Any], *, pages: bool = True
) -> None:
    """Writes ``diagnosis.json`` beside a calibration.

    Args:
        found: the diagnosis.
        dataset: that was diagnosed.
        folder: where to.
        told: the summary, plain values only.
        pages: whether pages and pictures are wanted.
    """
    del found, dataset, pages
    (folder / SUMMARY).write_text(json.dumps(told, indent=1, allow_nan=False) + "\n", encoding="utf-8")
