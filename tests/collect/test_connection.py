"""Sessions on a hand without physics: what is recorded, what is marked, and what is left when a driver fails."""

from __future__ import annotations

import re
import shutil
import time
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from collect.fake_hand import FakeHand

from skincal.collect import Collected, CollectOptions, Plan, PlannedPress, collect, journal_folder
from skincal.collect.journal import Journal
from skincal.dataset import HOLD, IDLE, check_dataset
from skincal.errors import InputError, WorkError
from skincal.hand import GuardOptions, HandError, HandState

HAND = FakeHand().description
FAST = {"speed_m_per_s": 0.04, "hold_s": 0.4}
PLAN = Plan(
    "small",
    tuple(
        PlannedPress(u, v, force, **FAST, pose=pose)
        for u, v, force, pose in (
            (0.0, 0.0, 2.0, "A"),
            (0.003, -0.002, 0.4, "A"),
            (-0.004, 0.003, 5.0, "B"),
            (0.0, 0.0, 2.0, "A"),
        )
    ),
    {"A": (0.0, 0.25, 0.83), "B": (0.0, -0.07, 1.53)},
)
ONE = Plan("one", PLAN.presses[:1], PLAN.poses)
GUARD = GuardOptions(timeout_s=0.6, stop_timeout_s=0.6)


class Rig:
    """Runs sessions in a folder and keeps the hands that they used."""

    def __init__(self, folder: Path) -> None:
        self.out, self.hands = folder / "run", list[FakeHand]()

    def run(
        self, plan: Plan = PLAN, spoil: Callable[..., HandState] | None = None, **options: object
    ) -> Collected:
        def make(need: object) -> FakeHand:
            self.hands.append(FakeHand(seed=len(self.hands), spoil=spoil))
            return self.hands[-1]

        return collect(plan, HAND, make, self.out, key={"seed": 1}, guard=GUARD, **options)  # type: ignore[arg-type]

    def kept(self) -> dict[int, bytes]:
        return {int(p.stem[-5:]): p.read_bytes() for p in journal_folder(self.out).glob("press-*.npz")}


@pytest.fixture
def rig(tmp_path: Path) -> Rig:
    return Rig(tmp_path)


@pytest.fixture(scope="module")
def whole(tmp_path_factory: pytest.TempPathFactory) -> Rig:
    rig = Rig(tmp_path_factory.mktemp("whole"))
    rig.run()
    return rig


def column(rig: Rig, name: str) -> np.ndarray:
    dataset = check_dataset(rig.out).dataset
    assert dataset is not None
    found = dataset.presses.column(name)
    assert found is not None
    return found


def test_the_dataset_is_valid_and_nothing_else_is_left(whole: Rig):
    check = check_dataset(whole.out)
    assert check.errors == () and check.warnings == ()
    assert [p.name for p in whole.out.parent.iterdir()] == ["run"]
    hand = whole.hands[0]
    assert hand.stopped and hand.closed


def test_forces_and_places_are_those_planned(whole: Rig):
    dataset = check_dataset(whole.out).dataset
    assert dataset is not None
    presses = dataset.presses
    np.testing.assert_allclose(presses.force_n, [2.0, 0.4, 5.0, 2.0], atol=0.05)
    targets = np.column_stack([column(whole, f"target_{axis}_m") for axis in "xyz"])
    assert np.linalg.norm(presses.position_m - targets, axis=1).max() < 1.5e-3
    assert column(whole, "status").tolist() == ["ok"] * 4 and not column(whole, "missed_target").any()
    assert column(whole, "cycle").tolist() == [0, 0, 0, 1]
    assert column(whole, "pose").tolist() == ["A", "A", "B", "A"]
    joints = {f"{name}_{j}" for name in ("q", "tau", "q_desired", "tau_rest") for j in range(6)}
    assert joints | {"speed_m_per_s", "shear_u_n", "shear_v_n"} <= set(presses.columns)
    assert max(whole.hands[0].forces) < 5.5
    # The commanded angles lead the measured ones into the skin.
    assert abs(presses.columns["q_desired_1"][2] - presses.columns["q_1"][2]) > 0.01
    assert dataset.frames is not None and "q_desired_5" in dataset.frames.columns


