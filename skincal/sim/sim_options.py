"""Options of the simulated hand, and the ranges from which a hidden truth is drawn."""

from __future__ import annotations

from dataclasses import dataclass

from skincal.errors import check_options, input_error

Range = tuple[float, float]


@dataclass(frozen=True)
class SimOptions:
    """Physics and sensors of the simulated hand; figures that are not measured are assumptions.

    Attributes:
        physics_hz: steps of physics and controller (paper: 1000) [Hz].
        taxel_hz: tactile images [Hz]; a whole number of physics steps apart.
        taxel_scan_s: time between the first and the last taxel of an image [s].
        link_damping_nms_per_rad: damping in the drives' elasticity [N m s/rad].
        contact_depth_force_n: the contact's spring constant is force over depth of the skin at this force [N].
        contact_damping_ns_per_m: damping of the contact [N s/m].
        friction: coefficient of friction between skin and indenter.
        largest_force_n: larger contact forces are solver errors, and rejected [N].
    """

    physics_hz: int = 1000
    taxel_hz: int = 25
    taxel_scan_s: float = 1.5e-3
    link_damping_nms_per_rad: float = 0.01
    contact_depth_force_n: float = 3.0
    contact_damping_ns_per_m: float = 10.0
    friction: float = 0.8
    largest_force_n: float = 1e3

    def __post_init__(self) -> None:
        check_options(self, "a number, 0 or more", lambda value: value >= 0)
        if self.taxel_hz < 1 or self.physics_hz % self.taxel_hz:
            expected = f"a divisor of physics_hz = {self.physics_hz}"
            raise input_error("SimOptions.taxel_hz", expected, self.taxel_hz)


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
