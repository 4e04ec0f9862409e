"""Every reader of files and messages, with valid samples of what it reads, and ways to damage them."""

from __future__ import annotations

import io
import json
import math
import random
import tomllib
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass, replace
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any
from unittest.mock import patch

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import tomli_w

from skincal.dataset import Dataset
from skincal.errors import SkincalError
from skincal.hand.messages import MessageError

ROOT = Path(__file__).parents[1]
Files = dict[str, bytes]


@dataclass(frozen=True)
class Reader:
    """A reader under attack.

    Attributes:
        name: its name.
        files: valid samples of the files that it reads, by name; one of them is damaged at a time.
        read: reads them in a folder.
        fixed: files that are never damaged.
        apart: whether skincal reads them in a process of its own, which may crash or run out of memory; here it is
            this one.
    """

    name: str
    files: Files
    read: Callable[[Path], object]
    fixed: tuple[str, ...] = ()
    apart: bool = False

    def write(self, folder: Path, damaged: str = "", content: bytes = b"") -> None:
        """Writes the samples, one of them damaged."""
        for name, valid in self.files.items():
            (folder / name).parent.mkdir(exist_ok=True)
            (folder / name).write_bytes(content if name == damaged else valid)

    def attack(self, folder: Path, damaged: str, content: bytes) -> None:
        """Reads the samples with one of them damaged.

        Raises:
            Exception: other than the errors that a reader may raise.
        """
        self.write(folder, damaged, content)
        with suppress(SkincalError, MessageError, *([MemoryError] if self.apart else [])):
            self.read(folder)


def readers() -> dict[str, Reader]:
    """All readers by name; making the samples takes some seconds."""
    with TemporaryDirectory() as scratch:
        found = [
            *_of_datasets(Path(scratch)),
            *_of_hands(),
            *_of_keys(Path(scratch)),
            *_of_imports(),
            *_of_arrays(Path(scratch)),
            *_of_bags(Path(scratch)),
            *_of_ranges(),
            *_of_runs(Path(scratch)),
        ]
    return {reader.name: reader for reader in found}


def _contents(folder: Path) -> Files:
    return {path.name: path.read_bytes() for path in sorted(folder.iterdir()) if path.is_file()}


def _small(session: Dataset) -> Dataset:
    """A session with the four taxels in the middle alone: as many kinds of columns, in a third of the time."""
    middle, frames = [5, 6, 9, 10], session.frames
    assert frames is not None
    return replace(
        session,
        meta=replace(session.meta, sensor=replace(session.meta.sensor, rows=2, cols=2)),
        presses=replace(session.presses, counts=session.presses.counts[:, middle]),
        frames=replace(frames, counts=frames.counts[:, middle]),
    )


def _of_datasets(scratch: Path) -> list[Reader]:
    import trimesh

    from skincal.calibration import read_calibration, write_calibration
    from skincal.dataset import check_dataset, read_dataset, write_dataset
    from tests.calibrations import make_calibration
    from tests.conftest import make_session

    session = _small(make_session(6, frames_per_press=3))
    write_dataset(session, scratch / "csv", frames_as="csv")
    write_dataset(session, scratch / "parquet", presses_as="parquet")
    csv, parquet = _contents(scratch / "csv"), _contents(scratch / "parquet")
    listed = csv["dataset.toml"].replace(b"[sensor]\n", b'[sensor]\npositions = "taxels.csv"\n')
    rows = "".join(f"{r},{c},{0.004 * c},{0.004 * r},0.0025,0.0025\n" for r in range(2) for c in range(2))
    taxels = csv | {"dataset.toml": listed, "taxels.csv": f"r,c,u_m,v_m,du_m,dv_m\n{rows}".encode()}
    stl = trimesh.creation.icosphere(1, 0.03).export(file_type="stl")
    assert isinstance(stl, bytes)
    surface = csv["dataset.toml"].replace(
        b'kind = "cylinder"\nradius_m = 0.0115', b'kind = "mesh"\nfile = "tip.stl"'
    )
    write_calibration(make_calibration(20), scratch / "calibration")
    presses = {name: csv[name] for name in ("dataset.toml", "presses.csv")}
    return [
        Reader("dataset, CSV", csv, check_dataset),
        Reader("dataset, Parquet", parquet, read_dataset),
        Reader(
            "dataset, positions",
            {n: taxels[n] for n in (*presses, "taxels.csv")},
            check_dataset,
            tuple(presses),
        ),
        Reader(
            "dataset, mesh",
            presses | {"dataset.toml": surface, "tip.stl": stl},
            check_dataset,
            tuple(presses),
        ),
        Reader("calibration", _contents(scratch / "calibration"), read_calibration),
    ]


