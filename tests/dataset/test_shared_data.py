"""Datasets that others made, measured and simulated, load as they are."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from skincal.dataset import HOLD, active_taxels, read_dataset, write_dataset
from skincal.dataset.plausibility import hold_means
from skincal.dataset.rest import summarise


def test_practice_sessions(shared: Path) -> None:
    folders = sorted(path.parent for path in shared.glob("practice/*/dataset.toml"))
    assert folders
    for folder in folders:
        dataset = read_dataset(folder)
        assert dataset.warnings == (), folder
        assert dataset.presses.counts.shape == (len(dataset.presses), 16)
        assert 10 <= summarise(dataset).usable <= len(dataset.presses)
        frames = dataset.frames
        assert (frames is not None) == (folder / "frames.parquet").exists()
        if frames is None:
            continue
        # The table of presses holds the means over the hold, so both are read in the same order.
        assert np.sum(frames.phase == HOLD) > 1000
        np.testing.assert_allclose(hold_means(dataset, frames.force_n), dataset.presses.force_n, atol=1e-3)
        for j in range(16):
            np.testing.assert_allclose(
                hold_means(dataset, frames.counts[:, j]), dataset.presses.counts[:, j], atol=1e-3
            )


def test_the_insole(shared: Path, tmp_path: Path) -> None:
    dataset = read_dataset(shared / "real" / "insole")
    assert dataset.presses.counts.shape == (35, 280)
    assert dataset.meta.created is not None
    assert set(dataset.presses.columns["branch"]) == {"up", "down"}
    assert "pressure_pa" in dataset.presses.columns
    (warning,) = dataset.warnings
    assert "255 from taxel_14_0" in warning.got and not warning.code
    assert not active_taxels(dataset)[:, 140:150].any()
    write_dataset(dataset, tmp_path / "copy", presses_as="parquet", frames_as="csv")
    copy = read_dataset(tmp_path / "copy")
    assert copy.meta == dataset.meta
    np.testing.assert_array_equal(copy.presses.counts, dataset.presses.counts)
    np.testing.assert_array_equal(copy.frames.counts, dataset.frames.counts)  # type: ignore[union-attr]
