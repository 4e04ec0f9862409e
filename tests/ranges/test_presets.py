"""The presets against the published tables of IROS 2024 and ICRA 2026: every row, and nothing else."""

import pytest

from skincal.errors import InputError
from skincal.ranges import NAMES, preset


def u(low, high, mode="episode"):
    return ("uniform", low, high, mode)


FINGERS = {
    "finger.joint_offset_rad": u(-0.04, 0.04),
    "finger.joint_noise_rad": ("normal", 0, 0.02, "step"),
    "finger.k_p_nm_per_rad": u(4.8, 5.2),
    "finger.k_d_nms_per_rad": u(0.26, 0.33),
    "finger.parasitic_stiffness_nm_per_rad": u(15, 35),
    "finger.stick_friction_12_nm": u(0.01, 0.03),
}
IROS24 = FINGERS | {
    "finger.stick_friction_3_nm": u(0.07, 0.09),
    "object.marble.position_m": u(-2e-3, 2e-3),
    "object.marble.mass_kg": u(3e-3, 5e-3),
    "object.marble.radius_m": u(4e-3, 8e-3),
    "object.marble.lateral_friction": u(1.1, 1.3),
    "object.marble.spinning_friction": ("log_uniform", 2e-3, 2e-2, "episode"),
    "object.marble.random_force_n": u(-4e-3, 4e-3, "step"),
    "object.bolt.position_m": u(-2e-3, 2e-3),
    "object.bolt.psi_deg": u(-5, 5),
    "object.bolt.theta_deg": u(-5, 5),
    "object.bolt.phi_deg": ("constant", 0, "episode"),
    "object.bolt.mass_kg": u(5e-3, 7e-3),
    "object.bolt.radius_m": ("constant", 6e-3, "episode"),
    "object.bolt.lateral_friction": u(0.8, 1.0),
    "object.bolt.spinning_friction": ("log_uniform", 2e-3, 2e-2, "episode"),
    "object.bolt.random_force_n": u(-4e-3, 4e-3, "step"),
    "skin.y_m": u(21.5e-3, 25.5e-3),
    "skin.beta_deg": u(-12, 12),
    "skin.alpha_deg": u(-15, 15),
    "skin.elasticity_pa_per_m": u(236e6, 848e6),
    "skin.scale_per_n": u(61, 76),
    "skin.taxel_offset_counts": u(-5, 5),
    "skin.noise_sigma_counts": u(0, 5),
    "skin.taxel_noise_counts": ("normal", 0, "skin.noise_sigma_counts", "step"),
}
ICRA26 = FINGERS | {
    "finger.stick_friction_3_nm": u(0.03, 0.05),
    "finger.lateral_friction": u(0.8, 1.5),
    "object.marble.radius_m": ("constant", 3e-3, "episode"),
    "object.marble.lateral_friction": u(0.8, 1.5),
    "object.marble.spinning_friction": u(0, 0.2),
    "object.marble.rolling_friction": u(0, 0.1),
    "object.bolt.lateral_friction": u(0.8, 1.5),
    "object.bolt.spinning_friction": u(0, 0.2),
    "object.bolt.rolling_friction": u(0, 0.1),
    "skin.x_offset_m": u(-0.25e-3, 0.25e-3),
    "skin.y_offset_m": u(-0.25e-3, 0.25e-3),
    "skin.alpha_deg": u(-2.3, 2.3),
    "skin.elasticity_pa_per_m": u(100e6, 500e6),
    "skin.scale_per_n": u(70, 100),
    "skin.scale_offset_per_n": u(-7.5, 7.5),
    "skin.taxel_offset_counts": u(-2.5, 2.5),
    "skin.noise_sigma_counts": u(0, 2.5),
    "skin.taxel_noise_counts": ("normal", 0, "skin.noise_sigma_counts", "step"),
}


@pytest.mark.parametrize(("name", "table"), [("iros24", IROS24), ("icra26", ICRA26)])
def test_a_preset_is_the_published_table(name, table):
    ranges = preset(name)
    assert set(ranges) == set(table)
    for path, (distribution, *figures, mode) in table.items():
        parameter = ranges[path]
        assert (parameter.distribution, parameter.mode, parameter.source) == (distribution, mode, "assumed")
        got = list(parameter.figures().values()) + ([parameter.sigma_from] if parameter.sigma_from else [])
        assert got == pytest.approx(figures) if not parameter.sigma_from else got == figures


def test_every_name_of_the_table_is_explained():
    for path, name in NAMES.items():
        assert name.path == path
        assert name.unit
        assert name.meaning
        assert name.least < name.most


def test_an_unknown_preset_names_the_known_ones():
    with pytest.raises(InputError, match="iros24, icra26"):
        preset("iros2024")
