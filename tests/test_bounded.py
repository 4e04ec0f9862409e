"""Every malformed input ends in an error that names its file, with bounded time and memory."""

from __future__ import annotations

import io
import json
import random
import time
import tracemalloc
import zipfile
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
import tomli_w
from hypothesis import HealthCheck, example, given, settings
from hypothesis import strategies as st

pytest.importorskip("stable_baselines3", reason="needs skincal[train]")

from benchmarks import fuzz
from benchmarks.fuzz_readers import Reader, damaged, readers
from skincal import bounded
from skincal.bounded import UnreadableError, parse_json, parse_toml, parse_xml, read_arrays
from skincal.errors import InputError, Problem, SkincalError
from skincal.hand.messages import MessageError

NAMES = (
    "dataset, CSV", "dataset, Parquet", "dataset, positions", "dataset, mesh", "calibration", "plan, TOML", "plan, CSV",
    "hand", "pinch", "message, state", "message, refused", "keys, hand", "keys, client", "mapping, CSV", "mapping, bag",
    "import, presses", "import, series", "import, NumPy, npz", "import, NumPy, npy", "import, MATLAB", "import, HDF5",
    "import, Parquet", "bag, ROS 1", "bag, ROS 2", "bag, MCAP", "ranges, toml", "ranges, json", "ranges, yaml",
    "policy", "estimator", "deployed", "run", "checkpoint", "journal", "skin memory", "curve", "trajectory",
)  # fmt: skip


@pytest.fixture(scope="module")
def known() -> dict[str, Reader]:
    found = readers()
    assert tuple(found) == NAMES
    return found


@pytest.fixture
def refusal(known: dict[str, Reader], tmp_path: Path):
    """Reads valid samples with one text replaced in one of them; returns what is said of it."""

    def read(name: str, file: str, old: str | bytes, new: str | bytes) -> str:
        reader = known[name]
        old, new = (text.encode() if isinstance(text, str) else text for text in (old, new))
        assert not old or old in reader.files[file]
        changed = reader.files | {file: reader.files[file].replace(old, new, 1) if old else new}
        for one, content in changed.items():
            (tmp_path / one).write_bytes(content)
        begun = time.process_time()
        try:
            found = reader.read(tmp_path)
            said = "\n".join(map(str, getattr(found, "errors", ())))
        except (SkincalError, MessageError) as error:
            assert not isinstance(error, SkincalError) or error.exit_status == 2
            said = str(error)
        assert time.process_time() - begun < 5
        return said

    return read


@pytest.mark.parametrize("name", NAMES)
def test_samples_are_valid(known, tmp_path, name):
    known[name].write(tmp_path)
    assert not getattr(known[name].read(tmp_path), "errors", ())


APART = [
    name for name in NAMES if name.startswith(("import, MATLAB", "import, HDF5", "import, Parquet", "bag"))
]
"""Read in a process of its own, as the library may crash; so here."""

COMPILED = [*APART, "dataset, Parquet", "dataset, mesh", "calibration", "policy"]
"""Read by compiled libraries: whatever they do must not end the process of all other tests."""


@pytest.mark.filterwarnings("ignore:Generating overly large repr")
@pytest.mark.parametrize("name", [name for name in NAMES if name not in COMPILED])
@settings(max_examples=60, suppress_health_check=list(HealthCheck))
@given(seed=st.integers(0, 2**32))
@example(seed=0)
@example(seed=499174429)
def test_damaged_samples_end_in_an_error_that_is_meant(known, tmp_path, name, seed):
    known[name].attack(tmp_path, *damaged(random.Random(seed), known[name]))


@pytest.mark.parametrize("name", COMPILED)
def test_damaged_samples_of_compiled_libraries(known, tmp_path, monkeypatch, name):
    assert known[name].apart == (name in APART)
    monkeypatch.setattr(fuzz, "BATCH", 30)
    assert fuzz.run_batch(tmp_path, known[name], 3, 0) == 0