def test_frames_cover_the_session_from_rest_to_rest(whole: Rig):
    dataset = check_dataset(whole.out).dataset
    assert dataset is not None and dataset.frames is not None
    frames = dataset.frames
    assert frames.phase[0] == frames.phase[-1] == IDLE
    gaps = np.diff(frames.time_s)
    assert 0.03 < np.median(gaps) < 0.05 and gaps.max() < 0.12
    for press in dataset.presses.press:
        own = frames.select(frames.press == press)
        # Load, hold, unload, in this order, with rest around them.
        assert list(dict.fromkeys(own.phase.tolist())) == [1, 2, 3]
        hold = own.force_n[own.phase == HOLD]
        assert abs(hold.mean() - dataset.presses.force_n[press]) < 0.05
    idle = frames.phase == IDLE
    assert np.abs(frames.force_n[idle]).max() < 0.15
    # The noise of one count aside, nothing is seen where nothing touches.
    assert frames.counts[idle].mean() < 1.0


def test_torque_offsets_are_taken_off(rig: Rig):
    def offset(number: int, state: HandState) -> HandState:
        return replace(state, tau_nm=state.tau_nm + 0.01)

    rig.run(ONE, spoil=offset)
    assert abs(rig.hands[0].forces and max(rig.hands[0].forces) - 2.0) < 0.15
    np.testing.assert_allclose(column(rig, "tau_rest_0"), 0.01, atol=2e-3)


def test_an_unreached_force_is_marked(rig: Rig):
    # The sensor sees two thirds of the torque only while the command may not grow without bound.
    def weak(number: int, state: HandState) -> HandState:
        return replace(state, tau_nm=0.15 * state.tau_nm)

    found = rig.run(ONE, spoil=weak)
    assert found.missed_target == 1 and found.statuses == {"missed_target": 1}
    assert len(found.dataset.presses) == 1


def test_skin_that_is_not_there_is_marked(rig: Rig):
    def numb(number: int, state: HandState) -> HandState:
        return replace(state, tau_nm=np.zeros(6))

    plan = Plan("numb", PLAN.presses[1:2], {"A": PLAN.poses["A"]})
    found = rig.run(plan, spoil=numb, options=CollectOptions(search_m=1e-3))
    assert found.statuses == {"no_contact": 1}
    assert np.isfinite(found.dataset.presses.position_m).all()
    assert found.dataset.frames is not None and (found.dataset.frames.phase == IDLE).all()


def test_contact_that_is_lost_in_the_hold_is_marked(rig: Rig):
    class Losing:
        held = 0

        def __call__(self, number: int, state: HandState) -> HandState:
            pressed = np.abs(state.tau_nm).max() > 0.1
            self.held += pressed
            return replace(state, tau_nm=np.zeros(6)) if self.held > 15 else state

    assert rig.run(ONE, spoil=Losing()).statuses == {"lost_contact": 1}


BLIND = {
    "dead": (lambda s, _: replace(s, tau_nm=0 * s.tau_nm), -1.0, "a force that grows"),
    "noise alone": (lambda s, _: replace(s, tau_nm=1e-6 * s.q_rad), -1.0, "a force that grows"),
    "another unit": (lambda s, _: replace(s, tau_nm=1e-3 * s.tau_nm), -1.0, "a force that grows"),
    "frozen": (lambda s, first: replace(s, tau_nm=first.tau_nm), 1.0, "a force that grows"),
    "reversed": (lambda s, _: replace(s, tau_nm=-s.tau_nm), -1.0, "The sign is wrong"),
}


