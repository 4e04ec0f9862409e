"""The skin of an episode: the model at the values drawn, with effects, offsets, noise and the converter."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from skincal.dataset.model_objects import converter_of, layout_of
from skincal.effects import EffectSkin, Samples, SkinStream
from skincal.envs.bodies import Body
from skincal.envs.drawing import Values, array, effects_of, number
from skincal.envs.patches import PatchMould
from skincal.envs.pinch import Pinch, require_cylinder
from skincal.model import Contacts, Cylinder, SensorPose, Skin, SkinParameters
from skincal.robot import Kinematics
from skincal.sim.presses import PressTracker
from skincal.sim.touch import TrueContact

FloatArray = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Felt:
    """A contact as the skin feels it, fingertip frame.

    Attributes:
        contacts: one contact.
        shear_u_n: tangential force on the skin towards growing beta [N].
        shear_v_n: tangential force along +y [N].
        gap_m: distance of object and surface at rest, negative inside [m].
        q_rad: (n,) true angles of the links [rad].
    """

    contacts: Contacts
    shear_u_n: float
    shear_v_n: float
    gap_m: float
    q_rad: FloatArray


class TactileSkin:
    """Makes tactile images, one after the other; begin an episode with :meth:`begin`.

    Args:
        pinch: the hand with the sensor.
        kinematics: the same.
        resolution_m: longest edge of a tactile point's cell [m].

    Attributes:
        layout: the taxels.
    """

    def __init__(self, pinch: Pinch, kinematics: Kinematics, resolution_m: float) -> None:
        meta = pinch.description.meta
        self._surface = Cylinder(require_cylinder(pinch))
        self._converter = converter_of(meta.sensor)
        self._kinematics = kinematics
        self.layout = layout_of(meta.sensor, None)
        self._mould = PatchMould(self._surface, self.layout, resolution_m)

    @property
    def taxels(self) -> int:
        """Number of taxels J."""
        return self.layout.taxels

    @property
    def range_counts(self) -> tuple[float, float]:
        """Smallest and largest count; what a converter that does not clip is taken to give."""
        low, high = self._converter.value_min, self._converter.value_max
        return -1e4 if low is None else low, 1e4 if high is None else high

    def begin(self, values: Values, pose: SensorPose, body: Body) -> None:
        """Begins an episode.

        Args:
            values: the episode's draws.
            pose: where the patch is.
            body: what will touch.
        """
        scale = np.maximum(number(values, "skin.scale_per_n") + array(values, "skin.scale_offset_per_n"), 0.0)
        parameters = SkinParameters(number(values, "skin.elasticity_pa_per_m"), scale)
        self._skin = Skin(self._mould.at(pose), parameters, self._converter)
        self._body = body
        self._offset = array(values, "skin.taxel_offset_counts")
        effects = effects_of(values)
        self._stream = None
        if effects:
            some = EffectSkin.of(self._skin, self._surface, effects, missing="abstain")
            self._stream = SkinStream(some)
            self._tracker = PressTracker(self._kinematics)

    def image(self, felt: Felt | None, time_s: float, noise_counts: FloatArray) -> FloatArray:
        """The next tactile image (J,) [counts].

        Args:
            felt: what touches; None: nothing.
            time_s: since the beginning of the episode [s].
            noise_counts: (J,) noise [counts].
        """
        counts = self._values(felt, time_s) + self._offset + noise_counts
        # Adding zero turns the converter's -0 into 0; observations make of NaN a 0.
        return self._converter.apply(counts) + 0.0

    def _values(self, felt: Felt | None, time_s: float) -> FloatArray:
        if self._stream is not None:
            return self._stream.step(self._samples(felt, time_s))[0]
        if felt is None:
            return np.zeros(self.taxels)
        return self._skin.values(self._body.indenter, felt.contacts)[0]

    def _samples(self, felt: Felt | None, time_s: float) -> Samples:
        nothing = Contacts(np.zeros((1, 3)), np.array([[0.0, 0.0, 1.0]]), np.zeros(1))
        contacts = nothing if felt is None else felt.contacts
        n = len(self._kinematics.description.joints)
        known = self._tracker.next(
            TrueContact(
                time_s=time_s,
                point_m=contacts.points_m[0],
                normal=contacts.normals[0],
                force_n=float(contacts.force_n[0]),
                shear_u_n=0.0 if felt is None else felt.shear_u_n,
                shear_v_n=0.0 if felt is None else felt.shear_v_n,
                gap_m=1.0 if felt is None else felt.gap_m,
                q_rad=np.zeros(n) if felt is None else felt.q_rad,
            )
        )
        return Samples.of(
            contacts,
            self._body.indenter,
            touching=[felt is not None],
            press=[known.press],
            time_s=[time_s],
            phase=[known.phase],
            speed_m_per_s=[known.speed_m_per_s],
            cycle=[known.cycle],
            pose=[known.pose],
            temperature_c=[np.nan],
            shear_u_n=[0.0 if felt is None else felt.shear_u_n],
            shear_v_n=[0.0 if felt is None else felt.shear_v_n],
        )
