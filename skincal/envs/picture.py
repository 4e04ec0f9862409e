"""Pictures of a task: the hand as a software renderer sees it, and beside it what the skin feels."""

from __future__ import annotations

import os
import sys
import time
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from skincal.envs.bullet_scene import BulletScene
from skincal.envs.trajectories import POLICY_HZ
from skincal.model import TaxelLayout
from skincal.model.arrays import FloatArray

Picture = NDArray[np.uint8]

HEIGHT, WIDTH = 360, 480
"""Size of the view of the hand [pixels]; the panel beside it is as high, and square."""
_EYE_M = (0.22, 0.02, 0.04)
"""From where the hand is looked at, from the middle between the tips [m]."""
FULL_COUNTS = 100.0
"""The count that is shown brightest: 1.5 N on a taxel's middle come near it [counts]."""
_SPAN_M = 0.020
"""The panel shows so much of the sensor [m]."""
_BACK = (24, 24, 32)
_LOW, _MIDDLE, _HIGH = np.array([32.0, 36, 64]), np.array([200.0, 60, 90]), np.array([255.0, 240, 150])
_TARGET, _PLACE = (90, 220, 120), (255, 255, 255)


def display_there() -> bool:
    """Return whether a window can be opened, and print if not: PyBullet itself would end the process."""
    there = sys.platform != "linux" or bool(os.environ.get("DISPLAY"))
    if not there:
        print("skincal: there is no display to open a window on (DISPLAY is not set)", file=sys.stderr)
    return there


def colours(share: FloatArray) -> FloatArray:
    """Colour (..., 3) from 0 to 255 for shares (...) of full scale: dark blue, red, light yellow."""
    part = np.clip(share, 0.0, 1.0)[..., None]
    below = _LOW + (_MIDDLE - _LOW) * np.minimum(2 * part, 1.0)
    return np.where(part <= 0.5, below, _MIDDLE + (_HIGH - _MIDDLE) * (2 * part - 1))


@dataclass(frozen=True, eq=False)
class PictureState:
    """Contents of a picture.

    Attributes:
        centre_m: (3,) where the hand is [m].
        image: (J,) counts; None: nothing is felt, the taxels stay dark.
        target_m: (2,) where on the sensor the object shall be: a green cross [m].
        place_m: (2,) where it is: a white ring [m].
    """

    centre_m: FloatArray
    layout: TaxelLayout
    image: FloatArray | None
    target_m: FloatArray
    place_m: FloatArray


def picture(scene: BulletScene, shown: PictureState) -> Picture:
    """Return the hand from the side and beside it the sensor (HEIGHT, WIDTH + HEIGHT, 3)."""
    engine: Any = scene.engine
    eye = shown.centre_m + np.array(_EYE_M)
    looking = engine.computeViewMatrix(eye.tolist(), shown.centre_m.tolist(), [0, 0, 1])
    lens = engine.computeProjectionMatrixFOV(30, WIDTH / HEIGHT, 0.01, 1.0)
    _, _, pixels, _, _ = engine.getCameraImage(
        WIDTH, HEIGHT, looking, lens, lightDirection=[1, -0.5, 1], renderer=engine.ER_TINY_RENDERER
    )
    hand = np.array(pixels, dtype=np.uint8).reshape(HEIGHT, WIDTH, -1)[..., :3]
    return np.concatenate([hand, panel(shown)], axis=1)


def panel(shown: PictureState) -> Picture:
    """Return the sensor from outside (HEIGHT, HEIGHT, 3): u to the right, v upwards."""
    canvas = np.full((HEIGHT, HEIGHT, 3), _BACK, dtype=np.float64)
    layout = shown.layout
    share = np.zeros(layout.taxels) if shown.image is None else shown.image / FULL_COUNTS
    for centre, size, colour in zip(layout.centres_m, layout.sizes_m, colours(share), strict=True):
        (u0, v1), (u1, v0) = _pixel(centre - size / 2), _pixel(centre + size / 2)
        canvas[v0:v1, u0:u1] = colour
    v, u = np.mgrid[:HEIGHT, :HEIGHT]
    (tu, tv), (pu, pv) = _pixel(shown.target_m), _pixel(shown.place_m)
    near = np.maximum(abs(u - tu), abs(v - tv)) <= 9
    canvas[near & (np.minimum(abs(u - tu), abs(v - tv)) <= 1)] = _TARGET
    away = np.hypot(u - pu, v - pv)
    canvas[(away >= 6) & (away <= 8.5)] = _PLACE
    return canvas.astype(np.uint8)


def _pixel(place_m: FloatArray) -> tuple[int, int]:
    # What lies far outside, or nowhere, stays outside.
    u, v = np.clip(np.nan_to_num(place_m), -1.0, 1.0) / _SPAN_M
    return round(HEIGHT * (0.5 + float(u))), round(HEIGHT * (0.5 - float(v)))


class Board:
    """The tactile image as a board of coloured tiles beside the hand, for PyBullet's window."""

    def __init__(self, scene: BulletScene, shown: PictureState) -> None:
        engine = self._engine = scene.engine
        half = [0.001, 0.004, 0.004]
        tile = engine.createVisualShape(engine.GEOM_BOX, halfExtents=half, rgbaColor=[0, 0, 0, 1])
        places = shown.centre_m + [(0.0, 0.07 + 2.5 * u, 0.02 + 2.5 * v) for u, v in shown.layout.centres_m]
        self._tiles: list[int] = [engine.createMultiBody(0, -1, tile, place) for place in places.tolist()]
        engine.resetDebugVisualizerCamera(0.25, 100, -10, shown.centre_m.tolist())
        self._next_s = time.monotonic()

    def show(self, shown: PictureState) -> None:
        """Colour the tiles, and wait to keep pace with real time."""
        image = shown.image
        share = np.zeros(len(self._tiles)) if image is None else image / FULL_COUNTS
        for tile, colour in zip(self._tiles, colours(share) / 255.0, strict=True):
            self._engine.changeVisualShape(tile, -1, rgbaColor=[*colour.tolist(), 1.0])
        self._next_s += 1 / POLICY_HZ
        time.sleep(max(0.0, self._next_s - time.monotonic()))