@pytest.mark.parametrize(("how", "force_n", "text"), BLIND.values(), ids=BLIND)
def test_torques_that_do_not_answer_contact_end_the_session(
    rig: Rig, how: Callable[[HandState, HandState], HandState], force_n: float, text: str
):
    kept: list[HandState] = []

    def spoil(number: int, state: HandState) -> HandState:
        if kept or rig.hands[-1].forces[-1] > force_n:
            kept.append(state)
        return how(state, kept[0]) if kept else state

    with pytest.raises(WorkError, match=text) as caught:
        rig.run(spoil=spoil)
    assert "The hand was stopped." in caught.value.__notes__
    assert rig.hands[0].stopped and rig.kept() == {}
    assert max(rig.hands[0].forces) < 4.0


def test_taxels_that_feel_the_indenter_above_them_stop_no_hand(rig: Rig):
    """As those of magnetic skins do."""

    def near(number: int, state: HandState) -> HandState:
        return replace(state, taxels=state.taxels + (50.0 if number % 150 > 60 else 0.0))

    assert rig.run(ONE, near).statuses == {"ok": 1}


def failing(at: int, how: Callable[[HandState], HandState]) -> Callable[[int, HandState], HandState]:
    return lambda number, state: how(state) if number == at else state


def hang(state: HandState) -> HandState:
    time.sleep(1.5)
    return state


def raise_error(state: HandState) -> HandState:
    raise RuntimeError("the cable is out")


FAULTS = {
    "raises": raise_error,
    "hangs": hang,
    "nan": lambda state: replace(state, q_rad=np.full(6, np.nan)),
    "shape": lambda state: replace(state, tau_nm=np.zeros(5)),
    "stale": lambda state: replace(state, time_s=state.time_s - 5.0),
    "force": lambda state: replace(state, tau_nm=np.full(6, 1.4)),
}


@pytest.fixture(scope="module")
def first_cut(tmp_path_factory: pytest.TempPathFactory) -> Rig:
    """A session whose driver failed after a press."""
    rig = Rig(tmp_path_factory.mktemp("cut"))
    with pytest.raises(HandError):
        rig.run(spoil=failing(290, raise_error))
    return rig


@pytest.fixture
def cut(rig: Rig, first_cut: Rig) -> Rig:
    """The same, for a test that goes on with it."""
    shutil.copytree(first_cut.out.parent, rig.out.parent, dirs_exist_ok=True)
    rig.hands = first_cut.hands[:]
    return rig


@pytest.mark.parametrize("fault", FAULTS)
def test_a_failing_driver_is_stopped_and_loses_no_press(rig: Rig, first_cut: Rig, fault: str):
    with pytest.raises(HandError):
        rig.run(spoil=failing(290, FAULTS[fault]))
    assert rig.hands[0].stopped
    assert not rig.out.exists()
    # From what is kept here, the next test goes on.
    assert rig.kept() == first_cut.kept()
    names = [sorted(path.name for path in journal_folder(one.out).iterdir()) for one in (rig, first_cut)]
    assert names[0] == names[1]


def test_a_session_that_was_cut_goes_on(cut: Rig):
    kept = cut.kept()
    assert 1 <= len(kept) < len(PLAN)
    found = cut.run()
    assert found.resumed == len(kept) and len(found.dataset.presses) == len(PLAN)
    assert check_dataset(cut.out).errors == ()
    assert [p.name for p in cut.out.parent.iterdir()] == ["run"]


def _silent(n: int, state: HandState) -> HandState:
    """A taxel that does not answer now and then, and a whole image that is lost once."""
    mute = np.arange(16) == n % 16 if n % 9 == 0 else np.full(16, n in (200, 201))
    return replace(
        state,
        taxels=np.where(mute, np.nan, state.taxels),
        taxel_time_s=np.where(mute, np.nan, state.taxel_time_s),
    )


