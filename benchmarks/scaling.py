"""What an image costs against resolution, taxels, faces of a mesh and presses in a batch.

    python -m benchmarks.scaling [--rounds 5] [--out FILE]

Processor time of one core, medians of rounds taken in turns, after a first one that is not counted. ``slope`` is that
of a line through the logarithms: 1 where the cost grows in proportion, 0 where it does not grow.
"""

# ruff: noqa: E402 - the number of threads is read when numpy is imported
from __future__ import annotations

import os

for _threads in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "VECLIB_MAXIMUM_THREADS"):
    os.environ[_threads] = "1"

import argparse
import json
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import trimesh

from benchmarks.model_speed import (
    BALL_RADIUS_M,
    ELASTICITY_PA_PER_M,
    SCALE_PER_N,
    cpu_model,
    one_core,
    presses,
    seconds,
)
from skincal.model import (
    Contacts,
    Converter,
    Cylinder,
    Indenter,
    MeshIndenter,
    Patch,
    SensorPose,
    Skin,
    SkinParameters,
    Sphere,
    TaxelLayout,
)

FINGER = Cylinder(0.0115)
BALL = Sphere(BALL_RADIUS_M)
PRESSES = 32
Case = tuple[float, Callable[[], object], int]
"""The size, the work and how many images it gives."""


def skin(taxels_a_side: int = 4, resolution_m: float = 2.5e-4) -> Skin:
    """The paper's patch, its sensed area cut into so many taxels."""
    pitch = 0.016 / taxels_a_side
    layout = TaxelLayout.grid(taxels_a_side, taxels_a_side, taxel_size_m=0.625 * pitch, pitch_m=pitch)
    patch = Patch.build(FINGER, layout, SensorPose(0.0235, 0.2, 0.04), resolution_m)
    return Skin(patch, SkinParameters(ELASTICITY_PA_PER_M, SCALE_PER_N), Converter.none())


def ball_of(subdivisions: int) -> MeshIndenter:
    mesh = trimesh.creation.icosphere(subdivisions, radius=BALL_RADIUS_M)
    return MeshIndenter(mesh.vertices + np.array([0.0, 0.0, BALL_RADIUS_M]), mesh.faces)


def pressed(size: float, what: Skin, indenter: Indenter, contacts: Contacts) -> Case:
    return size, lambda: what.image(indenter, contacts), len(contacts)


def cases() -> dict[str, list[Case]]:
    """What is measured, by what is changed."""
    some, many = presses(FINGER, PRESSES, 1), presses(FINGER, 1024, 1)
    plain = skin()
    resolved = [skin(resolution_m=r) for r in (1e-3, 7e-4, 5e-4, 3.5e-4, 2.5e-4, 1.8e-4)]
    cut = {n: skin(n) for n in (4, 8, 16, 32)}
    meshes = [ball_of(n) for n in (3, 4, 5, 6)]
    return {
        "tactile points": [pressed(len(s.patch), s, BALL, some) for s in resolved],
        "tactile points, mesh of 20480 faces": [pressed(len(s.patch), s, meshes[2], some) for s in resolved],
        "taxels": [pressed(n * n, s, BALL, some) for n, s in cut.items()],
        "faces of a mesh": [pressed(len(m.mesh.faces), plain, m, some) for m in meshes],
        "presses in a batch": [pressed(n, plain, BALL, many[:n]) for n in (1, 4, 16, 64, 256, 1024)],
    }


def measure(rounds: int) -> dict[str, Any]:
    """Microseconds an image of every case, and slopes."""
    found: dict[str, Any] = {}
    for name, some in cases().items():
        # A few images at a time: less could not be measured.
        again = {size: max(1, PRESSES // images) for size, _, images in some}
        times: dict[float, list[float]] = {size: [] for size, _, _ in some}
        for turn in range(rounds + 1):
            for size, work, images in some:
                took = seconds(lambda work=work, n=again[size]: [work() for _ in range(n)])
                if turn:
                    times[size].append(1e6 * took / images / again[size])
        cost = {size: float(np.median(values)) for size, values in times.items()}
        slope = np.polyfit(np.log(list(cost)), np.log(list(cost.values())), 1)[0]
        found[name] = {
            "slope": round(float(slope), 2),
            "points": [{name: size, "us an image": round(us, 2)} for size, us in cost.items()],
        }
    return {"cpu": cpu_model(), "cost": found}


def main(arguments: Sequence[str] | None = None) -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--rounds", type=int, default=5)
    parser.add_argument("--out", type=Path, help="file for the figures (JSON)")
    given = parser.parse_args(arguments)
    one_core()
    text = json.dumps(measure(given.rounds), indent=1)
    print(text)
    if given.out is not None:
        given.out.write_text(text + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
