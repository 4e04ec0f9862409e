"""The true parameters of a simulated session, which are hidden from the fit."""

from __future__ import annotations

import math
import zlib
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field, replace
from typing import Any

import numpy as np

from skincal.calibration import Calibration, effects_of, sensor_differences
from skincal.dataset.dataset import layout_of
from skincal.effects import effect
from skincal.errors import InputError, Problem
from skincal.model import ContactLaw, SensorPose
from skincal.model.arrays import FloatArray
from skincal.robot import HandDescription

Range = tuple[float, float]


@dataclass(frozen=True)
class TruthOptions:
    """Ranges from which a session's truth is drawn: uniform for a pair, else normal with this sigma.

    The joints are those of a calibrated hand: together their errors move the contact by 0.3 mm to 1.5 mm. Sources:
    (1) Kasolowsky & Baeuml, IROS 2024: result of the calibration and table II; the rest is assumed.

    Attributes:
        mount_share: part of the ranges of ``[mount]``, about their middle, that contains the pose.
        elasticity_pa_per_m: E, uniform in its logarithm [Pa/m] (1).
        scale_per_n: S [1/N] (1).
        noise_counts: noise of a taxel value [counts].
        rest_counts: level at rest [counts].
        joint_offset_rad: constant error of a joint angle [rad].
        joint_wave_rad: amplitude of an error that is periodic in the angle [rad].
        joint_wave_length_rad: period of that error [rad].
        joint_noise_rad: noise of a joint angle [rad].
        joint_speed_noise_rad_per_s: noise of a joint velocity [rad/s].
        torque_offset_nm: constant error of a joint torque [N m].
        torque_scale: relative error of a joint torque.
        torque_noise_nm: noise of a joint torque [N m].
        drive_stiffness_nm_per_rad: parasitic stiffness K_e [N m/rad] (1).
        stick_friction_nm: stick friction of all joints of a finger except the last [N m] (1).
        last_stick_friction_nm: stick friction of the last joint [N m] (1).
    """

    mount_share: float = 0.5
    elasticity_pa_per_m: Range = (3.0e8, 7.0e8)
    scale_per_n: Range = (61.0, 76.0)
    noise_counts: float = 1.0
    rest_counts: float = 0.0
    joint_offset_rad: float = 3.0e-3
    joint_wave_rad: float = 1.5e-3
    joint_wave_length_rad: float = 0.25
    joint_noise_rad: float = 1.0e-3
    joint_speed_noise_rad_per_s: float = 0.01
    torque_offset_nm: float = 2.0e-3
    torque_scale: float = 0.01
    torque_noise_nm: float = 3.0e-3
    drive_stiffness_nm_per_rad: Range = (15.0, 35.0)
    stick_friction_nm: Range = (0.01, 0.03)
    last_stick_friction_nm: Range = (0.07, 0.09)


@dataclass(frozen=True, eq=False)
class JointTruth:
    """Errors of the joint sensors, and true parameters of the drives; each (n,).

    Attributes:
        offset_rad: constant error of the angles [rad].
        wave_rad: amplitude of an error sin(2 pi q / length + phase) of the angles [rad].
        wave_length_rad: period of that error [rad].
        wave_phase_rad: phase of that error [rad].
        noise_rad: noise of the angles [rad].
        speed_noise_rad_per_s: noise of the velocities [rad/s].
        torque_offset_nm: constant error of the torques [N m].
        torque_scale: measured over true torque.
        torque_noise_nm: noise of the torques [N m].
        drive_stiffness_nm_per_rad: parasitic stiffness K_e [N m/rad].
        friction_nm: stick friction [N m].
    """

    offset_rad: FloatArray
    wave_rad: FloatArray
    wave_length_rad: float
    wave_phase_rad: FloatArray
    noise_rad: float
    speed_noise_rad_per_s: float
    torque_offset_nm: FloatArray
    torque_scale: FloatArray
    torque_noise_nm: float
    drive_stiffness_nm_per_rad: FloatArray
    friction_nm: FloatArray

    def angle_error_rad(self, q_rad: FloatArray) -> FloatArray:
        """Return measured minus true angles (..., n) at true angles (..., n) [rad]."""
        turn = 2 * math.pi / self.wave_length_rad
        return self.offset_rad + self.wave_rad * np.sin(turn * q_rad + self.wave_phase_rad)

    def as_dict(self) -> dict[str, Any]:
        """Return plain numbers and lists, for a JSON file."""
        return {k: v.tolist() if isinstance(v, np.ndarray) else v for k, v in vars(self).items()}