def _of_hands() -> list[Reader]:
    from skincal.collect.plan_file import read_plan
    from skincal.collect.posture import Mount
    from skincal.envs.pinch import read_pinch
    from skincal.hand.messages import REPLIES, REQUESTS, decode, refusal_of, state_of
    from skincal.robot import read_hand
    from skincal.robot.description import ARRAYS, NUMBERS
    from tests.conftest import make_session

    mount = Mount.of(make_session(2).meta)
    plan = (ROOT / "data" / "short-plan.toml").read_bytes()
    table = b"beta_deg,y_m,force_n,pose,kind\n0.0,0.0235,1.0,a,regular\n2.0,0.024,2.5,b,anchor\n"
    hand = _contents(ROOT / "skincal" / "robot" / "hands" / "dlr_hand_2")

    def message(folder: Path) -> None:
        found = decode((folder / "message.json").read_bytes(), (*REQUESTS, *REPLIES))
        (refusal_of if found.kind == "refused" else state_of)(found)

    head = {"v": "skincal-hand/1", "id": 3, "session": "s"}
    state = head | {"kind": "state"} | dict.fromkeys(NUMBERS, 1.5) | {n: [0.0, None, 2] for n in ARRAYS}
    refused = head | {
        "kind": "refused",
        "error": "limit",
        "text": "x",
        "joint": "j",
        "value": 1,
        "limit": None,
    }
    return [
        Reader("plan, TOML", {"plan.toml": plan}, lambda f: read_plan(f / "plan.toml", mount)),
        Reader("plan, CSV", {"plan.csv": table}, lambda f: read_plan(f / "plan.csv", mount)),
        Reader("hand", hand, read_hand, tuple(n for n in hand if n not in ("hand.toml", "hand.urdf"))),
        Reader(
            "pinch", hand, lambda f: read_pinch(f / "hand.toml"), tuple(n for n in hand if n != "pinch.toml")
        ),
        Reader("message, state", {"message.json": json.dumps(state).encode()}, message),
        Reader("message, refused", {"message.json": json.dumps(refused).encode()}, message),
    ]


def _of_imports() -> list[Reader]:
    from skincal.dataset.findings import Findings
    from skincal.imports.csv_source import read_csv_files
    from skincal.imports.read_mapping import read_mapping
    from tests.imports.foreign import PRESS_ROWS, RIG, SERIES

    templates = {
        n: (ROOT / "skincal" / "imports" / "templates" / f"{n}.toml").read_bytes() for n in ("csv", "rosbag")
    }
    presses = "no;X;Y;Z;Fz;" + ";".join(f"s{j + 1}" for j in range(16)) + "\n"
    presses += "".join(f"{i};0,{i};23,5;11,5;-{900 + i};" + ";".join(["200"] * 16) + "\n" for i in range(5))
    series = "t,X,Y,Z,F," + ",".join(f"tax_{r}_{c}" for r in range(4) for c in range(4)) + "\n"
    series += "".join(f"{i * 10},0,23.5,11.5,{i % 7}," + ",".join(["3"] * 16) + "\n" for i in range(40))

    def read(folder: Path) -> None:
        findings = Findings()
        read_csv_files(read_mapping(folder / "mapping.toml", "csv"), [folder / "log.csv"], findings)
        findings.raise_errors()

    def mapped(rules: dict[str, Any], log: str) -> Files:
        return {"mapping.toml": tomli_w.dumps(RIG | rules).encode(), "log.csv": log.encode()}

    return [
        Reader("mapping, CSV", {"m.toml": templates["csv"]}, lambda f: read_mapping(f / "m.toml", "csv")),
        Reader("mapping, bag", {"m.toml": templates["rosbag"]}, lambda f: read_mapping(f / "m.toml", "bag")),
        Reader("import, presses", mapped(PRESS_ROWS, presses), read),
        Reader("import, series", mapped(SERIES, series), read),
    ]


