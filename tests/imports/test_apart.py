"""Files of foreign formats that crash the library that reads them, or take all memory or time."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
import scipy.io
import tomli_w

from skincal.bounded import UnreadableError
from skincal.dataset.findings import Findings
from skincal.errors import InputError
from skincal.imports import apart as module
from skincal.imports import source_table
from skincal.imports.apart import apart
from skincal.imports.csv_source import read_csv_files
from skincal.imports.mapping_file import CsvFormat
from skincal.imports.read_mapping import read_mapping
from tests.imports.foreign import RIG, SERIES
from tests.imports.odd_readers import crash, double, find_no_array, hoard, refuse, wait, work


def test_results_and_errors_come_back(tmp_path: Path):
    assert apart(double, tmp_path / "x", 2) == f"{tmp_path / 'x'}" * 2
    with pytest.raises(InputError) as caught:
        apart(refuse, tmp_path)
    assert caught.value.problems[0].got == "none"
    with pytest.raises(UnreadableError, match="expected an array; got none"):
        apart(find_no_array, tmp_path)


def test_a_reading_process_loads_little():
    names = "skincal.imports.apart", "skincal.imports.bag_source"
    loaded = "; ".join(f"import sys, {name}; print(*sys.modules)" for name in names)
    done = subprocess.run([sys.executable, "-c", loaded], capture_output=True, text=True, check=True)
    first, all_of_them = (set(line.split()) for line in done.stdout.splitlines())
    assert not first & {"pandas", "scipy"} and "scipy.signal" not in all_of_them


@pytest.mark.parametrize(
    ("read", "said"),
    [(crash, "signal 11"), (hoard, "MiB of memory"), (wait, "within 1 s"), (work, "within 1 s")],
)
def test_the_process_ends_instead_of_ours(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, read, said):
    monkeypatch.setattr(module, "LONGEST_S", 0.6 if read in (wait, work) else 60.0)
    monkeypatch.setattr(module, "WAIT", 3.0 if read is wait else 100.0)
    with pytest.raises(UnreadableError, match=said):
        apart(read, tmp_path / "x")


def test_a_matlab_file_that_crashes_its_reader(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    # The samples of benchmarks/fuzz_readers.py have it read in the process that they run in, and leave that so.
    monkeypatch.setattr(source_table, "apart", apart)
    scipy.io.savemat(tmp_path / "a.mat", {"t": np.arange(5.0)})
    content = bytearray((tmp_path / "a.mat").read_bytes())
    content[176] ^= 1  # the type of the numbers
    (tmp_path / "a.mat").write_bytes(content)
    (tmp_path / "map.toml").write_text(tomli_w.dumps(RIG | SERIES))
    with pytest.raises(InputError, match=r"^a\.mat: expected a whole file of arrays"):
        read_csv_files(read_mapping(tmp_path / "map.toml", "csv"), [tmp_path / "a.mat"], Findings())


@pytest.mark.parametrize("reader", list(dict.fromkeys(source_table.ARRAYS.values())))
def test_arrays_of_every_format_are_read_apart(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, reader):
    def too_large(read: object, path: Path) -> None:
        raise UnreadableError("a file that is read in 1 MiB of memory", f"{read is reader}")

    monkeypatch.setattr(source_table, "apart", too_large)
    magic = next(magic for magic, one in source_table.ARRAYS.items() if one is reader)
    (tmp_path / "a").write_bytes(magic + b"\0")
    findings = Findings()
    assert source_table.read_source_table(tmp_path / "a", CsvFormat(), ["t"], [], findings) is None
    assert "got True" in str(findings.errors[0])
