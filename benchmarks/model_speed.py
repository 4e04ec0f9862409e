"""Time of a tactile image, against a plain implementation of the paper's method.

    python benchmarks/model_speed.py [--presses 64] [--rounds 7] [--json]

The plain method casts a ray from every tactile point (14 884) with trimesh's location query and searches the
penetration in steps of 0.1 mm (Kasolowsky & Baeuml, IROS 2024, section II-B). It is run twice: with the query as it
comes (every hit on the way) and asked for the first hit only, which is the least it needs. Ours is measured on a
batch of presses and on one press at a time; on a mesh also against embree's bare query of the touched points.
All of them in one process on one core, in turns, so that a busy machine
slows them alike; medians over the rounds of the processor time used. The results are compared too.
"""

# ruff: noqa: E402 - the number of threads is read when numpy is imported
from __future__ import annotations

import os

for _threads in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "VECLIB_MAXIMUM_THREADS"):
    os.environ[_threads] = "1"

import argparse
import json
import sys
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import trimesh

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

ELASTICITY_PA_PER_M = 4e8
SCALE_PER_N = 68.0
STEP_M = 1e-4
FINE_STEP_M = 1e-6
Result = dict[str, Any]
BALL_RADIUS_M = 0.006


@dataclass(frozen=True)
class Case:
    """An indenter as ours takes it, and the mesh that the plain method casts at."""

    name: str
    indenter: Indenter
    mesh: trimesh.Trimesh
    goal: float
    goal_on: str


def ball_mesh() -> trimesh.Trimesh:
    """The calibration's ball, 20 480 faces."""
    mesh = trimesh.creation.icosphere(5, radius=BALL_RADIUS_M)
    return mesh.apply_translation([0.0, 0.0, BALL_RADIUS_M])


def bolt_mesh() -> trimesh.Trimesh:
    """A threaded bolt of 6 mm radius and 20 mm length, lying across the finger on a crest of its thread."""
    along = np.linspace(-0.01, 0.01, 161)
    radius = BALL_RADIUS_M - 2e-4 * (1 - np.cos(2 * np.pi * along / 1e-3))
    profile = np.column_stack([np.r_[0.0, radius, 0.0], np.r_[along[0], along, along[-1]]])
    bolt = trimesh.creation.revolve(profile, sections=96)
    bolt.apply_transform(trimesh.transformations.rotation_matrix(np.pi / 2, [0, 1, 0]))
    bolt.apply_translation([0.0, 0.0, -bolt.bounds[0, 2]])
    return bolt


class PlainSkin:
    """The paper's method, step by step, with nothing spared and nothing wasted."""

    def __init__(
        self, patch: Patch, mesh: trimesh.Trimesh, *, every_hit: bool, step_m: float = STEP_M
    ) -> None:
        self.patch, self.mesh, self.every_hit, self.step_m = patch, mesh, every_hit, step_m
        self.start_m = 0.05
        mesh.ray.intersects_first(np.zeros((1, 3)), np.array([[0.0, 0.0, 1.0]]))  # builds the ray structure

    def image(self, contacts: Contacts, k: int) -> tuple[np.ndarray, float]:
        """Values (J,) [counts] and penetration [m] of one press."""
        normal, rotation = contacts.normals[k], contacts.indenter_rotations[k]
        origins = (self.patch.points_m - self.start_m * normal - contacts.points_m[k]) @ rotation
        directions = np.tile(normal @ rotation, (len(origins), 1))
        places, ray, face = self.mesh.ray.intersects_location(
            origins, directions, multiple_hits=self.every_hit
        )
        length = np.einsum("ij,ij->i", places - origins[ray], directions[ray])
        distance = np.full(len(origins), np.inf)
        np.minimum.at(distance, ray, length)
        facing = np.zeros(len(origins))
        first = length == distance[ray]
        facing[ray[first]] = -self.mesh.face_normals[face[first]] @ directions[0]

        weight = self.patch.areas_m2 * np.maximum(self.patch.normals @ normal, 0.0)
        gap = distance - distance.min()
        depth = 0.0
        while True:
            local = np.maximum(depth - gap, 0.0)
            if ELASTICITY_PA_PER_M * np.sum(local * weight) >= contacts.force_n[k]:
                break
            depth += self.step_m
        load = ELASTICITY_PA_PER_M * local * weight * np.maximum(facing, 0.0)
        return SCALE_PER_N * np.bincount(self.patch.taxel + 1, load)[1:], depth


