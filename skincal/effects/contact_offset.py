"""The measured contact positions are off in a way that the sensor's pose cannot absorb.

    (across, along) += d_p + M r + c F

d_p is an offset in the hand pose p (the errors of the joint angles differ between poses). M r is a stretch and a skew
of the position r relative to the patch's centre (a wrong fingertip radius, or a rig with a wrong scale). c F is the
compliance of finger or rig under the force. A constant offset and a rotation belong to the sensor's pose.
"""

from __future__ import annotations

import numpy as np

from skincal.effects.effect import InputEffect, by_pose
from skincal.effects.parameter import Scene, Start, Values, each_of, per_pose, start, strength
from skincal.effects.samples import Samples, Setting
from skincal.model.arrays import FloatArray


class ContactOffset(InputEffect):
    name = "contact_offset"
    meaning = "the measured contact positions are off in a way that the pose cannot absorb"
    equation_error = 0.0
    zero_error = 0.0
    parameters = (
        per_pose(
            "pose_across_m", "m", 0.0, -3e-3, 3e-3, "d_p: to be added towards growing beta", typical=0.15e-3
        ),
        per_pose("pose_along_m", "m", 0.0, -3e-3, 3e-3, "d_p: to be added along +y", typical=0.15e-3),
        strength(
            "stretch_across",
            "-",
            0.0,
            -0.5,
            0.5,
            "M: true over measured distance across, less 1",
            typical=0.04,
        ),
        strength(
            "stretch_along",
            "-",
            0.0,
            -0.5,
            0.5,
            "M: true over measured distance along, less 1",
            typical=-0.04,
        ),
        strength(
            "skew", "-", 0.0, -0.5, 0.5, "M: part of the place along that adds across, and across along"
        ),
        strength(
            "across_m_per_n", "m/N", 0.0, -1e-3, 1e-3, "c: movement towards growing beta with the force"
        ),
        strength("along_m_per_n", "m/N", 0.0, -1e-3, 1e-3, "c: movement along +y with the force"),
    )
    of_rig = True
    asks = ("poses",)
    in_places = True
    shows = "places"
    source = (
        "First-order kinematic calibration errors: Hollerbach, Khalil, Gautier, Model Identification, "
        "Springer Handbook of Robotics, 2016, chapter 6."
    )

    def starts(self, scene: Scene) -> tuple[Start, ...]:
        poses = scene.poses if scene.poses > 1 else 0
        ways = ("pose_across_m", "pose_along_m")
        # Steps so small that images go along as they do with a press's own place: what bends would tell against them.
        offsets = [point for way in ways for point in each_of(way, 1e-5, poses)]
        warps = [{"stretch_across": 1.5e-3}, {"stretch_along": 1.5e-3}, {"skew": 1.5e-3}]
        yields = [{"across_m_per_n": 2.5e-6}, {"along_m_per_n": 2.5e-6}]
        return tuple(start(*own, sigma=20.0) for own in (offsets, warps, yields) if own)

    def apply(self, samples: Samples, values: Values, setting: Setting) -> Samples:
        place = (samples.contacts.points_m - setting.centre_m) @ setting.axes.T
        force = np.maximum(samples.contacts.force_n, 0.0)
        moves: list[FloatArray] = []
        for k, way in enumerate(("across", "along")):
            move = values[f"stretch_{way}"] * place[:, k] + values["skew"] * place[:, 1 - k]
            move = move + values[f"{way}_m_per_n"] * force
            if (of_pose := values[f"pose_{way}_m"]).any():
                move = move + by_pose(of_pose, samples.pose, 0.0)
            moves.append(np.where(np.isfinite(move), move, 0.0))
        return setting.moved(samples, *moves)
