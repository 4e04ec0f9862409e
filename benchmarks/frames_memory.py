"""Peak memory of a check and a fit of a session with very many frames.

    python benchmarks/frames_memory.py [--frames 10000000] [--columns 46] [--out runs/frames-memory] [--no-fit]

Frames are made for the presses of ``data/paper-like``: at rest, loading, held, unloading; 16 taxels, and joint angles.
"""

from __future__ import annotations

import argparse
import json
import os
import shutil
import subprocess
import sys
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq

ROOT = Path(__file__).parents[1]
LEVELS = ((0, 0.0), (1, 0.5), (2, 1.0), (3, 0.5))
"""Phase, and share of the press's force and counts."""


def make(out: Path, frames: int, columns: int) -> None:
    """Writes the session, press by press."""
    from skincal.dataset import PHASES, read_dataset

    shutil.rmtree(out, ignore_errors=True)
    shutil.copytree(ROOT / "data" / "paper-like", out)
    dataset = read_dataset(out)
    presses, names = dataset.presses, dataset.meta.sensor.taxel_columns()
    each = frames // len(presses)
    level = np.repeat([share for _, share in LEVELS], [each - 3 * (each // 4), *[each // 4] * 3])
    phase = np.repeat([PHASES[number] for number, _ in LEVELS], [each - 3 * (each // 4), *[each // 4] * 3])
    writer, own = None, 7 + len(names)
    for k in range(len(presses)):
        idle = level == 0
        table = {
            "press": np.where(idle, -1, presses.press[k]), "phase": phase,
            "time_s": (k * each + np.arange(each)) * 1e-3, "force_n": level * presses.force_n[k],
            **{f"{axis}_m": np.where(idle, np.nan, presses.position_m[k, i]) for i, axis in enumerate("xyz")},
            **{name: np.rint(level * presses.counts[k, j]) for j, name in enumerate(names)},
            **{f"q_{i}": np.round(np.sin(k + 0.01 * i) + 1e-3 * level, 4) for i in range(columns - own)},
        }  # fmt: skip
        rows = pa.table(table)
        writer = writer or pq.ParquetWriter(out / "frames.parquet", rows.schema, compression="zstd")
        writer.write_table(rows)
    assert writer is not None
    writer.close()


def measured(*command: str) -> dict[str, float]:
    """Runs a command of skincal; its processor time and peak memory, worker processes apart."""
    process = subprocess.Popen([sys.executable, "-m", "skincal", *command], stdout=subprocess.DEVNULL)
    _, status, usage = os.wait4(process.pid, 0)
    if status:
        sys.exit(f"skincal {command[0]} failed")
    return {"cpu_s": round(usage.ru_utime + usage.ru_stime, 1), "peak_gb": round(usage.ru_maxrss / 1e6, 2)}


def main() -> None:
    """Runs the command."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--frames", type=int, default=10_000_000)
    parser.add_argument("--columns", type=int, default=46)
    parser.add_argument("--out", type=Path, default=Path("runs/frames-memory"))
    parser.add_argument("--no-fit", action="store_true")
    arguments = parser.parse_args()
    session = arguments.out / "session"
    session.parent.mkdir(parents=True, exist_ok=True)
    make(session, arguments.frames, arguments.columns)
    found: dict[str, object] = {"file_mb": round((session / "frames.parquet").stat().st_size / 1e6, 1)}
    found["dataset check"] = measured("dataset", "check", str(session))
    if not arguments.no_fit:
        found["fit"] = measured("fit", str(session), "--out", str(arguments.out / "fit"), "--force", "--json")
    print(json.dumps(found, indent=1))


if __name__ == "__main__":
    main()
