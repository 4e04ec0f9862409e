"""The randomization of two published works, complete, and how much narrower a calibration makes it.

``iros24`` is Kasolowsky & Bäuml, IROS 2024 (arXiv 2409.12735, table "Domain Randomization", and the authors'
published list), ``icra26`` the same authors' list for ICRA 2026. A preset leaves out what its work does not state;
nothing is carried over from one to the other:

- ``icra26`` states no initial position, angles, mass or random force of an object, and no beta; its sensor
  position is an offset from the nominal place (``x_offset_m``, ``y_offset_m``).
- ``iros24`` states no rolling friction, and no spread of the scale between taxels.
- The pellets of ``icra26`` are small spheres: they stand under ``object.marble``. Its friction holds for all
  objects, and the sliding one for the fingers too.

Both centre the taxel noise on the taxel's offset. Here noise has mean 0 and the offset is a parameter of its
own, so that it is applied once. The joint offsets are drawn independently (in the published runs of 2024 they
were not).
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Final

from skincal.errors import input_error
from skincal.ranges.parameter import Parameter
from skincal.ranges.ranges import Ranges
from skincal.tasks import PresetName

_U = Parameter.uniform
_N = Parameter.normal
_C = Parameter.constant

_FINGERS: Final = {
    "finger.joint_offset_rad": _U(-0.04, 0.04),
    "finger.joint_noise_rad": _N(0.0, 0.02),
    "finger.k_p_nm_per_rad": _U(4.8, 5.2),
    "finger.k_d_nms_per_rad": _U(0.26, 0.33),
    "finger.parasitic_stiffness_nm_per_rad": _U(15.0, 35.0),
    "finger.stick_friction_12_nm": _U(0.01, 0.03),
}

_IROS24: Final = {
    **_FINGERS,
    "finger.stick_friction_3_nm": _U(0.07, 0.09),
    "object.marble.position_m": _U(-0.002, 0.002),
    "object.marble.mass_kg": _U(0.003, 0.005),
    "object.marble.radius_m": _U(0.004, 0.008),
    "object.marble.lateral_friction": _U(1.1, 1.3),
    "object.marble.spinning_friction": Parameter.log_uniform(2e-3, 2e-2),
    "object.marble.random_force_n": _U(-4e-3, 4e-3, mode="step"),
    "object.bolt.position_m": _U(-0.002, 0.002),
    "object.bolt.psi_deg": _U(-5.0, 5.0),
    "object.bolt.theta_deg": _U(-5.0, 5.0),
    "object.bolt.phi_deg": _C(0.0),
    "object.bolt.mass_kg": _U(0.005, 0.007),
    "object.bolt.radius_m": _C(0.006),
    "object.bolt.lateral_friction": _U(0.8, 1.0),
    "object.bolt.spinning_friction": Parameter.log_uniform(2e-3, 2e-2),
    "object.bolt.random_force_n": _U(-4e-3, 4e-3, mode="step"),
    "skin.y_m": _U(0.0215, 0.0255),
    "skin.beta_deg": _U(-12.0, 12.0),
    "skin.alpha_deg": _U(-15.0, 15.0),
    "skin.elasticity_pa_per_m": _U(236e6, 848e6),
    "skin.scale_per_n": _U(61.0, 76.0),
    "skin.taxel_offset_counts": _U(-5.0, 5.0),
    "skin.noise_sigma_counts": _U(0.0, 5.0),
    "skin.taxel_noise_counts": _N(0.0, "skin.noise_sigma_counts"),
}

_ICRA26: Final = {
    **_FINGERS,
    "finger.stick_friction_3_nm": _U(0.03, 0.05),
    "finger.lateral_friction": _U(0.8, 1.5),
    "object.marble.radius_m": _C(0.003),
    "object.marble.lateral_friction": _U(0.8, 1.5),
    "object.marble.spinning_friction": _U(0.0, 0.2),
    "object.marble.rolling_friction": _U(0.0, 0.1),
    "object.bolt.lateral_friction": _U(0.8, 1.5),
    "object.bolt.spinning_friction": _U(0.0, 0.2),
    "object.bolt.rolling_friction": _U(0.0, 0.1),
    "skin.x_offset_m": _U(-0.00025, 0.00025),
    "skin.y_offset_m": _U(-0.00025, 0.00025),
    "skin.alpha_deg": _U(-2.3, 2.3),
    "skin.elasticity_pa_per_m": _U(100e6, 500e6),
    "skin.scale_per_n": _U(70.0, 100.0),
    "skin.scale_offset_per_n": _U(-7.5, 7.5),
    "skin.taxel_offset_counts": _U(-2.5, 2.5),
    "skin.noise_sigma_counts": _U(0.0, 2.5),
    "skin.taxel_noise_counts": _N(0.0, "skin.noise_sigma_counts"),
}

PRESETS: Final[dict[str, dict[str, Parameter]]] = {"iros24": _IROS24, "icra26": _ICRA26}


def preset(name: PresetName | str = "iros24") -> Ranges:
    """Return the ranges of a published work, ``iros24`` or ``icra26``, all marked ``assumed``.

    Raises:
        InputError: there is no preset of this name.
    """
    if name not in PRESETS:
        raise input_error("preset", f"one of {', '.join(PRESETS)}", repr(name))
    return Ranges(PRESETS[name], provenance={"preset": name})


@dataclass(frozen=True)
class Narrowing:
    """A calibrated parameter and the preset's range of it.

    Attributes:
        path: full name.
        parameter: the calibrated range.
        published: the preset's range; None where the preset does not randomize it.
        ratio: calibrated width over the preset's; above 1 the calibration is wider; nan without a preset's width.
    """

    path: str
    parameter: Parameter
    published: Parameter | None
    ratio: float


_SCALE = "skin.scale_per_n"
"""It belongs to a converter: volts or 12 bits per newton do not compare with counts of 8 bits per newton."""

_POSE = ("skin.x_m", "skin.y_m", "skin.alpha_deg")
"""Parameters that place a flat pad on its bench; a preset's place a fingertip's patch on its finger."""


def narrowing(ranges: Ranges, published: Ranges, *, same_converter: bool = True) -> tuple[Narrowing, ...]:
    """Return every calibrated parameter with the preset's range of it, in the order of the names."""
    rows: list[Narrowing] = []
    flat = "skin.x_m" in ranges
    for path in ranges.calibrated():
        # A preset that knows only an offset of the centre states the width of its range by that offset.
        other = published.get(path, published.get(path.replace("_m", "_offset_m")))
        if (flat and path in _POSE) or (not same_converter and path == _SCALE):
            other = None
        width = other.width() if other is not None else math.nan
        ratio = ranges[path].width() / width if width > 0.0 else math.nan
        rows.append(Narrowing(path, ranges[path], other, ratio))
    return tuple(rows)
