"""The zero of a measured force, which the samples between contacts show."""

from __future__ import annotations

import re
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest

from skincal.dataset import Dataset
from skincal.errors import Problem
from skincal.imports import Imported
from tests.imports.devices import ONE_FILE, PLANE, contacts, whole_table
from tests.imports.foreign import SERIES, Recorded, imported, mapping, recorded, refusals, series_table


@pytest.fixture
def recording(session: Callable[..., Dataset]) -> Recorded:
    return recorded(session(8, frames_per_press=0))


def bring(folder: Path, table: pd.DataFrame, **changes: Any) -> tuple[Dataset, Imported]:
    folder.mkdir(exist_ok=True)
    table.to_csv(folder / "a.csv", index=False)
    return imported(folder, mapping(SERIES, **changes), [folder / "a.csv"])


def zeros(done: Imported) -> list[Problem]:
    return [warning for warning in done.warnings if warning.code == "zero_of_force"]


@pytest.mark.parametrize("bias_n", [0.07, -0.07, -0.35])
@pytest.mark.parametrize("sign", [1, -1])
def test_a_bias_gives_the_offset_that_corrects_it(
    tmp_path: Path, recording: Recorded, bias_n: float, sign: int
):
    table = series_table(recording)
    table["F"] = sign * (table["F"] + bias_n) * 1e3
    column = {"column": "F", "unit": "mN", "sign": sign}
    (found,) = zeros(bring(tmp_path, table, columns={"force_n": column})[1])
    assert found.details["level_n"] == pytest.approx(bias_n, abs=0.005)
    offset = re.search(r"offset = (\S+) in", str(found))
    assert offset is not None
    column |= {"offset": float(offset[1])}
    back, done = bring(tmp_path / "b", table, columns={"force_n": column})
    assert not zeros(done)
    np.testing.assert_allclose(back.presses.force_n, recording.level_n, atol=0.005)


def test_a_drift_is_taken_off_where_asked(tmp_path: Path, recording: Recorded):
    table = series_table(recording)
    table["F"] -= np.linspace(0, 0.4, len(table))
    (found,) = zeros(bring(tmp_path, table)[1])
    assert "it drifts from" in str(found) and "zero_force = true in [series]" in str(found)
    back, done = bring(tmp_path / "b", table, series={"zero_force": True})
    assert not zeros(done)
    np.testing.assert_allclose(back.presses.force_n, recording.level_n, atol=0.02)


@pytest.mark.parametrize("noise_n", [0.0, 0.03])
def test_noise_is_no_bias(tmp_path: Path, session: Callable[..., Dataset], noise_n: float):
    recording = recorded(session(8, frames_per_press=0), noise_n=noise_n)
    table = series_table(recording)
    assert not zeros(bring(tmp_path, table)[1])
    # The length of a vector is never negative, so that noise alone has a level.
    side = np.random.default_rng(5).normal(0, noise_n, (2, len(table)))
    table["Fx"], table["Fy"] = side
    vector = {"column": None, "columns": ["Fx", "Fy", "F"]}
    assert not zeros(bring(tmp_path / "b", table, columns={"force_n": vector}, series={"off_n": 0.15})[1])


def test_the_length_of_a_vector_has_no_zero(tmp_path: Path, recording: Recorded):
    table = series_table(recording)
    table["Fx"], table["F"] = 0.06, table["F"] + 0.05
    columns = {"force_n": {"column": None, "columns": ["Fx", "F"]}}
    (found,) = zeros(bring(tmp_path, table, columns=columns)[1])
    assert "map the axis along the normal alone" in str(found)
    (tmp_path / "b").mkdir()
    table.to_csv(tmp_path / "b" / "a.csv", index=False)
    content = mapping(SERIES, columns=columns, series={"zero_force": True})
    (problem,) = refusals(tmp_path / "b", content, [tmp_path / "b" / "a.csv"])
    assert (
        "map.toml, [series], zero_force: expected a measured force with a sign; got the length of a vector"
        in problem
    )


def test_rest_that_counts_as_contact_is_seen_by_the_taxels(tmp_path: Path):
    """The length of a force that crosses 0 on the way to a press is small for moments only."""
    found = contacts()
    time = np.arange(0, found.end_s, 0.02)
    table = whole_table(found, time)
    table["Fx"], table["F"] = 0.1, table["F"] - 0.35
    table.to_csv(tmp_path / "a.csv", index=False)
    columns = {"force_n": {"column": None, "columns": ["Fx", "F"]}}
    _, done = imported(tmp_path, mapping(PLANE, ONE_FILE, columns=columns), [tmp_path / "a.csv"])
    (problem,) = zeros(done)
    assert "rest counts as contact" in str(problem) and "map the axis along the normal alone" in str(problem)


def test_presses_off_the_patch_are_no_bias(tmp_path: Path, recording: Recorded):
    table = series_table(recording)
    taxels = [name for name in table if str(name).startswith("tax_")]
    table.loc[np.isin(recording.press, [0, 1, 2, 4, 5]), taxels] = 0
    assert not zeros(bring(tmp_path, table)[1])
