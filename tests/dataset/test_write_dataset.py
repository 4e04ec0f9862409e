"""A written dataset reads back exactly; it appears whole or not at all."""

from __future__ import annotations

import pickle
import subprocess
import sys
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd
import pyarrow as pa
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from skincal.dataset import Dataset, Frames, Presses, dataset_hash, read_dataset, write_dataset
from skincal.dataset.columns import repeated
from skincal.dataset.findings import Findings
from skincal.dataset.table_file import _plain, _words, read_table, write_table
from skincal.errors import InputError
from tests.dataset.changes import with_sensor

Session = Callable[..., Dataset]


def assert_same(one: Presses | Frames | None, other: Presses | Frames | None) -> None:
    assert type(one) is type(other)
    if one is None or other is None:
        return
    for name in vars(one):
        a, b = getattr(one, name), getattr(other, name)
        if name == "columns":
            assert list(a) == list(b)
            for column in a:
                np.testing.assert_array_equal(a[column], b[column])
        else:
            np.testing.assert_array_equal(a, b)


@pytest.mark.parametrize("presses_as", ["csv", "parquet"])
@pytest.mark.parametrize("frames_as", ["csv", "parquet"])
@pytest.mark.parametrize("frames_per_press", [0, 8])
def test_a_session_comes_back(
    session: Session, tmp_path: Path, presses_as: str, frames_as: str, frames_per_press: int
) -> None:
    dataset = session(frames_per_press=frames_per_press)
    write_dataset(dataset, tmp_path / "d", presses_as=presses_as, frames_as=frames_as)  # type: ignore[arg-type]
    back = read_dataset(tmp_path / "d")
    assert back.meta == dataset.meta
    assert_same(dataset.presses, back.presses)
    assert_same(dataset.frames, back.frames)
    assert back.folder == tmp_path / "d"
    assert back.sha256 == dataset_hash(tmp_path / "d")


def test_a_session_can_be_sent_to_another_process(session: Session) -> None:
    dataset = session(frames_per_press=4)
    back = pickle.loads(pickle.dumps(dataset))
    assert back.meta == dataset.meta
    assert_same(dataset.presses, back.presses)
    assert_same(dataset.frames, back.frames)
    with pytest.raises(TypeError):
        back.presses.columns["new"] = back.presses.force_n


floats = hnp.arrays(np.float64, 5, elements=st.floats(allow_nan=True, allow_infinity=True, width=64))
texts = st.lists(st.text(st.characters(exclude_categories=["Cs", "Cc"])), min_size=5, max_size=5)


