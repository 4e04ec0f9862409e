"""Recordings as others write them: text tables and time series with known presses in them."""

from __future__ import annotations

import copy
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest
import tomli_w

from skincal.dataset import Dataset, read_dataset
from skincal.errors import InputError
from skincal.imports import Imported, import_csv

RIG: dict[str, Any] = {
    "format": "skincal-import/1",
    "created": "2026-11-20T12:00:00+00:00",
    "source": "made for a test",
    "sensor": {
        "rows": 4,
        "cols": 4,
        "taxel_size_m": 0.0025,
        "pitch_m": 0.004,
        "value_min": 0,
        "value_max": 255,
        "integer": True,
    },
    "surface": {"kind": "cylinder", "radius_m": 0.0115},
    "indenter": {"kind": "sphere", "radius_m": 0.006},
    "mount": {
        "y_m": 0.0235,
        "beta_deg": 0.0,
        "alpha_deg": 0.0,
        "y_range_m": [0.0195, 0.0275],
        "beta_range_deg": [-12.0, 12.0],
        "alpha_range_deg": [-20.0, 20.0],
    },
    "position": {"sigma_m": 0.001, "slack_m": 0.002},
}
"""What skincal has to know of the rig in every mapping here."""

PRESS_ROWS: dict[str, Any] = {
    "csv": {"rows": "presses", "delimiter": ";", "decimal": ","},
    "columns": {
        "press": "no",
        "position": {"columns": ["X", "Y", "Z"], "unit": "mm"},
        "force_n": {"column": "Fz", "unit": "mN", "sign": -1},
    },
    "taxels": {"columns": "s{j}", "first": 1, "falling_from": 255},
}

SERIES: dict[str, Any] = {
    "csv": {"rows": "series"},
    "columns": {
        "time_s": {"column": "t", "unit": "ms"},
        "position": {"columns": ["X", "Y", "Z"], "unit": "mm"},
        "force_n": {"column": "F", "unit": "N"},
    },
    "taxels": {"columns": "tax_{r}_{c}"},
}


def mapping(*parts: dict[str, Any], **changes: Any) -> dict[str, Any]:
    """A mapping with the rig's tables; ``changes`` are merged into its tables, None removes a key."""
    result = copy.deepcopy(RIG)
    for part in (*parts, changes):
        _merge(result, copy.deepcopy(part))
    return result


def _merge(into: dict[str, Any], part: dict[str, Any]) -> None:
    for key, value in part.items():
        if value is None:
            into.pop(key, None)
        elif isinstance(value, dict) and isinstance(into.get(key), dict):
            _merge(into[key], value)
        else:
            into[key] = value


def write_mapping(folder: Path, content: dict[str, Any]) -> Path:
    """Writes a mapping file."""
    path = folder / "map.toml"
    path.write_text(tomli_w.dumps(content), encoding="utf-8")
    return path


def imported(
    folder: Path, content: dict[str, Any], files: Sequence[Path], read: Callable[..., Imported] = import_csv
) -> tuple[Dataset, Imported]:
    """Import files by a mapping into the folder ``out``, and read that."""
    done = read(write_mapping(folder, content), folder / "out", files)
    return read_dataset(folder / "out"), done


def refusals(
    folder: Path, content: dict[str, Any], files: Sequence[Path], read: Callable[..., Imported] = import_csv
) -> list[str]:
    """The problems of an import, which leaves nothing behind."""
    before = {*folder.iterdir(), folder / "map.toml"}
    with pytest.raises(InputError) as caught:
        imported(folder, content, files, read)
    assert {*folder.iterdir()} == before
    assert not (folder / "out").exists()
    return [str(problem) for problem in caught.value.problems]


def press_table(dataset: Dataset) -> pd.DataFrame:
    """Presses as ``PRESS_ROWS`` understands them: millimetres, falling millinewtons, falling taxels."""
    presses = dataset.presses
    table = pd.DataFrame({"no": presses.press})
    for i, name in enumerate("XYZ"):
        table[name] = presses.position_m[:, i] * 1e3
    table["Fz"] = presses.force_n * -1e3
    for j in range(presses.counts.shape[1]):
        table[f"s{j + 1}"] = 255 - presses.counts[:, j]
    return table


def write_press_table(path: Path, table: pd.DataFrame) -> Path:
    """Writes it as a European spreadsheet does."""
    table.to_csv(path, sep=";", decimal=",", index=False)
    return path


@dataclass(frozen=True)
class Recorded:
    """A time series, and what is in it.

    Attributes:
        time_s: sample times.
        force_n: force with noise.
        position_m: contact points; where the finger moves between presses, they move too.
        counts: whole numbers, (M, 16).
        press: number of the press, -1 between.
        level_n: true force of each press.
        image: true image of each press.
        hold_s: true start and end of each hold.
    """

    time_s: np.ndarray
    force_n: np.ndarray
    position_m: np.ndarray
    counts: np.ndarray
    press: np.ndarray
    level_n: np.ndarray
    image: np.ndarray
    hold_s: np.ndarray


def recorded(dataset: Dataset, *, rate_hz: float = 100.0, noise_n: float = 0.004, seed: int = 3) -> Recorded:
    """Trapezes of force: 0.5 s of rest, 0.4 s of loading, 0.6 s of hold, 0.3 s of unloading; rest at the end."""
    generator = np.random.default_rng(seed)
    presses = dataset.presses
    one, count = np.arange(0, 1.8, 1 / rate_hz), len(presses)
    share = np.interp(one, [0.5, 0.9, 1.5, 1.8], [0.0, 1.0, 1.0, 0.0])
    share = np.append(np.tile(share, count), np.zeros(20))
    time = 100.0 + np.arange(len(share)) / rate_hz
    index = np.minimum(np.arange(len(share)) // len(one), count - 1)
    starts = 100.0 + np.arange(count) * len(one) / rate_hz
    return Recorded(
        time_s=time,
        force_n=share * presses.force_n[index] + generator.normal(0, noise_n, len(share)),
        position_m=presses.position_m[index],
        counts=np.rint(share[:, None] * presses.counts[index]),
        press=np.where(share > 0, index, -1),
        level_n=np.array(presses.force_n),
        image=np.rint(presses.counts),
        hold_s=np.column_stack([starts + 0.9, starts + 1.5]) - 100.0,
    )


def series_table(recording: Recorded) -> pd.DataFrame:
    """A series as ``SERIES`` understands it."""
    table = pd.DataFrame({"t": recording.time_s * 1e3, "F": recording.force_n})
    for i, name in enumerate("XYZ"):
        table[name] = recording.position_m[:, i] * 1e3
    for j in range(recording.counts.shape[1]):
        table[f"tax_{j // 4}_{j % 4}"] = recording.counts[:, j].astype(int)
    return table