HUGE = "9" * 400
TOML = [
    ("dataset, CSV", "dataset.toml", "pitch_m = 0.004"),
    ("calibration", "calibration.toml", "y_m = 0.0235"),
    ("plan, TOML", "plan.toml", "force_n = 3.0"),
    ("hand", "hand.toml", "torque_nm = 1.5"),
    ("mapping, CSV", "m.toml", "pitch_m = 0.004"),
    ("ranges, toml", "ranges.toml", "low = "),
]


@pytest.mark.parametrize(("name", "file", "old"), TOML)
@pytest.mark.parametrize("number", [HUGE, "9" * 5000, "0x" + "f" * 2000])
def test_endless_numbers(refusal, name, file, old, number):
    key = old.partition(" ")[0]
    assert file in refusal(name, file, old, f"{key} = {number} # ")


@pytest.mark.parametrize(("name", "file", "old"), TOML)
@pytest.mark.parametrize(
    "line", ["x = " + "[" * 20_000, "x" + ".a" * 20_000 + " = 1", "x = " + "[" * 50 + "]" * 50]
)
def test_endless_nesting(refusal, name, file, old, line):
    assert file in refusal(name, file, "", f"{line}\n{old}")


@pytest.mark.parametrize(
    ("name", "file", "within"),
    [
        ("mapping, CSV", "m.toml", "files."),
        ("mapping, bag", "m.toml", "columns."),
        ("mapping, bag", "m.toml", "topics."),
        ("hand", "hand.toml", ""),
        ("ranges, toml", "ranges.toml", "skin.effects."),
    ],
)
def test_endless_tables(refusal, name, file, within):
    tables = "".join(f"[{within}t{i}]\n" for i in range(10_000))
    assert "at most 1000 tables" in refusal(name, file, "", tables)


@pytest.mark.parametrize(("name", "file"), [("mapping, CSV", "m.toml"), ("ranges, json", "ranges.json")])
def test_endless_keys(refusal, name, file):
    keys = {f"c{i}": "x" for i in range(30_000)}
    text = json.dumps({"columns": keys}) if file.endswith("json") else tomli_w.dumps({"columns": keys})
    assert "at most 20000 keys" in refusal(name, file, "", text)


@pytest.mark.parametrize(
    ("name", "file", "old"),
    [
        ("dataset, CSV", "dataset.toml", "rows = 2"),
        ("calibration", "calibration.toml", "rows = 4"),
        ("hand", "hand.toml", "rows = 4"),
        ("import, presses", "mapping.toml", "rows = 4"),
    ],
)
@pytest.mark.parametrize("rows", [1_000_000_000, 2**62])
def test_a_billion_taxels(refusal, name, file, old, rows):
    assert "a whole number, 1 to 16384" in refusal(name, file, old, f"rows = {rows}")


@pytest.mark.parametrize(
    "value", ["!!timestamp x", '!!int ""', "&a [*a]", "!!python/object:os.system x", "!!set {a, b}"]
)
def test_yaml_of_other_kinds(refusal, value):
    assert "ranges.yaml" in refusal(
        "ranges, yaml", "ranges.yaml", "format: skincal-ranges/1", f"format: {value}"
    )


def test_yaml_that_repeats_itself(refusal):
    text = "a0: &a0 [1]\n" + "".join(f"a{i}: &a{i} [{', '.join([f'*a{i - 1}'] * 9)}]\n" for i in range(1, 20))
    assert "at most 500000 values" in refusal("ranges, yaml", "ranges.yaml", "", text)


@pytest.mark.parametrize("value", ['"x"', HUGE, "[1]", "nan", "{}"])
def test_sites_of_a_plan(refusal, value):
    press = f"[[press]]\nbeta_deg = {value}\ny_m = 0.0235\nforce_n = 1.0\n[[press]]\nu_m = 1\n"
    assert "beta_deg" in refusal("plan, TOML", "plan.toml", "", f'format = "skincal-plan/1"\n{press}')


@pytest.mark.parametrize("column", ["force_n", "x_m", "taxel_0_0"])
def test_lists_in_a_table(known, refusal, column):
    table = pq.read_table(io.BytesIO(known["dataset, Parquet"].files["frames.parquet"]))
    lists = pa.array([[1.0, 2.0]] * table.num_rows)
    table = table.set_column(table.column_names.index(column), column, lists)
    content = io.BytesIO()
    pq.write_table(table, content)
    said = refusal("dataset, Parquet", "frames.parquet", "", content.getvalue())
    assert f"frames.parquet, column {column}: expected single numbers" in said


