"""Plan files: what is written comes back, and whatever is wrong is said at once."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest

from skincal.collect import Mount, Plan, PlannedPress, full_plan, read_plan, write_plan
from skincal.errors import InputError
from skincal.robot import bundled_hand

MOUNT = Mount.of(bundled_hand().meta)


@pytest.mark.parametrize("suffix", [".toml", ".csv"])
def test_a_plan_comes_back_exactly(tmp_path: Path, suffix: str):
    plan = full_plan(np.random.default_rng(2), MOUNT.layout, second_indenter_m=0.004)
    path = tmp_path / f"full{suffix}"
    write_plan(plan, path)
    assert read_plan(path, MOUNT) == plan
    with pytest.raises(InputError, match="--force"):
        write_plan(plan, path)


def test_angles_of_poses_come_back(tmp_path: Path):
    plan = Plan("mine", (PlannedPress(0.0, 0.0, 1.0, 0.01, 1.0),), {"A": (0.1, 0.2, 0.3)})
    write_plan(plan, tmp_path / "mine.toml")
    assert read_plan(tmp_path / "mine.toml", MOUNT) == plan


def test_sites_by_angle_and_in_patch_coordinates_agree(tmp_path: Path):
    u, v, radius = 0.003, -0.002, 0.0115
    path = tmp_path / "plan.csv"
    beta = math.degrees(u / radius)
    path.write_text(f"beta_deg,y_m,force_n\n{beta!r},{0.0235 + v!r},2\n")
    (press,) = read_plan(path, MOUNT).presses
    assert press.site == pytest.approx((u, v), abs=1e-9)


def test_what_is_not_given_has_a_default(tmp_path: Path):
    path = tmp_path / "plan.csv"
    path.write_text("u_m,v_m,force_n,kind\n0.001,0.002,1.5,\n0.001,0.002,2,revisit\n")
    plan = read_plan(path, MOUNT)
    assert plan.name == "plan"
    assert [p.kind for p in plan.presses] == ["regular", "revisit"]
    assert plan.presses[0].pose == "A" and plan.presses[0].hold_s > 0


def test_everything_that_is_wrong_is_said_at_once(tmp_path: Path):
    path = tmp_path / "plan.toml"
    path.write_text(
        """
format = "skincal-plan/1"
[poses]
C = [0.1, 0.2, 0.3]
[[press]]
u_m = 3.0
v_m = 0.0
force_n = -1
[[press]]
u_m = 0.0
v_m = 0.0
forse_n = 2.0
speed_m_per_s = 5
kind = "ancor"
[[press]]
beta_deg = 1.0
u_m = 0.0
y_m = 0.02
force_n = nan
"""
    )
    with pytest.raises(InputError) as caught:
        read_plan(path, MOUNT)
    text = str(caught.value)
    for part in (
        "[press 0] u_m", "[press 0] force_n", "[press 1] forse_n", "[press 1] speed_m_per_s", "[press 1] kind",
        'Did you mean "anchor"', "[press 2] u_m", "[press 2] force_n", "poses.C",
    ):  # fmt: skip
        assert part in text, part


@pytest.mark.parametrize(
    ("name", "content", "message"),
    [
        ("plan.txt", "", ".toml or .csv"),
        ("plan.toml", "not toml", "readable .toml"),
        ("plan.toml", 'format = "skincal-plan/2"\n', "skincal-plan/1"),
        ("plan.toml", 'format = "skincal-plan/1"\npress = 3\n', "[[press]]"),
        ("plan.csv", "u_m,v_m,force_n\n0,0\n", "3 cells"),
        ("plan.csv", "u_m,v_m,force_n,force_n\n0,0,1,1\n", "each column once"),
        ("plan.csv", "u_m,v_m,force_n\n0,0,two\n", '"two"'),
        ("plan.csv", "u_m,v_m,force_n\n", "at least one press"),
        ("plan.csv", "", "the columns force_n, u_m, v_m; got no force_n, u_m, v_m"),
        ("plan.csv", "u_m,v_m,force\n0,0,1\n", 'Did you mean "force_n"'),
        ("plan.csv", "u_m,v_m,force_n,weather\n0,0,1,2\n", "got another one. Remove it"),
        ("plan.csv", "beta,y_m,force_n\n0,0,1\n", 'Did you mean "beta_deg"'),
        ("plan.csv", "u_m;v_m;force_n\n0;0;1\n", "Separate them by commas"),
        ("plan.csv", "x_m,y_m,force_n,taxel_0_0\n0,0,1,2\n", "A plan lists presses to make"),
        ("plan.csv", "u_m,v_m,force_n\n0,0,1500\n", "up to 100; got 1500"),
    ],
)
def test_a_bad_file_is_named(tmp_path: Path, name: str, content: str, message: str):
    (tmp_path / name).write_text(content)
    with pytest.raises(InputError) as caught:
        read_plan(tmp_path / name, MOUNT)
    assert message in str(caught.value) and name in str(caught.value)


@pytest.mark.parametrize(
    "content", ["\ufeffu_m,v_m,force_n\n0,0,1\n", "u_m, v_m,force_n\n0,0,1\n", "u_m,v_m,force_n,\n0,0,1,\n"]
)
def test_what_spreadsheets_write_is_read(tmp_path: Path, content: str):
    (tmp_path / "plan.csv").write_text(content, encoding="utf-8")
    (press,) = read_plan(tmp_path / "plan.csv", MOUNT).presses
    assert (press.u_m, press.v_m, press.force_n) == (0.0, 0.0, 1.0)
