"""Presses on the simulated hand, whose joints err and stick: what is reached, against what truly touches."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import pytest
from hands import other_hand

from skincal.collect import Collected, Mount, Need, Plan, PlannedPress, Progress, collect, full_plan
from skincal.collect.plan import CollectOptions
from skincal.collect.poses import find_poses, reach_of
from skincal.collect.posture import Fingers
from skincal.dataset import check_dataset
from skincal.hand.sim import SimDriver
from skincal.robot import Kinematics, bundled_hand, contact_from_joints

PRESSES = tuple(
    PlannedPress(u, v, force, speed, 0.5, pose)
    for u, v, force, speed, pose in (
        (0.0, 0.0, 3.0, 0.04, "A"),
        (0.005, -0.005, 0.5, 0.012, "A"),
        (-0.004, 0.006, 6.0, 0.04, "A"),
        (0.002, 0.003, 0.5, 0.04, "B"),
        (0.007, 0.007, 4.0, 0.012, "B"),
        (0.0, 0.0, 3.0, 0.04, "A"),
    )
)
POSES = {"A": (0.013, 0.183, 1.067), "B": (0.124, 0.938, 0.399)}
"""As the search for poses finds them, which takes half as long as the presses."""


@dataclass(frozen=True)
class Run:
    """A session, and what truly touched in each period: time, force, shear, height, point."""

    collected: Collected
    truth: np.ndarray

    def held(self, press: int) -> np.ndarray:
        """The truth in the steady part of a press's hold."""
        columns = self.collected.dataset.presses.columns
        begin, end = columns["t_hold_s"][press] + 0.15, columns["t_release_s"][press]
        return self.truth[(self.truth[:, 0] >= begin) & (self.truth[:, 0] <= end)]


def run(plan: Plan, folder: Path, seed: int = 3, hand: str = "dlr_hand_2") -> Run:
    drivers: list[SimDriver] = []
    seen: list[tuple[float, ...]] = []

    def make(need: Need) -> SimDriver:
        start_s = need.session_s + 1.0 if need.session_s > 0 else 0.0
        drivers.append(
            SimDriver(seed=seed, hand=hand, start_s=start_s, indenter_radius_m=need.indenter_radius_m)
        )
        return drivers[-1]

    def watch(progress: Progress) -> None:
        contact = drivers[-1].simulated.contact()
        shear = float(np.hypot(contact.shear_u_n, contact.shear_v_n))
        seen.append((progress.sample.time_s, contact.force_n, shear, contact.gap_m, *contact.point_m))

    description = SimDriver(seed=seed, hand=hand).description
    return Run(collect(plan, description, make, folder / "run", watch=watch), np.array(seen))


@pytest.fixture(scope="module")
def done(tmp_path_factory: pytest.TempPathFactory) -> Run:
    return run(Plan("some", PRESSES, POSES), tmp_path_factory.mktemp("sim"))


def test_forces_reach_their_target(done: Run):
    presses = done.collected.dataset.presses
    target = presses.columns["target_force_n"]
    assert np.abs(presses.force_n - target).max() < 0.12
    assert done.collected.statuses.get("ok", 0) >= 5
    true = np.array([done.held(k)[:, 1].mean() for k in range(len(PRESSES))])
    # Torque sensors are off by a per cent or two, and by a few millinewton metres.
    np.testing.assert_allclose(true, presses.force_n, rtol=0.05, atol=0.03)


def test_no_press_passes_its_target_by_much(done: Run):
    columns = done.collected.dataset.presses.columns
    for k, press in enumerate(PRESSES):
        begin, end = columns["t_start_s"][k], columns["t_end_s"][k]
        rows = (done.truth[:, 0] >= begin) & (done.truth[:, 0] <= end)
        assert done.truth[rows, 1].max() < 1.1 * press.force_n + 0.25


def test_shear_is_regulated_away_in_the_hold(done: Run):
    for k, press in enumerate(PRESSES):
        assert done.held(k)[:, 2].mean() < 0.05 * press.force_n + 0.1


def test_places_are_off_by_what_the_joints_are(done: Run):
    presses = done.collected.dataset.presses
    true = np.array([done.held(k)[:, 4:].mean(axis=0) for k in range(len(PRESSES))])
    away = np.linalg.norm(presses.position_m - true, axis=1)
    assert 1e-5 < away.max() < 2.5e-3


