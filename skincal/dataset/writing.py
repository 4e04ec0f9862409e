"""Write a dataset's folder, either completely or not at all."""

from __future__ import annotations

from pathlib import Path
from typing import Literal

from skincal.dataset.companions import position_columns
from skincal.dataset.dataset import Dataset
from skincal.dataset.meta_file import FILE, write_meta
from skincal.dataset.table_file import write_table
from skincal.files import whole_folder

Format = Literal["csv", "parquet"]


def write_dataset(
    dataset: Dataset,
    path: str | Path,
    *,
    presses_as: Format = "csv",
    frames_as: Format = "parquet",
    force: bool = False,
) -> None:
    """Write a dataset as a folder (contract ``skincal-dataset/1``); numbers are read back exactly.

    Raises:
        InputError: the folder exists, and ``force`` is false.
        OSError: the disk is full or not writable; no partial folder is left behind.
    """
    with whole_folder(path, force=force, marker=FILE) as folder:
        write_dataset_files(dataset, folder, presses_as=presses_as, frames_as=frames_as)


def write_dataset_files(
    dataset: Dataset, folder: Path, *, presses_as: Format = "csv", frames_as: Format = "parquet"
) -> None:
    """Write the files of a dataset into an existing folder."""
    write_meta(dataset.meta, folder / FILE)
    taxels = dataset.meta.sensor.taxel_columns()
    write_table(folder / f"presses.{presses_as}", dataset.presses.to_columns(taxels))
    if dataset.frames is not None:
        write_table(folder / f"frames.{frames_as}", dataset.frames.to_columns(taxels))
    if dataset.positions is not None:
        columns = position_columns(dataset.meta.sensor, dataset.positions)
        write_table(folder / str(dataset.meta.sensor.positions), columns)
    for name, content in dataset.meshes.items():
        (folder / name).write_bytes(content)