def test_a_table_of_too_many_rows(known, refusal):
    """The file is small: every page says that it holds one value many times."""
    table = pa.table({"press": pa.array(np.zeros(10_000_001, np.int8))})
    content = io.BytesIO()
    pq.write_table(table, content, compression="zstd", write_statistics=False)
    assert len(content.getvalue()) < 200_000
    said = refusal("dataset, Parquet", "frames.parquet", "", content.getvalue())
    assert "expected at most 10000000 rows; got 10000001" in said
    assert "expected at most 1000000 rows" in refusal(
        "dataset, Parquet", "presses.parquet", "", content.getvalue()
    )


def test_a_quote_that_swallows_a_line(refusal):
    assert "log.csv" in refusal("import, presses", "log.csv", ";200\n", ';"200\n')


@pytest.mark.parametrize("encoding", ["rot13", "zlib", "hex", "none"])
def test_encodings_of_no_text(refusal, encoding):
    assert "encoding" in refusal(
        "import, presses", "mapping.toml", "[csv]", f'[csv]\nencoding = "{encoding}"'
    )


@pytest.mark.parametrize(
    ("old", "new"),
    [
        ("steps = 8", "steps = inf #"), ("environments = 8", "environments = -8"), ("seed = 1", "seed = 1.5"),
        ("learning_rate = 0.0003", "learning_rate = nan"), ("buffer_size = 200000", f"buffer_size = {HUGE}"),
    ],
)  # fmt: skip
def test_settings_of_a_run(refusal, old, new):
    assert "run.toml" in refusal("run", "run.toml", old, new)


@pytest.mark.parametrize(
    "content", ['{"first": 0, "resu', "[]", '{"first": 0}', '{"first": 1e999, "shift_s": 0, "resumed": 0}']
)
def test_a_journal_that_was_cut(refusal, content):
    assert "connection-0000.json" in refusal("journal", "connection-0000.json", "", content)


@pytest.mark.parametrize("value", [HUGE, "true", '"x"', "[1]"])
def test_a_refusal_of_the_hand(refusal, value):
    refusal("message, refused", "message.json", '"value": 1', f'"value": {value}')


@pytest.mark.parametrize("rows", ["", "nan,0.0\n", "0.0,inf\n", "1e9,0.0\n", "0.001\n"])
def test_targets_that_no_skin_has(refusal, rows):
    assert "t.csv" in refusal("trajectory", "t.csv", "0.0,0.001\n0.001,0.002\n", rows)


def test_a_loop_of_links(refusal):
    said = refusal("hand", "hand.urdf", '<parent link="palm"/>\n    <child link="thumb_base"/>',
                   '<parent link="thumb_medial"/>\n    <child link="thumb_base"/>')  # fmt: skip
    assert "a loop: thumb_base on thumb_medial on thumb_proximal on thumb_base" in said


@pytest.mark.parametrize("value", ["nan", "1e300", "inf"])
def test_numbers_of_a_urdf(refusal, value):
    assert "hand.urdf" in refusal("hand", "hand.urdf", 'xyz="0 -0.025 -0.010"', f'xyz="0 {value} 0"')


def test_arrays_of_another_zip(tmp_path, known):
    content = bytearray(known["checkpoint"].files["turn-003.npz"])
    for place in (content.index(b"PK\x03\x04") + 8, content.index(b"PK\x01\x02") + 10):
        content[place : place + 2] = (99).to_bytes(2, "little")  # a method of packing that nobody knows
    (tmp_path / "a.npz").write_bytes(content)
    with pytest.raises(UnreadableError, match=r"whole \.npz"):
        read_arrays(tmp_path / "a.npz")


