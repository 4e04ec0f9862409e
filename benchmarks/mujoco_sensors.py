"""The same presses in MuJoCo's touch grid and tactile sensor: time of an image, and what the image is worth.

    python -m benchmarks.mujoco_sensors [--presses 32] [--out FILE]

A ball of 6 mm radius is pressed on a cylinder of 11.5 mm with 1 to 4 N, over 4 x 4 taxels, and slid slowly across them.
MuJoCo's ball moves along the contact normal under that force until it rests; then its sensors are read. The touch grid
has 4 x 4 bins of angle about the finger's middle; the tactile sensor is asked how deep the ball is at the tactile
points of the taxels, which are added up. Time is the processor time of ``mj_forward`` at rest with the sensor, less
that without it, so that contacts count for neither. Needs the package mujoco.
"""

# ruff: noqa: E402 - the number of threads is read when numpy is imported
from __future__ import annotations

import os

for _threads in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "VECLIB_MAXIMUM_THREADS"):
    os.environ[_threads] = "1"

import argparse
import importlib
import json
import sys
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.model_speed import BALL_RADIUS_M, ELASTICITY_PA_PER_M, finger_patch, seconds
from skincal.model import (
    Contacts,
    Converter,
    Cylinder,
    Patch,
    SensorPose,
    Skin,
    SkinParameters,
    Sphere,
    contact_rotations,
)

SLIDE_M, SLIDE_STEPS, SLIDE_N = 6e-3, 121, 2.0
REST_STEPS, ROUNDS = 600, 200
ANSWERS = 0.01
"""A taxel answers if it has this part of the largest value."""
POSE = SensorPose(0.0235, 0.0)
GRID = """
<plugin plugin="mujoco.sensor.touch_grid" objtype="site" objname="middle">
  <config key="size" value="4 4"/><config key="fov" value="40 35"/>
  <config key="gamma" value="0"/><config key="nchannel" value="1"/>
</plugin>"""
TACTILE = '<tactile geom="finger" mesh="taxels"/>'


def scene(mujoco: Any, sensor: str, points: np.ndarray) -> Any:
    """The finger, the ball on a slide along its own z, and a sensor of MuJoCo."""
    # A mesh is closed by its convex hull; the sensor asks its vertices alone, in the frame of the finger's geom.
    vertices = " ".join(f"{v:.9g}" for v in points.ravel())
    text = f"""<mujoco>
<extension><plugin plugin="mujoco.sensor.touch_grid"/></extension>
<option timestep="0.0005" gravity="0 0 0"/>
<asset><mesh name="taxels" vertex="{vertices}" inertia="convex"/></asset>
<worldbody>
  <geom name="finger" type="cylinder" size="0.0115 0.03" pos="0 0.0235 0" quat="0.70710678 0.70710678 0 0"
        solref="-20000 -200"/>
  <site name="middle" pos="0 0.0235 0" quat="0 1 0 0"/>
  <body name="carrier"><body name="ball" pos="0 0 {BALL_RADIUS_M}">
    <joint name="normal" type="slide" axis="0 0 1" damping="2"/>
    <geom name="ball" type="sphere" size="{BALL_RADIUS_M}" mass="0.05" solref="-20000 -200"/>
  </body></body>
</worldbody>
<sensor>{sensor}</sensor></mujoco>"""
    model = mujoco.MjModel.from_xml_string(text)
    # The compiler has moved the mesh into its own frame of inertia.
    model.mesh_vert[:] = points
    return model


class Felt:
    """What MuJoCo's sensor says of presses, and what asking it costs.

    Args:
        mujoco: the package.
        sensor: its element of the model.
        points: (N, 3) of the sensor's mesh, in the frame of the finger's geom [m].
        taxels: (J, D) how much of each value of the sensor belongs to each taxel.
    """

    def __init__(self, mujoco: Any, sensor: str, points: np.ndarray, taxels: np.ndarray) -> None:
        self.mujoco, self.taxels = mujoco, taxels
        self.model, self.bare = scene(mujoco, sensor, points), scene(mujoco, "", points)
        self.data, self.bare_data = mujoco.MjData(self.model), mujoco.MjData(self.bare)

    def press(self, contacts: Contacts, k: int) -> np.ndarray:
        """Values (J,) of the first channel of one press at rest."""
        turn = np.zeros(4)
        self.mujoco.mju_mat2Quat(turn, contact_rotations(contacts.normals[k : k + 1]).ravel())
        for model, data in ((self.model, self.data), (self.bare, self.bare_data)):
            self.mujoco.mj_resetData(model, data)
            model.body("carrier").pos, model.body("carrier").quat = contacts.points_m[k], turn
            data.qfrc_applied[0] = -contacts.force_n[k]
            for _ in range(REST_STEPS):
                self.mujoco.mj_step(model, data)
            self.mujoco.mj_forward(model, data)
        return self.taxels @ np.abs(self.data.sensordata[: self.taxels.shape[1]])

    def seconds(self) -> float:
        """Processor time that the sensor adds where the ball rests now [s]."""
        forward = self.mujoco.mj_forward
        took = [
            seconds(lambda m=model, d=data: [forward(m, d) for _ in range(ROUNDS)]) / ROUNDS
            for model, data in ((self.model, self.data), (self.bare, self.bare_data))
        ]
        return took[0] - took[1]