def test_a_moment_without_an_answer_spoils_no_dataset(rig: Rig):
    found = rig.run(ONE, _silent)
    assert found.problems == ()
    check = check_dataset(rig.out)
    assert check.errors == () and check.dataset is not None and check.dataset.frames is not None
    assert np.isfinite(check.dataset.frames.counts).all()
    assert len(check.dataset.frames) > 30


def _jumped(n: int, state: HandState) -> HandState:
    jump_s = 1e6 if n > 80 else 0.0
    return replace(state, time_s=state.time_s + jump_s, taxel_time_s=state.taxel_time_s + jump_s)


@pytest.mark.parametrize(
    ("spoil", "text"),
    [
        (_jumped, "the hand's clock jumped by 1e+06 s"),
        (lambda n, s: replace(s, taxels=s.taxels + 1e9) if n > 80 else s, r"the converter gives 0 to 255"),
        (
            lambda n, s: replace(s, taxels=s.taxels + 0.5) if n > 80 else s,
            "the converter gives whole numbers",
        ),
    ],
    ids=["clock", "counts", "halves"],
)
def test_what_no_dataset_could_hold_ends_the_session(rig: Rig, spoil: Callable[..., HandState], text: str):
    with pytest.raises(HandError, match=re.escape(text)):
        rig.run(ONE, spoil)
    assert rig.hands[-1].stopped
    assert not rig.out.exists()


def test_a_dataset_that_cannot_be_used_is_reported_at_once(rig: Rig):
    found = rig.run(ONE, lambda n, s: replace(s, tau_nm=0 * s.tau_nm, taxels=0 * s.taxels))
    assert found.statuses == {"no_contact": 1}
    assert "expected positive normal forces" in str(found.problems[0])


def test_a_session_that_never_reached_its_hand_leaves_nothing(rig: Rig):
    with pytest.raises(HandError, match="cable"):
        rig.run(spoil=lambda number, state: raise_error(state))
    assert list(rig.out.parent.iterdir()) == []


