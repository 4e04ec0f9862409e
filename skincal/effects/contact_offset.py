"""The measured contact positions are off in a way that the sensor's pose cannot absorb.

    (across, along) += d_p + M r + c F

d_p is an offset in the hand pose p (the errors of the joint angles differ between poses). M r is a stretch and a skew
of the position r relative to the patch's centre (a wrong fingertip radius, or a rig with a wrong scale). c F is the
compliance of finger or rig under the force. A constant offset and a rotation belong to the sensor's pose.
"""

from __future__ import annotations

import numpy as np

from skincal.effects.effect import InputEffect, by_pose
from skincal.effects.parameter import EffectParameter, Values
from skincal.effects.samples import Samples
from skincal.effects.setting import Setting
from skincal.effects.starts import Scene, Start, each_of, start
from skincal.model.arrays import FloatArray


def _of_pose(name: str, direction: str) -> EffectParameter:
    text = f"to be added to the measured place {direction}, in each hand pose"
    return EffectParameter(
        name, "m", 0.0, -3e-3, 3e-3, text, typical=0.15e-3, shape="per-pose", needs=("pose",)
    )


def _number(name: str, unit: str, bound: float, text: str, typical: float = 0.0) -> EffectParameter:
    return EffectParameter(name, unit, 0.0, -bound, bound, text, typical=typical)


class ContactOffset(InputEffect):
    """The effect ``contact_offset``, with the equation of the module."""

    name = "contact_offset"
    meaning = "the measured contact positions are off in a way that the pose cannot absorb"
    equation_error = 0.0
    zero_error = 0.0
    parameters = (
        _of_pose("pose_across_m", "towards growing beta"),
        _of_pose("pose_along_m", "along +y"),
        _number("stretch_across", "-", 0.5, "true place across is so much farther from the centre", 0.04),
        _number("stretch_along", "-", 0.5, "true place along is so much farther from the centre", -0.04),
        _number("skew", "-", 0.5, "so much of the place along is added across, and of that across along"),
        _number("across_m_per_n", "m/N", 1e-3, "movement towards growing beta with the force"),
        _number("along_m_per_n", "m/N", 1e-3, "movement along +y with the force"),
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
        """See :meth:`Effect.starts`."""
        poses = scene.poses if scene.poses > 1 else 0
        ways = ("pose_across_m", "pose_along_m")
        offsets = [point for way in ways for point in each_of(way, 2e-4, poses)]
        warps = [{"stretch_across": 0.03}, {"stretch_along": 0.03}, {"skew": 0.03}]
        yields = [{"across_m_per_n": 5e-5}, {"along_m_per_n": 5e-5}]
        return tuple(start(*own) for own in (offsets, warps, yields) if own)

    def apply(self, samples: Samples, values: Values, setting: Setting) -> Samples:
        """See :meth:`InputEffect.apply`."""
        return setting.moved(samples, *self.moves_m(samples, values, setting).T)

    def moves_m(self, samples: Samples, values: Values, setting: Setting) -> FloatArray:
        """Return how far the contacts of K samples move over the surface, across and along [m], (K, 2)."""
        place = (samples.contacts.points_m - setting.centre_m) @ setting.axes.T
        across, along = place[:, 0], place[:, 1]
        force, skew = np.maximum(samples.contacts.force_n, 0.0), values["skew"]
        move_across = values["stretch_across"] * across + skew * along + values["across_m_per_n"] * force
        move_along = values["stretch_along"] * along + skew * across + values["along_m_per_n"] * force
        return np.stack(
            [
                _finite(move_across + self._of_pose("pose_across_m", samples, values)),
                _finite(move_along + self._of_pose("pose_along_m", samples, values)),
            ],
            axis=-1,
        )

    @staticmethod
    def _of_pose(name: str, samples: Samples, values: Values) -> FloatArray | float:
        return by_pose(values[name], samples.pose, 0.0) if values[name].any() else 0.0


def _finite(move: FloatArray) -> FloatArray:
    return np.where(np.isfinite(move), move, 0.0)