@pytest.mark.parametrize("shape", ["(1000000000000,)", "(2,)", "(-1,)", "(True,)"])
def test_arrays_of_another_size_than_they_say(tmp_path, shape):
    head = f"{{'descr': '<f8', 'fortran_order': False, 'shape': {shape}}}".ljust(117) + "\n"
    array = b"\x93NUMPY\x01\x00" + len(head).to_bytes(2, "little") + head.encode() + bytes(8)
    with zipfile.ZipFile(tmp_path / "a.npz", "w") as archive:
        archive.writestr("a.npy", array)
    with pytest.raises(UnreadableError):
        read_arrays(tmp_path / "a.npz")


def test_arrays_that_unpack_to_much(tmp_path):
    np.savez_compressed(tmp_path / "a.npz", a=np.zeros(10**6))
    with pytest.raises(UnreadableError, match="at most 1 MiB"):
        read_arrays(tmp_path / "a.npz", most=1 << 20)
    assert read_arrays(tmp_path / "a.npz")["a"].shape == (10**6,)


def test_arrays_with_code_in_them(tmp_path):
    np.savez(tmp_path / "a.npz", a=np.array([{}], dtype=object))
    with pytest.raises(UnreadableError):
        read_arrays(tmp_path / "a.npz")


PLAIN = st.none() | st.booleans() | st.integers(-(2**63), 2**63 - 1) | st.text()
VALUES = st.recursive(PLAIN, lambda x: st.lists(x, max_size=3) | st.dictionaries(st.text(), x, max_size=3))


@given(VALUES)
def test_values_within_the_bounds_come_back(value):
    assert parse_json(json.dumps(value)) == value


def test_larger_files_are_not_read(tmp_path, monkeypatch):
    monkeypatch.setattr(bounded, "MOST_TEXT_BYTES", 100)
    (tmp_path / "a").write_bytes(bytes(200))
    with pytest.raises(UnreadableError, match="a file of at most"):
        bounded.read_bytes(tmp_path / "a", 100)
    with pytest.raises(OSError, match="a device, not a file"):
        bounded.read_bytes(Path("/dev/zero"), 1000)


def test_reading_takes_no_more_memory_than_the_file(tmp_path):
    (tmp_path / "a").write_bytes(bytes(200))
    tracemalloc.start()
    try:
        assert bounded.read_bytes(tmp_path / "a", 1 << 30) == bytes(200)
        assert tracemalloc.get_traced_memory()[1] < 1 << 20
    finally:
        tracemalloc.stop()


def test_elements_within_each_other():
    with pytest.raises(UnreadableError, match="nested at most"):
        parse_xml("<a>" * 20_000 + "</a>" * 20_000)


def test_dotted_keys():
    assert parse_toml("a.b.'c d'.e = 1") == {"a": {"b": {"c d": {"e": 1}}}}
    with pytest.raises(UnreadableError, match="keys of at most"):
        parse_toml("a" + ". b" * 100 + " = 1")


def test_errors_are_short_and_steer_no_terminal():
    said = str(
        InputError([Problem("f.toml, \x1b[2Jx", "a number", "\x1b]0;title\x07" + "9" * 10_000, "Mend it.")])
    )
    assert said.isprintable() and len(said) < 600 and said.endswith("Mend it.")


def test_an_array_unpacks_to_no_more_than_its_header_says(tmp_path):
    file = tmp_path / "a.npz"
    header = io.BytesIO()
    np.lib.format.write_array_header_1_0(header, {"descr": "<f8", "fortran_order": False, "shape": (4,)})
    with zipfile.ZipFile(file, "w", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr("a.npy", header.getvalue() + bytes(30 << 20))
    tracemalloc.start()
    with pytest.raises(UnreadableError, match=r"shape \(4,\); got more"):
        read_arrays(file)
    assert tracemalloc.get_traced_memory()[1] < 10 << 20
    tracemalloc.stop()


@pytest.mark.parametrize("name", ["a.npy", "a.npz"])
def test_arrays_take_no_more_memory_than_their_size(tmp_path, name):
    (np.save if name == "a.npy" else np.savez_compressed)(tmp_path / name, np.zeros(10**6))
    read = bounded.read_array if name == "a.npy" else bounded.read_arrays
    tracemalloc.start()
    read(tmp_path / name)
    most = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert most < 11 << 20  # 8 MB, and a piece of the file