def finger_patch() -> tuple[Cylinder, Patch]:
    finger = Cylinder(0.0115)
    layout = TaxelLayout.grid(4, 4, taxel_size_m=0.0025, pitch_m=0.004)
    return finger, Patch.build(finger, layout, SensorPose(0.0235, 0.2, 0.04))


def presses(finger: Cylinder, count: int, seed: int) -> Contacts:
    """Presses as in the paper's calibration: over the sensor, 1 to 4 N."""
    rng = np.random.default_rng(seed)
    start = np.tile([0.0, 0.0235, finger.radius_m], (count, 1))
    points = finger.offset(start, rng.uniform(-7e-3, 7e-3, count), rng.uniform(-7e-3, 7e-3, count))
    return Contacts(points, finger.normal_at(points), rng.uniform(1.0, 4.0, count))


def seconds(work: Callable[[], object]) -> float:
    start = time.process_time()
    work()
    return time.process_time() - start


def measure(case: Case, patch: Patch, contacts: Contacts, rounds: int) -> dict[str, float]:
    """Median time an image [s] of every way, taken in turns."""
    skin = Skin(patch, SkinParameters(ELASTICITY_PA_PER_M, SCALE_PER_N), Converter.none())
    every, first = (PlainSkin(patch, case.mesh, every_hit=flag) for flag in (True, False))
    singles = [contacts[k : k + 1] for k in range(len(contacts))]
    few = range(0, len(contacts), max(1, len(contacts) // 8))
    ways: dict[str, tuple[Callable[[], object], int]] = {
        "plain": (lambda: [every.image(contacts, k) for k in few], len(few)),
        "plain_first_hit": (lambda: [first.image(contacts, k) for k in few], len(few)),
        "ours_single": (lambda: [skin.image(case.indenter, one) for one in singles], len(singles)),
        "ours_batch": (lambda: skin.image(case.indenter, contacts), len(contacts)),
    }
    if isinstance(case.indenter, MeshIndenter):
        ways["bare_query"] = (bare_query(skin, case.indenter, contacts), len(contacts))
    for work, _ in ways.values():
        work()
    times: dict[str, list[float]] = {name: [] for name in ways}
    for _ in range(rounds):
        for name, (work, images) in ways.items():
            times[name].append(seconds(work) / images)
    return {name: float(np.median(values)) for name, values in times.items()}


def bare_query(skin: Skin, indenter: MeshIndenter, contacts: Contacts) -> Callable[[], object]:
    """Embree alone, asked for the points that the presses touch: what a press of a mesh costs at least."""
    pressed, mesh = skin.pressures(indenter, contacts), indenter.mesh
    press = np.repeat(np.arange(len(contacts)), np.diff(pressed.starts))
    away = skin.patch.points_m[pressed.points] - contacts.points_m[press]
    origins = np.einsum("ni,nij->nj", away, contacts.indenter_rotations[press]) - mesh.centre_m
    origins[:, 2] = -1.01 * mesh.radius_m
    starts = (origins * mesh.rays.scale).astype(np.float32)
    ways = np.tile(np.array([0.0, 0.0, 1.0], dtype=np.float32), (len(starts), 1))
    return lambda: mesh.rays.run(starts, ways)


def compare(case: Case, patch: Patch, contacts: Contacts) -> dict[str, float]:
    """Compare the plain method with ours: at its own step, and at one so fine that it does not matter."""
    skin = Skin(patch, SkinParameters(ELASTICITY_PA_PER_M, SCALE_PER_N), Converter.none())
    some = contacts[:8]
    ours, depth = skin.values(case.indenter, some), skin.respond(case.indenter, some).penetration_m
    plain = [PlainSkin(patch, case.mesh, every_hit=True).image(some, k) for k in range(len(some))]
    fine = [
        PlainSkin(patch, case.mesh, every_hit=True, step_m=FINE_STEP_M).image(some, k)[0]
        for k in range(len(some))
    ]
    return {
        "penetration_difference_m": float(
            np.max([found - d for (_, found), d in zip(plain, depth, strict=True)])
        ),
        "image_difference_counts": float(np.abs(np.array([image for image, _ in plain]) - ours).max()),
        "image_difference_fine_step_counts": float(np.abs(np.array(fine) - ours).max()),
        "largest_value_counts": float(ours.max()),
    }


def one_core() -> None:
    if hasattr(os, "sched_setaffinity"):
        os.sched_setaffinity(0, {min(os.sched_getaffinity(0))})


def cpu_model() -> str:
    try:
        lines = Path("/proc/cpuinfo").read_text().splitlines()
    except OSError:
        return "unknown"
    return next((line.split(":", 1)[1].strip() for line in lines if line.startswith("model name")), "unknown")


def run(count: int, rounds: int, seed: int) -> Result:
    finger, patch = finger_patch()
    contacts = presses(finger, count, seed)
    ball, bolt = ball_mesh(), bolt_mesh()
    cases = [
        Case("sphere, closed form", Sphere(BALL_RADIUS_M), ball, 500.0, "ours_batch"),
        Case("sphere, 20480 faces", MeshIndenter(ball.vertices, ball.faces), ball, 10.0, "ours_batch"),
        Case(
            f"bolt, {len(bolt.faces)} faces",
            MeshIndenter(bolt.vertices, bolt.faces),
            bolt,
            10.0,
            "ours_batch",
        ),
    ]
    results = []
    for case in cases:
        times = measure(case, patch, contacts, rounds)
        ours = {way: times[way] for way in ("ours_batch", "ours_single")}
        against = [way for way in ("plain", "plain_first_hit", "bare_query") if way in times]
        ratios = {way: {p: times[p] / t for p in against} for way, t in ours.items()}
        reached = ratios[case.goal_on]["plain"] >= case.goal
        results.append(
            {
                "case": case.name,
                "goal": f"{case.goal:g} x in a batch",
                "goal_reached": bool(reached),
                "seconds_an_image": times,
                "times_faster": ratios,
                "agreement": compare(case, patch, contacts),
            }
        )
    return {
        "cpu": cpu_model(),
        "tactile_points": len(patch),
        "presses": count,
        "rounds": rounds,
        "cases": results,
    }


def show(result: Result) -> None:
    print(
        f"{result['cpu']}, one core; {result['tactile_points']} tactile points, {result['presses']} presses in a batch;"
    )
    print(
        f"processor time, medians of {result['rounds']} rounds. Milliseconds an image, and how many times faster ours"
    )
    print("is than the plain method (than the plain method asked for the first hit only).\n")
    print(f"{'':28}{'plain':>8}{'(first)':>9}{'ours, batch':>14}{'ours, single':>27}")
    for case in result["cases"]:
        t, f = case["seconds_an_image"], case["times_faster"]
        line = f"{case['case']:28}{1e3 * t['plain']:8.2f}{1e3 * t['plain_first_hit']:9.2f}"
        for way in ("ours_batch", "ours_single"):
            line += f"{1e3 * t[way]:10.3f}{f[way]['plain']:8.1f} x ({f[way]['plain_first_hit']:.1f} x)"
        print(line)
    print()
    for case in result["cases"]:
        t = case["seconds_an_image"]
        if "bare_query" in t:
            print(
                f"{case['case']}: embree alone for the touched points {1e6 * t['bare_query']:.1f} us an image; "
                f"ours {t['ours_batch'] / t['bare_query']:.2f} times that in a batch, "
                f"{t['ours_single'] / t['bare_query']:.2f} singly."
            )
    for case in result["cases"]:
        a = case["agreement"]
        print(
            f"{case['case']}: goal of {case['goal']} {'reached' if case['goal_reached'] else 'MISSED'}.\n  The plain "
            f"method goes up to {1e3 * a['penetration_difference_m']:.3f} mm too deep (its step: {1e3 * STEP_M:g} mm) "
            f"and is off by up to {a['image_difference_counts']:.1f} of {a['largest_value_counts']:.0f} counts;\n"
            f"  in steps of {1e3 * FINE_STEP_M:g} mm it is off by {a['image_difference_fine_step_counts']:.2f}."
        )


def main() -> int:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--presses", type=int, default=64, help="presses in a batch")
    parser.add_argument("--rounds", type=int, default=7, help="how often each way is measured")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--json", action="store_true", help="print one JSON object and nothing else")
    arguments = parser.parse_args()
    one_core()
    result = run(arguments.presses, arguments.rounds, arguments.seed)
    if arguments.json:
        print(json.dumps(result, indent=2))
    else:
        show(result)
    return 0 if all(case["goal_reached"] for case in result["cases"]) else 1


if __name__ == "__main__":
    sys.exit(main())
