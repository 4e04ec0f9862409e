"""A second hand, as different from the bundled one as the description allows, and other helpers."""

from __future__ import annotations

from pathlib import Path

OTHER_URDF = """<?xml version="1.0"?>
<robot name="other">
  <link name="world"/>
  <joint name="mount" type="fixed">
    <parent link="world"/><child link="base"/>
    <origin xyz="0.1 -0.05 0.2" rpy="0.3 -0.2 0.5"/>
  </joint>
  <link name="base"/>
  {fingers}
</robot>
"""

LINK = """<link name="{name}"><inertial><origin xyz="0 0.02 0"/><mass value="0.05"/>
  <inertia ixx="3e-5" iyy="1e-5" izz="3e-5" ixy="0" ixz="0" iyz="0"/></inertial>{extra}</link>"""

JOINT = """<joint name="{name}" type="{kind}"><parent link="{parent}"/><child link="{child}"/>
  <origin xyz="{xyz}" rpy="{rpy}"/><axis xyz="{axis}"/>
  <limit lower="-1.6" upper="1.6" effort="3" velocity="5"/></joint>"""

OTHER_TOML = """format = "skincal-hand/1"

[hand]
name = "other"
urdf = "other.urdf"
max_force_n = 6.0

[joints]
# Interleaved, and not in the order of the URDF.
names = ["b2", "a1", "b0", "a0", "b1", "a2", "a3"]
lower_deg = -90
upper_deg = 90
velocity_deg_per_s = [100, 90, 80, 70, 60, 50, 40]
torque_nm = 2.0
home_deg = [{home}]

[gains]
stiffness_nm_per_rad = 8.0
damping_nms_per_rad = 0.4
low_pass_hz = 30.0

[fingers.long]
carries = "skin"
joints = ["a0", "a1", "a2", "a3"]
tip_link = "pad"

[fingers.short]
carries = "indenter"
joints = ["b0", "b1", "b2"]
tip_link = "ball"

[sensor]
rows = 3
cols = 5
taxel_size_m = [0.002, 0.003]
pitch_m = [0.0025, 0.0035]
baseline = "raw"
value_min = 0
value_max = 4095
integer = true

[surface]
{surface}

[indenter]
kind = "sphere"
radius_m = 0.004

[mount]
y_m = 0.02
alpha_deg = 5.0
y_range_m = [0.018, 0.022]
alpha_range_deg = [-10, 10]
{mount}

[position]
sigma_m = 0.002
slack_m = 0.003
"""

ROUND_PAD = """<collision><origin xyz="0 0.02 0" rpy="1.5707963 0 0"/>
  <geometry><capsule radius="0.008" length="0.04"/></geometry></collision>"""
FLAT_PAD = """<collision><origin xyz="0 0.02 -0.005"/>
  <geometry><box size="0.04 0.06 0.01"/></geometry></collision>"""

ROUND = 'kind = "cylinder"\nradius_m = 0.008', "beta_deg = 2.0\nbeta_range_deg = [-5, 5]"
FLAT = 'kind = "plane"', "x_m = 0.0\nx_range_m = [-0.002, 0.002]"
HOME_DEG = {"a0": 5, "a1": 30, "a2": 30, "a3": 25, "b0": 3, "b1": 8, "b2": 35}


def other_hand(folder: Path, *, plane: bool = False) -> Path:
    """Writes a hand with seven joints (four and three) in another order, other links and another sensor."""
    pad = FLAT_PAD if plane else ROUND_PAD
    ball = '<collision><geometry><sphere radius="0.004"/></geometry></collision>'
    parts = [
        _joint("a0", "base", "l0", "0 0 0", "0 0 0", "0 0 1"),
        _joint("a1", "l0", "l1", "0 0.01 0", "0 0 0", "1 0 0"),
        _joint("a2", "l1", "l2", "0.002 0.045 0", "0 0.1 0", "1 0 0"),
        _joint("a3", "l2", "l3", "0 0.035 0.001", "0 0 0", "1 0 0"),
        _joint("tip", "l3", "pad", "0 0.02 0", "0 0 0", "0 0 1", kind="fixed"),
        _joint("b0", "base", "s0", "0.004 -0.02 0.0", "1.5707963 0 3.1415927", "0 0 1"),
        _joint("b1", "s0", "s1", "0 0 0.005", "0 0 0", "1 0 0"),
        _joint("b2", "s1", "s2", "0 0.062 0", "0 0 0", "2 0 0"),
        _joint("cap", "s2", "ball", "0 0.062 0.01", "0 0 0", "0 0 1", kind="fixed"),
        *(LINK.format(name=name, extra="") for name in ("l0", "l1", "l2", "l3", "s0", "s1", "s2")),
        LINK.format(name="pad", extra=pad),
        LINK.format(name="ball", extra=ball),
    ]
    folder.mkdir(parents=True, exist_ok=True)
    (folder / "other.urdf").write_text(OTHER_URDF.format(fingers="\n".join(parts)))
    surface, mount = FLAT if plane else ROUND
    order = ("b2", "a1", "b0", "a0", "b1", "a2", "a3")
    home = ", ".join(f"{HOME_DEG[name]}" for name in order)
    (folder / "hand.toml").write_text(OTHER_TOML.format(surface=surface, mount=mount, home=home))
    return folder / "hand.toml"


def _joint(name: str, parent: str, child: str, xyz: str, rpy: str, axis: str, kind: str = "revolute") -> str:
    return JOINT.format(name=name, kind=kind, parent=parent, child=child, xyz=xyz, rpy=rpy, axis=axis)
