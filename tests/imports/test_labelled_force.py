"""Forces that were noted, like known weights: the contacts are found by the taxels."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from skincal.dataset import IDLE, Dataset
from skincal.imports.cutting import cut_by_taxels
from skincal.imports.mapping_file import CutRules
from skincal.imports.recording import Series
from tests.imports.foreign import SERIES, Recorded, imported, mapping, recorded, refusals, series_table


@pytest.fixture
def recording(session: Callable[..., Dataset]) -> Recorded:
    return recorded(session(8, frames_per_press=0))


def noted(recording: Recorded) -> pd.DataFrame:
    """The weight of each trial, from the rest before its contact to its end."""
    table = series_table(recording)
    trial = np.minimum(np.arange(len(table)) // 180, 7)
    return table.assign(trial=trial, F=np.round(recording.level_n[trial], 3))


@pytest.mark.parametrize("by", ["number", "file", "taxels", "force", "constant"])
def test_rest_is_no_part_of_a_known_weight(tmp_path: Path, recording: Recorded, by: str):
    table, columns = noted(recording), {}
    parts = [part for _, part in table.groupby("trial")] if by == "file" else [table]
    files = [tmp_path / f"{i}.csv" for i in range(len(parts))]
    for part, file in zip(parts, files, strict=True):
        part.to_csv(file, index=False)
    if by in ("number", "constant"):
        columns["press"] = "trial"
    if by == "constant":
        columns["force_n"] = {"value": 2.0, "unit": "N", "column": None}
    series = {"by": "taxels"} if by == "taxels" else {}
    found, done = imported(tmp_path, mapping(SERIES, columns=columns, series=series), files)
    np.testing.assert_allclose(found.presses.counts, recording.image, atol=1)
    force = [2.0] * 8 if by == "constant" else table.groupby("trial").F.first()
    np.testing.assert_allclose(found.presses.force_n, force)
    assert found.frames is not None
    assert (found.frames.force_n[found.frames.phase == IDLE] == 0).all()
    assert not [one for one in done.warnings if one.code == "zero_of_force"]


def by_number(tmp_path: Path, recording: Recorded) -> tuple[dict, list[Path], pd.DataFrame]:
    """Weights and places in a table of their own, by the number of the trial."""
    table = noted(recording)
    files = [tmp_path / "skin.csv", tmp_path / "notes.csv"]
    table.drop(columns=["F", "X", "Y", "Z"]).to_csv(files[0], index=False)
    notes = table.groupby("trial").first()[["F", "X", "Y", "Z"]].reset_index()[::-1]
    notes.to_csv(files[1], index=False)
    content = mapping(
        SERIES, columns={"press": "trial"}, files={"notes": {"file": "notes.csv", "press": "trial"}}
    )
    for name in ("force_n", "position"):
        content["columns"][name]["file"] = "notes"
    return content, files, notes


def test_a_table_with_one_row_per_number(tmp_path: Path, recording: Recorded):
    content, files, notes = by_number(tmp_path, recording)
    found, _ = imported(tmp_path, content, files)
    np.testing.assert_allclose(found.presses.force_n, notes.sort_values("trial").F)
    np.testing.assert_allclose(found.presses.counts, recording.image, atol=1)


@pytest.mark.parametrize(
    ("rows", "said"), [([0, 0, 1, 2, 3, 4, 5, 6, 7], "each number once"), ([0, 1, 2, 3], "none for")]
)
def test_numbers_that_do_not_fit(tmp_path: Path, recording: Recorded, rows: list[int], said: str):
    content, files, notes = by_number(tmp_path, recording)
    notes.iloc[rows].to_csv(files[1], index=False)
    (problem,) = refusals(tmp_path, content, files)
    assert problem.startswith('notes.csv, column "trial"') and said in problem


def test_a_table_without_stamps_may_have_numbers(tmp_path: Path, recording: Recorded):
    content, files, _ = by_number(tmp_path, recording)
    del content["files"]["notes"]["press"]
    assert 'press = "trial"' in "".join(refusals(tmp_path, content, files))
    content["files"]["notes"]["press"] = "trial"
    del content["columns"]["press"]
    assert "also [columns.press]" in "".join(refusals(tmp_path, content, files))


def test_numbers_without_rest_are_contacts(tmp_path: Path, recording: Recorded):
    """Samples of the hold alone, with creep: the user said which press they belong to."""
    table = noted(recording)
    held = np.isin(np.arange(len(table)) % 180, range(90, 150)) & (table.index < 8 * 180)
    table = table[held]
    creep = 1 + 0.02 * np.log1p(np.arange(len(table)) % 60)
    for name in filter(lambda one: one.startswith("tax_"), map(str, table)):
        table[name] = np.minimum(np.rint(table[name].to_numpy(dtype=float) * creep), 255)
    table.to_csv(tmp_path / "a.csv", index=False)
    found, _ = imported(tmp_path, mapping(SERIES, columns={"press": "trial"}), [tmp_path / "a.csv"])
    assert len(found.presses) == 8
    assert found.frames is not None and (found.frames.phase != IDLE).all()


def test_a_known_weight_has_no_zero(tmp_path: Path, recording: Recorded):
    noted(recording).to_csv(tmp_path / "a.csv", index=False)
    content = mapping(SERIES, series={"by": "taxels", "zero_force": True})
    (problem,) = refusals(tmp_path, content, [tmp_path / "a.csv"])
    assert "constant in each contact" in problem and "Remove zero_force" in problem


@pytest.mark.parametrize("clips", [False, True])
def test_light_contacts_are_no_rest(clips: bool):
    """Most contacts are light, and last longer than the rests."""
    rng = np.random.default_rng(1)
    level = np.where(np.arange(24) % 4, 0.18, 1.0)
    share = np.concatenate([np.interp(np.arange(120), [20, 22, 110, 112], [0, s, s, 0]) for s in level])
    images = np.rint(20 + share[:, None] * [5, 30, 60, 80] + rng.standard_normal((len(share), 4)))
    images = np.maximum(images - 21, 0) if clips else images
    series = Series(
        np.arange(0, 0.05 * len(share) - 0.01, 0.05),
        np.ones(len(share)),
        np.zeros(len(share), dtype=np.int64),
    )
    assert len(cut_by_taxels(series, images, CutRules()).spans) == 24


def test_weaker_contacts_are_counted():
    share = np.concatenate(
        [np.interp(np.arange(60), [20, 22, 50, 52], [0, s, s, 0]) for s in [1, 0.05, 1, 1, 0.05]]
    )
    images = share[:, None] * [500, 3000] + np.random.default_rng(1).normal(0, 2, (len(share), 2))
    series = Series(
        np.arange(0, 0.05 * len(share) - 0.01, 0.05),
        np.ones(len(share)),
        np.zeros(len(share), dtype=np.int64),
    )
    found = cut_by_taxels(series, images, CutRules())
    assert len(found.spans) == 3
    assert [one.why for one in found.rejected] == ["its image is weaker than 10 % of the strongest ones"] * 2