def _here(read: Callable[..., Any], path: Path, *arguments: Any) -> Any:
    """In the place of a process of its own, which would take a hundred times as long."""
    return read(path, *arguments)


def _of_arrays(scratch: Path) -> list[Reader]:
    """Binary tables of :func:`read_csv_files`."""
    import h5py
    import scipy.io

    from skincal.dataset.findings import Findings
    from skincal.imports import source_table
    from skincal.imports.csv_source import read_csv_files
    from skincal.imports.read_mapping import read_mapping
    from tests.imports.foreign import RIG, SERIES

    numbered = {
        "csv": {"rows": "series"},
        "columns": {
            "time_s": {"column": "data[0]", "unit": "ms"},
            "position": {"columns": ["data[1]", "data[2]", "data[3]"], "unit": "mm"},
            "force_n": {"column": "data[4]", "unit": "N"},
        },
        "taxels": {"columns": "data[{j}]", "first": 5},
    }
    mappings = {}
    for kind, rules in (("named", SERIES), ("numbered", numbered)):
        (scratch / f"{kind}.toml").write_text(tomli_w.dumps(RIG | rules))
        mappings[kind] = read_mapping(scratch / f"{kind}.toml", "csv")
    time = np.arange(20.0)
    columns = {"t": 10 * time, "X": 0 * time, "Y": 23.5 + 0 * time, "Z": 11.5 + 0 * time, "F": time % 7}
    columns |= {f"tax_{r}_{c}": np.full(20, 3.0) for r in range(4) for c in range(4)}
    np.savez(scratch / "a.npz", **columns)
    np.save(scratch / "a.npy", np.column_stack(list(columns.values())))
    scipy.io.savemat(scratch / "a.mat", columns)
    with h5py.File(scratch / "a.h5", "w") as file:
        for name, values in columns.items():
            file[name] = values
    pq.write_table(pa.table(columns), scratch / "a.parquet")

    def read(file: Path) -> None:
        findings = Findings()
        mapping = mappings["numbered" if file.suffix == ".npy" else "named"]
        with patch.object(source_table, "apart", _here):
            read_csv_files(mapping, [file], findings)
        findings.raise_errors()

    kinds = {
        "NumPy, npz": "a.npz",
        "NumPy, npy": "a.npy",
        "MATLAB": "a.mat",
        "HDF5": "a.h5",
        "Parquet": "a.parquet",
    }
    return [
        Reader(
            f"import, {kind}",
            {name: (scratch / name).read_bytes()},
            lambda f, n=name: read(f / n),
            apart=name[2:] in ("mat", "h5", "parquet"),
        )
        for kind, name in kinds.items()
    ]


def _of_bags(scratch: Path) -> list[Reader]:
    from skincal.dataset.findings import Findings
    from skincal.imports import bag_source
    from skincal.imports.read_mapping import read_mapping
    from tests.conftest import make_session
    from tests.imports.foreign import RIG, recorded
    from tests.imports.ros import BAG, write_bag

    (scratch / "bag.toml").write_text(tomli_w.dumps(RIG | BAG))
    mapping = read_mapping(scratch / "bag.toml", "bag")
    recording = recorded(make_session(1, frames_per_press=0), rate_hz=5.0)

    def read(bag: Path) -> None:
        findings = Findings()
        with patch.object(bag_source, "apart", _here):
            bag_source.read_bags(mapping, [bag], findings)
        findings.raise_errors()

    one = write_bag(scratch / "one.bag", recording)
    two = write_bag(scratch / "two", recording)
    mcap = next(write_bag(scratch / "mcap", recording, "mcap").glob("*.mcap"))
    return [
        Reader("bag, ROS 1", {"one.bag": one.read_bytes()}, lambda f: read(f / "one.bag"), apart=True),
        Reader(
            "bag, ROS 2",
            {f"two/{n}": c for n, c in _contents(two).items()},
            lambda f: read(f / "two"),
            apart=True,
        ),
        Reader("bag, MCAP", {"one.mcap": mcap.read_bytes()}, lambda f: read(f / "one.mcap"), apart=True),
    ]