@dataclass(frozen=True, eq=False)
class Truth:
    """True parameters of the skin and the joints.

    Attributes:
        pose: pose of the sensor.
        elasticity_pa_per_m: E [Pa/m].
        scale_per_n: S [1/N]: one number, or one for each taxel (J,).
        noise_counts: noise of a taxel value [counts].
        rest_counts: level at rest [counts].
        joints: errors of the joints.
        strengths: strength of each effect that was drawn, by name; 1 is a typical case.
        effects: parameters of all effects beyond the base model, by name.
        contact_law: how the contact differs from the elastic foundation; None: not at all.
    """

    pose: SensorPose
    elasticity_pa_per_m: float
    scale_per_n: float | FloatArray
    noise_counts: float
    rest_counts: float
    joints: JointTruth
    strengths: Mapping[str, float] = field(default_factory=dict[str, float])
    effects: Mapping[str, Mapping[str, FloatArray]] = field(
        default_factory=dict[str, Mapping[str, FloatArray]]
    )
    contact_law: ContactLaw | None = None

    @classmethod
    def draw(
        cls,
        rng: np.random.Generator,
        description: HandDescription,
        options: TruthOptions | None = None,
        effects: Mapping[str, float] | None = None,
    ) -> Truth:
        """Draw a truth.

        Raises:
            InputError: an unknown effect, or an invalid strength.
        """
        options = options or TruthOptions()
        pose = _pose(rng, description, options.mount_share)
        low, high = (math.log(e) for e in options.elasticity_pa_per_m)
        strengths = dict(effects or {})
        truth = cls(
            pose=pose,
            elasticity_pa_per_m=math.exp(rng.uniform(low, high)),
            scale_per_n=float(rng.uniform(*options.scale_per_n)),
            noise_counts=options.noise_counts,
            rest_counts=options.rest_counts,
            joints=_joints(rng, description, options),
        )
        return replace(truth, strengths=strengths, effects=_effects(rng, description, strengths))

    def with_skin(self, calibration: Calibration, description: HandDescription) -> Truth:
        """Return the same joints and noise with the skin of a calibration; its effects join those that were drawn.

        Raises:
            InputError: the calibration has another sensor, or an effect that was drawn as well.
        """
        meta, place = description.meta, f"hand {description.name}"
        layout = layout_of(meta.sensor, None)
        problems = sensor_differences(calibration, meta.sensor, layout, meta.surface, {}, place=place)
        own = effects_of(calibration)
        problems += [
            Problem(f"effect {name}", "either drawn or the calibration's", "both", "Remove one of them.")
            for name in own
            if name in self.effects
        ]
        if problems:
            raise InputError(problems)
        parameters = calibration.parameters()
        return replace(
            self,
            pose=calibration.pose(),
            elasticity_pa_per_m=parameters.elasticity_pa_per_m,
            scale_per_n=parameters.scale_per_n,
            effects={**self.effects, **own},
            contact_law=None if calibration.contact_law is None else calibration.contact_law.law,
        )

    def effects_list(self) -> list[dict[str, Any]]:
        """Return the effects as plain numbers, lists and texts."""
        return [
            {
                "name": name,
                "strength": self.strengths.get(name),
                "parameters": {key: value.tolist() for key, value in parameters.items()},
            }
            for name, parameters in self.effects.items()
        ]

    def skin_dict(self) -> dict[str, Any]:
        """Return further true values of the skin, as plain numbers and lists."""
        scale = np.asarray(self.scale_per_n)
        each = {"scale_per_taxel_per_n": scale.tolist()} if scale.ndim else {}
        law = {} if self.contact_law is None else {"contact_law": asdict(self.contact_law)}
        return {"noise_counts": self.noise_counts, "rest_counts": self.rest_counts, **each, **law}

    def model_dict(self, *, plane: bool) -> dict[str, float]:
        """Return the fitted parameters by the names of ``calibration.toml``; the mean of individual scales."""
        place = {"x_m": self.pose.x_m} if plane else {"beta_deg": math.degrees(self.pose.beta_rad)}
        return {
            "y_m": self.pose.y_m,
            **place,
            "alpha_deg": math.degrees(self.pose.alpha_rad),
            "elasticity_pa_per_m": self.elasticity_pa_per_m,
            "scale_per_n": float(np.mean(self.scale_per_n)),
        }


def _effects(
    rng: np.random.Generator, description: HandDescription, strengths: Mapping[str, float]
) -> dict[str, Mapping[str, FloatArray]]:
    """Return the parameters of effects; each effect is drawn independently of the others."""
    root = int(rng.integers(2**63))
    layout = layout_of(description.meta.sensor, None)
    return {
        name: effect(name).at_strength(
            strength, np.random.default_rng([root, zlib.crc32(name.encode())]), layout
        )
        for name, strength in strengths.items()
    }


def _pose(rng: np.random.Generator, description: HandDescription, share: float) -> SensorPose:
    mount = description.meta.mount
    y = _within(rng, mount.y_range_m, share)
    alpha = math.radians(_within(rng, mount.alpha_range_deg, share))
    if mount.beta_range_deg is None:
        assert mount.x_range_m is not None
        return SensorPose(y_m=y, alpha_rad=alpha, x_m=_within(rng, mount.x_range_m, share))
    beta = math.radians(_within(rng, mount.beta_range_deg, share))
    return SensorPose(y_m=y, alpha_rad=alpha, beta_rad=beta)


def _within(rng: np.random.Generator, bounds: Range, share: float) -> float:
    middle, half = (bounds[0] + bounds[1]) / 2, (bounds[1] - bounds[0]) / 2
    return float(rng.uniform(middle - share * half, middle + share * half))


def _joints(rng: np.random.Generator, description: HandDescription, options: TruthOptions) -> JointTruth:
    count = len(description.joints)
    friction = rng.uniform(*options.stick_friction_nm, count)
    last = rng.uniform(*options.last_stick_friction_nm, count)
    for finger in (description.skin_finger, description.indenter_finger):
        at = description.joints.index(finger.joints[-1])
        friction[at] = last[at]
    return JointTruth(
        offset_rad=rng.normal(0.0, options.joint_offset_rad, count),
        wave_rad=rng.normal(0.0, options.joint_wave_rad, count),
        wave_length_rad=options.joint_wave_length_rad,
        wave_phase_rad=rng.uniform(0.0, 2 * math.pi, count),
        noise_rad=options.joint_noise_rad,
        speed_noise_rad_per_s=options.joint_speed_noise_rad_per_s,
        torque_offset_nm=rng.normal(0.0, options.torque_offset_nm, count),
        torque_scale=1.0 + rng.normal(0.0, options.torque_scale, count),
        torque_noise_nm=options.torque_noise_nm,
        drive_stiffness_nm_per_rad=rng.uniform(*options.drive_stiffness_nm_per_rad, count),
        friction_nm=friction,
    )