@pytest.mark.parametrize("suffix", ["csv", "parquet"])
@settings(max_examples=60, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(numbers=floats, words=texts, wholes=hnp.arrays(np.int64, 5))
def test_columns_come_back_to_the_last_bit(
    tmp_path: Path, suffix: str, numbers: np.ndarray, words: list[str], wholes: np.ndarray
) -> None:
    # Unknown text that looks like a number is read as one from a CSV; columns known to hold text are not.
    columns = {"number": numbers, "pose": np.array(words, dtype=object), "whole": wholes}
    write_table(tmp_path / f"t.{suffix}", columns)
    findings = Findings()
    table = read_table(tmp_path / f"t.{suffix}", findings)
    assert table is not None
    assert not findings.errors
    np.testing.assert_array_equal(table.columns["number"], numbers)
    assert table.columns["pose"].tolist() == words
    np.testing.assert_array_equal(table.columns["whole"], wholes)


def test_missing_values_of_slices_are_read() -> None:
    words = pa.chunked_array(
        [pa.array(["a", None, "b"]).dictionary_encode()[1:], pa.array(["c"]).dictionary_encode()]
    )
    assert _words(words).tolist() == ["", "b", "c"]
    numbers = pa.chunked_array([pa.array([1.0, None, 3.0, None])[1:], pa.array([4.0])])
    np.testing.assert_array_equal(_plain(numbers), [np.nan, 3.0, np.nan, 4.0])
    whole = pa.chunked_array([pa.array([1, None, 3])[1:]])
    np.testing.assert_array_equal(_plain(whole), [np.nan, 3.0])


def test_an_existing_folder_is_refused(session: Session, tmp_path: Path) -> None:
    write_dataset(session(), tmp_path / "d")
    before = dataset_hash(tmp_path / "d")
    with pytest.raises(InputError, match="Add --force"):
        write_dataset(session(seed=2), tmp_path / "d")
    assert dataset_hash(tmp_path / "d") == before
    write_dataset(session(seed=2), tmp_path / "d", force=True)
    assert dataset_hash(tmp_path / "d") != before
    assert [path.name for path in tmp_path.iterdir()] == ["d"]


LIMITED = """
import resource, sys
from skincal.dataset import read_dataset, write_dataset
dataset = read_dataset(sys.argv[1])
resource.setrlimit(resource.RLIMIT_FSIZE, (2000, 2000))
try:
    write_dataset(dataset, sys.argv[2], presses_as=sys.argv[3], frames_as=sys.argv[3])
except OSError as error:
    print("OSError", error.errno)
"""


@pytest.mark.parametrize("form", ["csv", "parquet"])
def test_a_real_limit_of_the_file_size(folder: Path, tmp_path: Path, form: str) -> None:
    """The system itself refuses to write on, as on a full disk, in the midst of a file."""
    command = [sys.executable, "-c", LIMITED, str(folder), str(tmp_path / "copy"), form]
    done = subprocess.run(command, capture_output=True, text=True, check=True)
    assert done.stdout.startswith("OSError"), done.stdout + done.stderr
    assert [path.name for path in tmp_path.iterdir()] == ["session"]


def test_the_hash_covers_what_belongs_to_the_dataset(folder: Path) -> None:
    first = dataset_hash(folder)
    (folder / "README.md").write_text("a note")
    assert dataset_hash(folder) == first
    path = folder / "frames.csv"
    content = path.read_bytes()
    path.write_bytes(content + b"\n")
    assert dataset_hash(folder) != first
    path.write_bytes(content)
    assert dataset_hash(folder) == first
    path.rename(folder / "elsewhere.csv")
    assert dataset_hash(folder) != first


def test_predicted_counts_are_no_whole_numbers(session: Session, tmp_path: Path) -> None:
    """Frames that were computed, not measured, can be written: then ``integer`` is false."""
    dataset = session()
    assert dataset.frames is not None
    frames = replace(dataset.frames, counts=dataset.frames.counts * 0.37)
    write_dataset(replace(with_sensor(dataset, integer=False), frames=frames), tmp_path / "d")
    assert_same(read_dataset(tmp_path / "d").frames, frames)


WITHOUT_PANDAS = """
import sys
from pathlib import Path
import numpy as np
from skincal.dataset import read_dataset, write_dataset
from skincal.dataset.table_file import write_table
given, out = map(Path, sys.argv[1:])
read_dataset("data/paper-like")
data = read_dataset(given)
data.frames.force_n, data.frames.phase
write_dataset(data, out / "e")
columns = {"x": np.array([1.0, np.nan]), "used": np.array([True, False]),
           "reason": np.array(["", "dark"], dtype=object), "press": np.arange(2)}
for kind in ("csv", "parquet"):
    write_table(out / f"t.{kind}", columns)
print({"pandas", "scipy.stats"} & {*sys.modules})
"""


def test_tables_are_read_and_written_without_pandas(session: Session, tmp_path: Path) -> None:
    """It takes as long to import as all the rest."""
    write_dataset(session(), tmp_path / "d")
    command = [sys.executable, "-c", WITHOUT_PANDAS, str(tmp_path / "d"), str(tmp_path)]
    done = subprocess.run(command, capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "set()"
    assert (tmp_path / "t.csv").read_text() == 'x,used,reason,press\n1,true,"",0\n,false,"dark",1\n'


def test_rows_that_have_come_before() -> None:
    rng = np.random.default_rng(0)
    for rows in (
        rng.integers(0, 9, 40),
        rng.integers(0, 4, (60, 2)),
        np.where(rng.random((60, 2)) < 0.3, np.nan, 1.0 * rng.integers(0, 3, (60, 2))),
        np.array([0.0, -0.0, 1.0]),
        np.zeros((0, 3)),
    ):
        assert (repeated(rows) == pd.DataFrame(rows).duplicated().to_numpy()).all()