def _of_keys(scratch: Path) -> list[Reader]:
    from skincal.hand.sockets import client_keys, hand_keys, make_keys

    make_keys(scratch / "keys")
    hand, client = _contents(scratch / "keys" / "hand"), _contents(scratch / "keys" / "client")
    allowed = {f"allowed/{n}": c for n, c in _contents(scratch / "keys" / "hand" / "allowed").items()}
    return [Reader("keys, hand", hand | allowed, hand_keys), Reader("keys, client", client, client_keys)]


def _of_ranges() -> list[Reader]:
    from skincal.ranges import preset, read_ranges, write_ranges

    found: list[Reader] = []
    with TemporaryDirectory() as scratch:
        for suffix in ("toml", "json", "yaml"):
            path = Path(scratch) / f"ranges.{suffix}"
            write_ranges(preset("iros24"), path)
            name = path.name
            found.append(
                Reader(f"ranges, {suffix}", {name: path.read_bytes()}, lambda f, n=name: read_ranges(f / n))
            )
    return found


DEPLOYED = {
    "task": "marble", "policy": "marble-desired-1", "steps": 80, "rest_counts": [0.0] * 16,
    "asked": {"trajectory": "circle", "write": None, "frequency_hz": 0.25, "duration_s": None,
              "speed_rad_per_s": 0.3, "orientation_deg": 0.0},
}  # fmt: skip
"""What `deploy` leaves of its run, as far as it is read."""


def _of_runs(scratch: Path) -> list[Reader]:
    from skincal.calibrate.checkpoint import Checkpoint
    from skincal.collect.journal import Journal
    from skincal.deploy.record import read_run_file
    from skincal.envs.trajectories import read_targets
    from skincal.fitting.grid import GridSlab
    from skincal.sim.touch import SkinMemory
    from skincal.train import read_curve, read_policy, read_run
    from skincal.train.curve import COLUMNS
    from skincal.train.estimator import read_estimator

    policy = (ROOT / "skincal" / "policies" / "marble-desired-1.onnx").read_bytes()
    estimator = (ROOT / "skincal" / "policies" / "marble-estimator-1.npz").read_bytes()
    run = ROOT / "data" / "training" / "marble-desired-1"
    Checkpoint(scratch / "c", "key").keep(3, GridSlab(*(np.ones((2, 3)) for _ in range(3))))
    journal = Journal.open(scratch / "j", {"plan": "p"}, {"created": "2026-11-20T12:00:00Z"}, restart=False)
    journal.connected({"first": 0, "resumed": False, "shift_s": 0.0})
    journal.keep_press(0, {"press.force_n": np.array(1.0), "frames.time_s": np.arange(3.0)})

    def journals(folder: Path) -> None:
        if (found := Journal.find(folder)) is not None:
            found.presses(), found.connections(), found.rests()

    def memory(folder: Path) -> None:
        SkinMemory(folder / "memory.bin", 6).close()

    look = np.arange(29.0).tobytes()
    curve = ",".join(COLUMNS) + "\n" + (",".join(["1.0"] * len(COLUMNS)) + "\n") * 3
    return [
        Reader("policy", {"p.onnx": policy}, lambda f: read_policy(f / "p.onnx")(np.zeros(34))),
        Reader("estimator", {"e.npz": estimator}, lambda f: read_estimator(f / "e.npz")),
        Reader("deployed", {"deploy.json": json.dumps(DEPLOYED).encode()}, read_run_file),
        Reader(
            "run",
            {n: (run / n).read_bytes() for n in ("run.toml", "ranges.toml")},
            read_run,
            ("ranges.toml",),
        ),
        Reader("checkpoint", _contents(scratch / "c"), lambda f: Checkpoint(f, "key").load()),
        Reader("journal", _contents(scratch / "j"), journals),
        Reader("skin memory", {"memory.bin": b"skinmem1" + look * 2}, memory),
        Reader("curve", {"curve.csv": curve.encode()}, lambda f: read_curve(f / "curve.csv")),
        Reader(
            "trajectory", {"t.csv": b"u_m,v_m\n0.0,0.001\n0.001,0.002\n"}, lambda f: read_targets(f / "t.csv")
        ),
    ]


