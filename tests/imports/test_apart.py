"""Files of foreign formats that crash the library that reads them, or take all memory or time."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest
import scipy.io
import tomli_w

from skincal.bounded import UnreadableError
from skincal.dataset.findings import Findings
from skincal.errors import InputError, Problem
from skincal.imports import apart as module
from skincal.imports import source_table
from skincal.imports.apart import apart
from skincal.imports.csv_source import read_csv_files
from skincal.imports.mapping_file import CsvFormat
from skincal.imports.read_mapping import read_mapping
from tests.imports.foreign import RIG, SERIES


def double(path: Path, factor: int) -> str:
    print("a library says something")
    return str(path) * factor


def refuse(path: Path) -> None:
    raise InputError([Problem(str(path), "a bag", "none")])


def find_no_array(_: Path) -> None:
    raise UnreadableError("an array", "none")


def crash(_: Path) -> None:
    os.kill(os.getpid(), signal.SIGSEGV)


def hoard(_: Path) -> int:
    return len(bytearray(1 << 40))


def wait(_: Path) -> None:
    time.sleep(600)


def work(_: Path) -> None:
    while True:
        pass


def test_results_and_errors_come_back(tmp_path: Path):
    assert apart(double, tmp_path / "x", 2) == f"{tmp_path / 'x'}" * 2
    with pytest.raises(InputError) as caught:
        apart(refuse, tmp_path)
    assert caught.value.problems[0].got == "none"
    with pytest.raises(UnreadableError, match="expected an array; got none"):
        apart(find_no_array, tmp_path)


def test_a_reading_process_loads_little():
    heavy = {"skincal.imports.apart": {"pandas", "scipy"}, "skincal.imports.bag_source": {"scipy.signal"}}
    for name, unneeded in heavy.items():
        loaded = f"import sys, {name}; print(*sys.modules)"
        done = subprocess.run([sys.executable, "-c", loaded], capture_output=True, text=True, check=True)
        assert not unneeded & set(done.stdout.split())


@pytest.mark.parametrize(
    ("read", "said"),
    [(crash, "signal 11"), (hoard, "MiB of memory"), (wait, "within 1 s"), (work, "within 1 s")],
)
def test_the_process_ends_instead_of_ours(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, read, said):
    monkeypatch.setattr(module, "LONGEST_S", 1.0 if read in (wait, work) else 60.0)
    monkeypatch.setattr(module, "WAIT", 3.0 if read is wait else 100.0)
    with pytest.raises(UnreadableError, match=said):
        apart(read, tmp_path / "x")


def test_a_matlab_file_that_crashes_its_reader(tmp_path: Path):
    scipy.io.savemat(tmp_path / "a.mat", {"t": np.arange(5.0)})
    content = bytearray((tmp_path / "a.mat").read_bytes())
    content[176] ^= 1  # the type of the numbers
    (tmp_path / "a.mat").write_bytes(content)
    (tmp_path / "map.toml").write_text(tomli_w.dumps(RIG | SERIES))
    findings = Findings()
    assert read_csv_files(read_mapping(tmp_path / "map.toml", "csv"), [tmp_path / "a.mat"], findings) is None
    assert "a.mat: expected a whole file of arrays" in str(findings.errors[0])


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