def test_a_recorded_hand_presses_nothing(rig: Rig, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr(FakeHand, "follows_commands", False)
    with pytest.raises(InputError, match="a hand that moves; got a recorded one"):
        rig.run()
    assert list(rig.out.parent.iterdir()) == [] and rig.hands[0].forces == []


def test_a_resumed_session_keeps_its_finished_presses(cut: Rig):
    journal = Journal.find(journal_folder(cut.out))
    assert journal is not None
    before = journal.presses()
    ends = max(float(arrays["frames.time_s"][-1]) for arrays in before.values())
    found = cut.run().dataset
    for number, arrays in before.items():
        assert found.presses.force_n[number] == float(arrays["press.force_n"])
        np.testing.assert_array_equal(found.presses.counts[number], arrays["press.counts"])
    later = found.presses.columns["t_start_s"][len(before) :]
    assert np.all(later > ends)
    assert found.frames is not None and np.all(np.diff(found.frames.time_s) > 0)


def test_a_journal_that_was_changed_moves_no_hand(cut: Rig):
    file = journal_folder(cut.out) / "press-00000.npz"
    with np.load(file) as arrays:
        kept = dict(arrays)
    changes = ({"press.counts": np.ones(3)}, {"press.press": np.array(7)}, {"frames.time_s": np.array("x")})
    for changed in (*({**kept, **change} for change in changes), {"a": np.ones(1)}):
        np.savez(file, **changed)
        with pytest.raises(InputError, match="--restart"):
            cut.run()
    assert len(cut.hands) == 1


def test_a_changed_plan_in_the_journal_changes_no_press(cut: Rig):
    file = journal_folder(cut.out) / "plan.toml"
    text = file.read_text()
    assert "force_n = 2.0" in text
    file.write_text(text.replace("force_n = 2.0", "force_n = 6.0"))
    cut.run()
    assert column(cut, "target_force_n").tolist() == [2.0, 0.4, 5.0, 2.0]


def test_a_site_that_was_perhaps_touched_counts_as_touched(rig: Rig):
    with pytest.raises(HandError):
        rig.run(spoil=failing(120, raise_error))
    assert rig.kept() == {}
    rig.run()
    # Press 0 was cut off, and presses 0 and 3 share their site.
    assert column(rig, "cycle").tolist() == [1, 0, 0, 2]


def test_a_hand_that_still_touches_is_lifted_before_it_goes_on(rig: Rig):
    def pressed(number: int, state: HandState) -> HandState:
        return raise_error(state) if rig.hands[0].forces[-1] > 1.5 else state

    with pytest.raises(HandError):
        rig.run(spoil=pressed)
    left = rig.hands[0]
    assert left.forces[-1] > 1.0

    def make(need: object) -> FakeHand:
        # The same hand, where it was left.
        rig.hands.append(FakeHand(start_s=100.0))
        rig.hands[-1].take_place_of(left)
        return rig.hands[-1]

    found = collect(PLAN, HAND, make, rig.out, key={"seed": 1}, guard=GUARD)
    assert found.statuses == {"ok": 4}
    assert max(rig.hands[-1].forces) < 5.5


def test_another_session_in_the_same_place_is_refused(cut: Rig):
    other = Plan("other", PLAN.presses[:2], {"A": PLAN.poses["A"]})
    with pytest.raises(InputError, match="--restart"):
        cut.run(other)
    assert len(cut.run(other, restart=True).dataset.presses) == 2


def test_a_dataset_that_was_written_is_not_written_again(rig: Rig, monkeypatch: pytest.MonkeyPatch):
    with monkeypatch.context() as patch:
        patch.setattr(Journal, "remove", lambda self: (_ for _ in ()).throw(WorkError("cut off")))
        with pytest.raises(WorkError):
            rig.run()
    written = (rig.out / "presses.csv").stat().st_mtime_ns
    (rig.out.parent / ".run.abcd_123.part").mkdir()  # of another process that was killed while it wrote
    assert len(rig.run().dataset.presses) == len(PLAN)
    assert (rig.out / "presses.csv").stat().st_mtime_ns == written
    assert [p.name for p in rig.out.parent.iterdir()] == ["run"] and len(rig.hands) == 1


def test_a_press_out_of_reach_is_named_before_anything_moves(rig: Rig):
    far = PlannedPress(0.03, 0.03, 2.0, **FAST)
    strong = PlannedPress(0.0, 0.0, 9.5, **FAST)
    with pytest.raises(InputError) as caught:
        rig.run(Plan("far", (PLAN.presses[0], far, strong), {"A": PLAN.poses["A"]}))
    assert "press 1" in str(caught.value) and "press 2" in str(caught.value)
    assert "press 0" not in str(caught.value) and rig.hands == []


def test_a_second_indenter_is_asked_for_and_recorded(rig: Rig):
    needs: list[float | None] = []

    def make(need: object) -> FakeHand:
        needs.append(need.indenter_radius_m)  # type: ignore[attr-defined]
        return FakeHand()

    presses = (PLAN.presses[0], replace(PLAN.presses[0], indenter_radius_m=0.006))
    found = collect(Plan("two", presses, {"A": PLAN.poses["A"]}), HAND, make, rig.out)
    assert needs == [None, 0.006]
    radii = found.dataset.presses.column("indenter_radius_m")
    assert radii is not None
    np.testing.assert_array_equal(radii, [np.nan, 0.006])
    assert check_dataset(rig.out).errors == ()


def test_a_stretch_without_a_frame_is_kept_as_such(rig: Rig):
    found = rig.run(ONE, options=CollectOptions(frame_rate_hz=0.1))
    frames = found.dataset.frames
    assert frames is not None and len(frames.time_s) == 1
    assert found.dataset.presses.counts.shape == (1, 16)
