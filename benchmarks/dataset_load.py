"""Time to read, check and write a session of a million frames.

Run it with ``python benchmarks/dataset_load.py``; ``--frames`` sets the length of the session.
"""

from __future__ import annotations

import argparse
import json
import tempfile
import time
from pathlib import Path

import numpy as np

from skincal.dataset import (
    Dataset,
    DatasetMeta,
    Frames,
    IndenterSpec,
    MountSpec,
    PositionSpec,
    Presses,
    SensorSpec,
    SurfaceSpec,
    read_dataset,
    write_dataset,
)

FRAMES_PER_PRESS = 100
RADIUS_M = 0.0115

META = DatasetMeta(
    sensor=SensorSpec(4, 4, (0.0025, 0.0025), (0.004, 0.004), value_min=0, value_max=255, integer=True),
    surface=SurfaceSpec("cylinder", RADIUS_M),
    indenter=IndenterSpec("sphere", 0.006),
    mount=MountSpec(0.0235, 0.0, (0.0195, 0.0275), (-20.0, 20.0), beta_deg=0.0, beta_range_deg=(-12.0, 12.0)),
    position=PositionSpec(0.001, 0.002),
    source="benchmark",
)


def session(frames: int, seed: int = 0) -> Dataset:
    """A session of random images on the cylinder, 100 frames a press, with the usual covariates."""
    generator = np.random.default_rng(seed)
    presses = max(frames // FRAMES_PER_PRESS, 1)
    beta, y = generator.uniform(-0.4, 0.4, presses), generator.uniform(0.016, 0.031, presses)
    points = np.column_stack([RADIUS_M * np.sin(beta), y, RADIUS_M * np.cos(beta)])
    force = generator.uniform(1.0, 4.0, presses)
    press = np.minimum(np.arange(frames) // FRAMES_PER_PRESS, presses - 1)
    step = np.arange(frames) % FRAMES_PER_PRESS
    phase = np.digitize(step, [10, 30, 80]).astype(np.int8)
    idle = phase == 0
    return Dataset(
        META,
        Presses(np.arange(presses), points, force, generator.uniform(0, 255, (presses, 16))),
        Frames(
            press=np.where(idle, -1, press),
            phase=phase,
            time_s=np.arange(frames) * 0.01,
            force_n=np.where(idle, 0.0, force[press]),
            position_m=np.where(idle[:, None], np.nan, points[press]),
            counts=generator.integers(0, 256, (frames, 16)).astype(float),
            columns={
                "pose": np.array(["A", "B"], dtype=object)[press % 2],
                "temperature_c": generator.normal(25, 1, frames),
            },
        ),
    )


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--frames", type=int, default=1_000_000)
    parser.add_argument("--out", type=Path, help="file for the figures (JSON)")
    given = parser.parse_args()
    frames = given.frames
    dataset = session(frames)
    print(f"{frames} frames, {len(dataset.presses)} presses, {dataset.meta.sensor.taxels} taxels")
    found: dict[str, dict[str, float]] = {}
    with tempfile.TemporaryDirectory() as folder:
        for frames_as in ("parquet", "csv"):
            path = Path(folder) / frames_as
            start = time.perf_counter()
            write_dataset(dataset, path, frames_as=frames_as)
            written = time.perf_counter()
            read_dataset(path)
            read = time.perf_counter()
            size = sum(file.stat().st_size for file in path.iterdir()) / 1e6
            times = f"write {written - start:5.2f} s   read and check {read - written:5.2f} s"
            print(f"{frames_as:8s} {times}   {size:5.0f} MB")
            found[frames_as] = {
                "write_s": round(written - start, 2),
                "read_and_check_s": round(read - written, 2),
                "size_mb": round(size),
            }
    if given.out is not None:
        content = {"study": {"frames": frames, "presses": len(dataset.presses)}, "files": found}
        given.out.write_text(json.dumps(content, indent=1) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