# What numbers and texts are replaced by.
WORDS = [b"nan", b"inf", b"-inf", b"1e999", b"-1", b"0", b"9" * 400, b"9" * 5000, b"0x" + b"f" * 300, b"1e15", b"-0.0",
         b"1000000000", b"2147483648", b"18446744073709551616", b"true", b'""', b"[]", b"{}", b"'", b'"', b"[[[[",
         b"\0", b"\xff", b"\xed\xa0\x80", b"1,5", b";", b"\n", b"\r", b"1979-05-27T07:32:00Z", b"!!timestamp x",
         b'!!int ""',
         b"&a [*a]", b"..", b"/dev/zero", b"a" * 300, b"[" * 3000, b"x" + b".a" * 3000, b"null", b"-",
         b"=", b"#"]  # fmt: skip


def _value(rng: random.Random, depth: int = 0) -> Any:
    """A value of any kind that JSON or TOML can hold."""
    plain: list[Any] = [
        0, 1, -1, 10**9, 2**62, 2**63, 10**400, 0.0, -0.5, 1e300, 1e-300, math.nan, math.inf, -math.inf, True, False,
        "", "x", "nan", "1.5", "a" * 200, "\0", "é", "../x", "presses.csv", [], {}, [1, 2], [2, 1], [math.nan, 1.0],
    ]  # fmt: skip
    if depth < 3 and rng.random() < 0.3:
        inner = [_value(rng, depth + 1) for _ in range(rng.randrange(4))]
        return inner if rng.random() < 0.5 else {f"k{i}": value for i, value in enumerate(inner)}
    return rng.choice(plain)


def _places(value: Any) -> list[tuple[Any, Any]]:
    """Every (container, key) in nested tables and lists."""
    keys = (
        list(value) if isinstance(value, dict) else list(range(len(value))) if isinstance(value, list) else []
    )
    return [(value, key) for key in keys] + [place for key in keys for place in _places(value[key])]


def _restructured(rng: random.Random, name: str, content: bytes) -> bytes:
    """A TOML or JSON file of the right syntax with other values, keys and tables; others as they are."""
    text = content.decode()
    table = json.loads(text) if name.endswith(".json") else tomllib.loads(text)
    for _ in range(rng.choice((1, 1, 1, 2, 4))):
        container, key = rng.choice(_places(table))
        action = rng.random()
        if action < 0.7:
            container[key] = _value(rng)
        elif action < 0.85:
            container.pop(key)
        elif isinstance(container, dict):
            container[rng.choice(["x", "file", "rows", f"{key}_", str(key) * 2])] = container.pop(key)
        if not _places(table):
            break
    return json.dumps(table).encode() if name.endswith(".json") else tomli_w.dumps(table).encode()