def worth(
    press: Callable[[Contacts], np.ndarray], places: np.ndarray, some: Contacts, slide: Contacts
) -> dict[str, Any]:
    """What images (K, J) of presses are worth; ``places`` (J, 3) of the taxels [m]."""
    images, moved = press(some), press(slide)
    whole = images.sum(axis=1)
    seen = whole > 0
    middle = images[seen] @ places / whole[seen, None]
    over_force = whole / some.force_n
    return {
        "presses without an image": int((~seen).sum()),
        "sum over force, spread of its mean": round(
            float(over_force.std() / max(over_force.mean(), 1e-30)), 3
        ),
        "centroid, RMS error [mm]": round(
            float(1e3 * np.sqrt(np.mean(np.sum((middle - some.points_m[seen]) ** 2, axis=1)))), 2
        ),
        "taxels that answer": round(float((images > ANSWERS * images.max()).sum(axis=1).mean()), 1),
        "largest step of a taxel in a slide of 0.05 mm a step, part of the largest value": round(
            float(np.abs(np.diff(moved, axis=0)).max() / max(moved.max(), 1e-30)), 3
        ),
    }


def presses(finger: Cylinder, count: int) -> tuple[Contacts, Contacts]:
    """Presses over the taxels, and a slide across them."""
    rng = np.random.default_rng(1)
    across, along = rng.uniform(-5e-3, 5e-3, (2, count))
    start = np.array([[0.0, POSE.y_m, finger.radius_m]])
    some = finger.offset(np.repeat(start, count, axis=0), across, along)
    steps = np.linspace(-SLIDE_M / 2, SLIDE_M / 2, SLIDE_STEPS)
    line = finger.offset(np.repeat(start, len(steps), axis=0), steps, 0.3 * steps)
    return (
        Contacts(some, finger.normal_at(some), rng.uniform(1.0, 4.0, count)),
        Contacts(line, finger.normal_at(line), np.full(len(steps), SLIDE_N)),
    )


def measure(mujoco: Any, count: int) -> dict[str, Any]:
    finger, patch = finger_patch()
    layout = patch.layout
    skin = Skin(Patch.build(finger, layout, POSE), SkinParameters(ELASTICITY_PA_PER_M, 1.0), Converter.none())
    places, _ = finger.wrap(POSE, layout.centres_m)
    some, slide = presses(finger, count)
    ball = Sphere(BALL_RADIUS_M)
    skin.prepare(ball)
    rows = {
        "skincal": {
            "us an image": round(
                1e6 * seconds(lambda: [skin.loads(ball, some[k : k + 1]) for k in range(count)]) / count, 1
            ),
            **worth(lambda contacts: skin.loads(ball, contacts), places, some, slide),
        }
    }
    patch, inside = skin.patch, np.flatnonzero(skin.patch.taxel >= 0)
    # The geom's z is the finger's axis.
    points = (patch.points_m[inside] - [0.0, POSE.y_m, 0.0]) @ [
        [1.0, 0.0, 0.0],
        [0.0, 0.0, -1.0],
        [0.0, 1.0, 0.0],
    ]
    areas = np.zeros((layout.taxels, len(inside)))
    areas[patch.taxel[inside], np.arange(len(inside))] = patch.areas_m2[inside]
    # The grid's rows run the other way.
    rows_turned = np.eye(layout.taxels).reshape(layout.rows, layout.cols, -1)[::-1].reshape(layout.taxels, -1)
    for name, sensor, taxels in (("touch grid", GRID, rows_turned), ("tactile sensor", TACTILE, areas)):
        felt = Felt(mujoco, sensor, points, taxels)
        times: list[float] = []

        def pressed(contacts: Contacts, felt: Felt = felt, times: list[float] = times) -> np.ndarray:
            images = []
            for k in range(len(contacts)):
                images.append(felt.press(contacts, k))
                times.append(felt.seconds() if len(times) < 8 else times[-1])
            return np.array(images)

        found = worth(pressed, places, some, slide)
        rows[f"MuJoCo's {name}"] = {"us an image": round(1e6 * float(np.median(times[:8])), 1), **found}
    return {"mujoco": mujoco.__version__, "presses": count, "sensors": rows}


def main(arguments: Sequence[str] | None = None) -> int:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--presses", type=int, default=32)
    parser.add_argument("--out", type=Path, help="file for the figures (JSON)")
    given = parser.parse_args(arguments)
    try:
        mujoco = importlib.import_module("mujoco")
    except ImportError:
        print(
            "MuJoCo: expected the package mujoco; got none. Install it with: pip install mujoco",
            file=sys.stderr,
        )
        return 2
    text = json.dumps(measure(mujoco, given.presses), indent=1)
    print(text)
    if given.out is not None:
        given.out.write_text(text + "\n", encoding="utf-8")
    return 0


if __name__ == "__main__":
    sys.exit(main())
