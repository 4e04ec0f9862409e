"""How many tactile images a second a GPU gives, against the batch.

    python -m benchmarks.gpu [--batches 64 1024 4096 16384 131072] [--precision single] [--block 128] [--out FILE]

The closed-form sphere on the paper's patch, presses already on the device, images left there; medians of rounds, by the
device's clock. The first batch is compared with the processor's images. Needs the extra ``skincal[gpu]`` and a device.
"""

from __future__ import annotations

import argparse
import json
import sys
import time
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.model_speed import (
    BALL_RADIUS_M,
    ELASTICITY_PA_PER_M,
    SCALE_PER_N,
    cpu_model,
    finger_patch,
    presses,
)
from skincal.errors import InputError
from skincal.model import Converter, Skin, SkinParameters, Sphere
from skincal.model.gpu import DeviceSkin
from skincal.model.gpu.device_skin import require_gpu

BATCHES = (64, 1024, 4096, 16384, 131072)


def run(batches: list[int], precision: Any, block: int, rounds: int) -> dict[str, Any]:
    """Images a second for each batch, and the largest difference from the processor's images."""
    cuda = require_gpu()
    finger, patch = finger_patch()
    skin = Skin(patch, SkinParameters(ELASTICITY_PA_PER_M, SCALE_PER_N), Converter.none())
    ball = Sphere(BALL_RADIUS_M)
    device = DeviceSkin(skin, ball, precision=precision, block=block)
    some = presses(finger, min(batches[0], 512), 1)
    expected = skin.values(ball, some)
    rows = []
    for batch in batches:
        again = np.arange(batch) % len(some)
        given = [cuda.to_device(array[again]) for array in (some.normals, some.points_m, some.force_n)]
        image = device.respond(*given).image
        apart = np.abs(image.copy_to_host()[: len(some)] - expected[: min(batch, len(some))]).max()
        times = []
        for _ in range(rounds):
            cuda.synchronize()
            begin = time.perf_counter()
            device.respond(*given, image=image)
            cuda.synchronize()
            times.append(time.perf_counter() - begin)
        seconds = float(np.median(times))
        rows.append(
            {
                "batch": batch,
                "images a second": batch / seconds,
                "us an image": 1e6 * seconds / batch,
                "largest difference [counts]": float(apart),
            }
        )
    name = cuda.get_current_device().name if hasattr(cuda, "get_current_device") else "numba's simulator"
    return {
        "device": name.decode() if isinstance(name, bytes) else str(name),
        "host": cpu_model(),
        "precision": precision,
        "threads of a press": block,
        "largest value [counts]": float(expected.max()),
        "sphere": rows,
    }


def main() -> int:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--batches", type=int, nargs="+", default=list(BATCHES))
    parser.add_argument("--precision", choices=("single", "double"), default="single")
    parser.add_argument("--block", type=int, default=128, help="threads of a press, a power of two")
    parser.add_argument("--rounds", type=int, default=15)
    parser.add_argument("--out", type=Path, help="file for the figures (JSON)")
    given = parser.parse_args()
    try:
        found = run(given.batches, given.precision, given.block, given.rounds)
    except InputError as error:
        print(error, file=sys.stderr)
        return error.exit_status
    text = json.dumps(found, indent=1)
    print(text)
    if given.out is not None:
        given.out.write_text(text + "\n", encoding="utf-8")
    return 0


if __name__ == "__main__":
    sys.exit(main())