def _retyped(rng: random.Random, _: str, content: bytes) -> bytes:
    """A Parquet file with columns of other types, sizes and names."""
    table = pq.read_table(io.BytesIO(content))
    rows = table.num_rows
    kinds: list[Callable[[], pa.Array]] = [
        lambda: pa.array([[1.0, 2.0]] * rows), lambda: pa.array([{"a": 1}] * rows), lambda: pa.nulls(rows),
        lambda: pa.array([b"\xff"] * rows), lambda: pa.array(["1.5"] * rows),
        lambda: pa.array(["x"] * rows).dictionary_encode(),
        lambda: pa.array([2**64 - 1] * rows, pa.uint64()), lambda: pa.array([1] * rows).cast(pa.timestamp("ns")),
        lambda: pa.array([1] * rows, pa.date32()),
        lambda: pa.array([True] * rows), lambda: pa.array(np.full(rows, np.inf)),
        lambda: pa.array([None, *[1] * (rows - 1)]),
        lambda: pa.array(np.ones(rows, np.float16)), lambda: pa.array([1] * rows).cast(pa.decimal128(30, 5)),
        lambda: pa.array([1] * rows).cast(pa.duration("s")), lambda: pa.array(["a"] * rows, pa.large_string()),
    ]  # fmt: skip
    for _ in range(rng.choice((1, 1, 3))):
        i = rng.randrange(table.num_columns)
        name = table.column_names[i]
        action = rng.random()
        if action < 0.7:
            table = table.set_column(i, name, rng.choice(kinds)())
        elif action < 0.8:
            table = table.append_column(rng.choice([name, "x", "taxel_9_9", "a.b", ""]), rng.choice(kinds)())
        elif action < 0.9 and table.num_columns > 1:
            table = table.remove_column(i)
        else:
            table = table.slice(0, rng.randrange(rows + 1)) if rows else table
            rows = table.num_rows
        if not rows:
            break
    target = io.BytesIO()
    pq.write_table(table, target)
    return target.getvalue()


def _cut(rng: random.Random, content: bytes) -> tuple[int, int]:
    start = rng.randrange(len(content) + 1)
    return start, min(len(content), start + int(rng.expovariate(1 / 20)))


def _scrambled(rng: random.Random, content: bytes) -> bytes:
    """Bytes flipped, cut out, put in, repeated; numbers replaced; lines dropped, doubled, swapped."""
    for _ in range(rng.choice((1, 1, 1, 2, 5))):
        start, end = _cut(rng, content)
        action = rng.randrange(8)
        if action == 0 and content:
            at = min(start, len(content) - 1)
            content = content[:at] + bytes([content[at] ^ (1 << rng.randrange(8))]) + content[at + 1 :]
        elif action == 1:
            content = content[:start] + content[end:]
        elif action == 2:
            content = content[:start] + rng.randbytes(rng.randrange(1, 9)) + content[start:]
        elif action == 3:
            content = content[:start] + content[start:end] * rng.choice((2, 3, 50)) + content[end:]
        elif action == 4:
            content = content[:start]
        elif action in (5, 6):
            content = _replaced(rng, content)
        else:
            lines = content.split(b"\n")
            i, j = rng.randrange(len(lines)), rng.randrange(len(lines))
            lines[i], lines[j] = rng.choice(((lines[j], lines[i]), (b"", lines[j]), (lines[j], lines[j])))
            content = b"\n".join(lines)
    return content


def _replaced(rng: random.Random, content: bytes) -> bytes:
    """A run of the letters that numbers and words are made of, replaced by something else."""
    start, _ = _cut(rng, content)
    inside = frozenset(b"0123456789.+-eE_abcdfghijklmnopqrstuvwxyz")
    while start < len(content) and content[start] not in inside:
        start += 1
    begin = end = start
    while begin > 0 and content[begin - 1] in inside:
        begin -= 1
    while end < len(content) and content[end] in inside:
        end += 1
    return content[:begin] + rng.choice(WORDS) + content[end:]


def damaged(rng: random.Random, reader: Reader) -> tuple[str, bytes]:
    """Name and damaged content of one of a reader's files."""
    name = rng.choice([name for name in reader.files if name not in reader.fixed])
    content = reader.files[name]
    remade = {".toml": _restructured, ".json": _restructured, ".parquet": _retyped}.get(Path(name).suffix)
    if remade is not None and rng.random() < 0.6:
        content = remade(rng, name, content)
        if rng.random() < 0.9:
            return name, content
    return name, _scrambled(rng, content)