def test_the_skin_is_touched_once_a_press_and_never_dragged_over(done: Run):
    touching = done.truth[:, 1] > 0.02
    begins = np.flatnonzero(np.diff(touching.astype(int)) == 1)
    # Within 0.1 s of the end of a contact the indenter may bounce.
    apart = np.diff(done.truth[begins, 0], prepend=-1.0) > 0.5
    assert apart.sum() == len(PRESSES)
    frames = done.collected.dataset.frames
    assert frames is not None
    idle = frames.time_s[frames.phase == 0]
    forces = np.interp(idle, done.truth[:, 0], done.truth[:, 1])
    assert forces.max() < 0.02


@pytest.mark.parametrize("plane", [False, True])
def test_another_hand_presses_its_skin_too(tmp_path: Path, plane: bool):
    hand = other_hand(tmp_path / "hand", plane=plane)
    presses = tuple(PlannedPress(u, v, 1.5, 0.02, 0.3) for u, v in ((0.0, 0.0), (0.001, -0.001)))
    found = run(Plan("other", presses), tmp_path, hand=str(hand)).collected
    np.testing.assert_allclose(found.dataset.presses.force_n, 1.5, atol=0.12)
    assert check_dataset(tmp_path / "run").errors == ()


def test_a_second_indenter_repeats_forces_and_places(tmp_path: Path):
    sites = ((0.0, 0.0, 2.0), (-0.004, 0.003, 4.0))
    own = [PlannedPress(u, v, force, 0.04, 0.4, "A") for u, v, force in sites]
    other = [replace(press, indenter_radius_m=0.0035) for press in own]
    # With its pose: the search for poses takes longer than the presses.
    done = run(Plan("two", (*own, *other), {"A": (0.0, 0.25, 0.83)}), tmp_path)
    presses = done.collected.dataset.presses
    assert done.collected.statuses == {"ok": 4}
    np.testing.assert_allclose(presses.force_n, [2, 4, 2, 4], atol=0.12)
    np.testing.assert_allclose(presses.position_m[:2], presses.position_m[2:], atol=5e-4)
    for k in range(4):
        # As deep as the skin gives way, not as deep as one sphere is larger than the other.
        assert -1.3e-3 < done.held(k)[:, 3].mean() < -2e-4
    # A smaller sphere presses harder on what it touches.
    assert presses.counts[2].max() > presses.counts[0].max() + 2
    assert check_dataset(tmp_path / "run").errors == ()


def test_poses_reach_every_press_of_a_full_plan():
    fingers = Fingers(Kinematics(bundled_hand()), Mount.of(bundled_hand().meta))
    plan = full_plan(np.random.default_rng(1), fingers.mount.layout)
    options = CollectOptions()
    poses = dict(zip(plan.pose_names, find_poses(plan, fingers, options), strict=True))
    apart = np.abs(np.subtract(*poses.values())).sum()
    assert apart > 0.3
    for press in plan.presses[::8]:
        posture = fingers.posture(press.site, poses[press.pose], options)
        room = reach_of(fingers, posture, press.force_n)
        assert room.margin_rad > 0.05 and room.torque_share < 0.9


def test_a_posture_presses_its_site_along_the_normal():
    kinematics = Kinematics(bundled_hand())
    fingers = Fingers(kinematics, Mount.of(bundled_hand().meta))
    posture = fingers.posture((0.003, -0.002), [0.1, 0.3, 0.8], CollectOptions())
    found = contact_from_joints(kinematics, posture.links_rad, np.zeros_like(posture.links_rad))
    np.testing.assert_allclose(found.gap_m, posture.heights_m, atol=1e-6)
    np.testing.assert_allclose(found.points_m, np.tile(posture.point_m, (7, 1)), atol=1e-6)
    # The angles over the skin are in line: between two heights the indenter stays over the site.
    middle = contact_from_joints(kinematics, posture.links_at(0.0011), np.zeros(6))
    assert middle.gap_m[0] == pytest.approx(0.0011, abs=2e-5)
    pressed = contact_from_joints(kinematics, posture.links_rad[3], 2.0 * posture.torque_m)
    assert pressed.force_n[0] == pytest.approx(2.0, rel=0.02)
    assert np.hypot(pressed.shear_u_n[0], pressed.shear_v_n[0]) < 0.05
