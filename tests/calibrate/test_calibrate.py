from __future__ import annotations

import errno
import multiprocessing
import os
import signal
import subprocess
import sys
import threading
import time
from concurrent.futures import ProcessPoolExecutor
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from threadpoolctl import threadpool_info, threadpool_limits

from benchmarks.sessions import make_session
from skincal.calibrate import calibrate, dataset_fit, search_box
from skincal.calibrate.checkpoint import Checkpoint, fit_key
from skincal.calibrate.dataset_fit import why_dropped
from skincal.calibrate.problem import fit_problem, unroll
from skincal.calibration import read_calibration, write_calibration
from skincal.dataset import Dataset, PositionSpec
from skincal.errors import InputError, WorkError
from skincal.fitting.fit_options import FitOptions
from skincal.fitting.grid import GridSlab
from skincal.fitting.problem import NO_DENSITY, FitError
from skincal.model import Cylinder, Plane
from skincal.workers.processes import mapper
from tests.fitting.conftest import QUICK, ROUGH


@pytest.fixture(scope="module")
def session() -> Dataset:
    return make_session(np.random.default_rng(5), presses=50)[0]


def blocked(_: int) -> tuple[int, bool]:
    return os.getpid(), signal.SIGINT in signal.pthread_sigmask(signal.SIG_BLOCK, [])


def test_terminal_interrupt_ends_all_workers_at_once() -> None:
    with pytest.raises(KeyboardInterrupt), mapper(2) as spread:
        ((process, is_blocked),) = spread(blocked, [0])
        assert is_blocked and process != os.getpid()
        assert not blocked(0)[1]
        workers = multiprocessing.active_children()
        spread(time.sleep, [20.0, 20.0])
        time.sleep(0.5)  # until they have begun
        raise KeyboardInterrupt
    for worker in workers:
        worker.join(5)
    assert workers
    assert not any(worker.is_alive() for worker in workers)


def test_work_that_nobody_waits_for_is_dropped(capfd: pytest.CaptureFixture[str]) -> None:
    begin = time.monotonic()
    with mapper(2) as spread:
        assert list(spread(abs, [-1])) == [1]
        spread(time.sleep, [30.0, 30.0, 30.0])
        time.sleep(0.5)  # until they have begun
        workers = multiprocessing.active_children()
    assert time.monotonic() - begin < 20.0
    for worker in workers:
        worker.join(5)
    assert workers and not any(worker.is_alive() for worker in workers)
    assert "Traceback" not in capfd.readouterr().err


def test_a_result_that_was_half_sent_is_dropped() -> None:
    begin = time.monotonic()
    with mapper(2) as spread:
        assert list(spread(abs, [-1, -1])) == [1, 1]
        spread(bytes, [300_000_000])
        thread = next(t for t in threading.enumerate() if type(t).__name__ == "_ExecutorManagerThread")
        half_sent = False
        while not half_sent and time.monotonic() - begin < 30.0:
            frame = sys._current_frames().get(thread.ident or 0)
            half_sent = frame is not None and frame.f_code.co_name in ("_recv", "_recv_bytes")
    assert half_sent
    assert not thread.is_alive() and time.monotonic() - begin < 45.0


KILLED = """
import multiprocessing, os, signal, time
from skincal.workers.processes import mapper

# No guard of __main__: workers do not run the script again.
with mapper(3) as spread:
    list(spread(abs, range(4)))
    spread(time.sleep, [60.0] * 3)  # one is at work on each worker, one waits
    print(*(worker.pid for worker in multiprocessing.active_children()), flush=True)
    os.kill(os.getpid(), signal.SIGKILL)
"""


def test_a_fit_that_is_killed_leaves_no_worker(tmp_path: Path) -> None:
    script = tmp_path / "killed.py"
    script.write_text(KILLED)
    # The workers share the output: it ends when the last of them does.
    done = subprocess.run([sys.executable, script], capture_output=True, text=True, timeout=50)
    assert done.returncode == -signal.SIGKILL
    assert len(done.stdout.split()) == 2


def test_an_interrupt_while_workers_start_comes_afterwards(monkeypatch: pytest.MonkeyPatch) -> None:
    submit, started = ProcessPoolExecutor.submit, list[int]()

    def interrupted(pool: ProcessPoolExecutor, *work: Any) -> Any:
        started.append(signal.raise_signal(signal.SIGINT) or len(started))
        return submit(pool, *work)

    monkeypatch.setattr(ProcessPoolExecutor, "submit", interrupted)
    with pytest.raises(KeyboardInterrupt), mapper(3):
        pytest.fail("the interrupt is lost")
    assert started == [0, 1]


def test_an_interrupt_with_cancelled_work_is_quiet(capfd: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(KeyboardInterrupt), mapper(2) as spread:
        results = iter(spread(time.sleep, [0.01] + [1.0] * 12))
        next(results)
        del results  # as when a loop over them is interrupted: what has not begun is cancelled
        raise KeyboardInterrupt
    for worker in multiprocessing.active_children():
        worker.join(5)
    time.sleep(0.2)
    assert "Traceback" not in capfd.readouterr().err


def test_unrolling_gives_arcs_round_a_finger_and_x_on_a_plane() -> None:
    rng = np.random.default_rng(0)
    across, along = rng.uniform(-0.01, 0.01, (2, 20))
    for surface, radius, z in ((Cylinder(0.0115), 0.0115, 0.0115), (Plane(), None, 0.0)):
        back = unroll(radius, surface.offset(np.tile([0.0, 0.0, z], (20, 1)), across, along))
        assert back[0] == pytest.approx(across)
        assert back[1] == pytest.approx(along)


def test_presses_at_the_back_of_the_finger_stay_together() -> None:
    beta = np.radians([170.0, 178.0, -179.0, -172.0])
    points = 0.0115 * np.stack([np.sin(beta), np.zeros(4), np.cos(beta)], axis=1)
    across, _ = unroll(0.0115, points, np.radians(178.0))
    assert np.degrees(across / 0.0115) == pytest.approx([170.0, 178.0, 181.0, 188.0])


def test_places_known_exactly_or_not_bounded_are_no_error(session: Dataset) -> None:
    position = replace(session.meta.position, sigma_m=0.0, slack_m=np.inf)
    rig = fit_problem(replace(session, meta=replace(session.meta, position=position)), FitOptions()).rig
    assert 0 < rig.position_sigma_m <= 1e-6
    assert rig.slack_m == pytest.approx(np.ptp(session.layout().bounds_m, axis=0).max() / 2)


def test_a_mount_without_room_is_refused(session: Dataset) -> None:
    mount = replace(session.meta.mount, alpha_range_deg=(0.0, 0.0))
    tight = replace(session, meta=replace(session.meta, mount=mount))
    with pytest.raises(InputError, match="alpha_range: expected low below high"):
        search_box(tight)
    assert search_box(tight, alpha_deg=(-5.0, 5.0)).alpha_rad[1] > 0


def test_ranges_come_from_the_mount_unless_given(session: Dataset) -> None:
    box = search_box(session)
    low, high = session.meta.mount.beta_range_deg or (0.0, 0.0)
    assert np.degrees(np.array(box.across_m) / 0.0115) == pytest.approx([low, high])
    assert search_box(session, y_m=(0.02, 0.021)).y_m == (0.02, 0.021)
    with pytest.raises(InputError, match="range of y") as error:
        search_box(session, y_m=(0.03, 0.02), elasticity_pa_per_m=(-1.0, 2.0))
    with pytest.raises(InputError, match=r"range of E: expected .* Pa/m; got 2e\+08 and 1e\+20"):
        search_box(session, elasticity_pa_per_m=(2e8, 1e20))
    assert len(error.value.problems) == 2


def test_no_usable_press_says_why(session: Dataset) -> None:
    silent = replace(session, presses=replace(session.presses, counts=np.zeros_like(session.presses.counts)))
    with pytest.raises(WorkError, match=r"no press can be used.*50 presses 50 were not used.*active taxels"):
        calibrate(silent, options=QUICK, workers=1)


def test_a_refusal_names_the_dataset_and_says_what_to_do(session: Dataset, tmp_path: Path) -> None:
    few = replace(session, presses=session.presses.select([0, 1]), folder=tmp_path / "thumb")
    with pytest.raises(WorkError) as few_of_many:
        calibrate(few, options=replace(QUICK, min_active=1, active_counts=-1e3), workers=1)
    assert str(few_of_many.value) == (
        f"{tmp_path / 'thumb'}: only 2 presses can be used, and the five parameters need at least 3. "
        "Collect more presses, 24 or more, spread over the patch."
    )
    # One press thirty times over: what it lights looks like the level at rest.
    row = int(session.presses.counts.max(axis=1).argmax())
    presses = replace(session.presses.select([row] * 30), press=np.arange(30))
    with pytest.raises(
        WorkError, match=r"the dataset: no press can be used.*add frames at rest \(phase idle\)"
    ):
        calibrate(replace(session, presses=presses, frames=None, folder=None), options=QUICK, workers=1)


def test_why_presses_were_dropped_is_reported_in_plain_words(session: Dataset) -> None:
    problem = fit_problem(session, FitOptions())
    one = replace(problem, status=("1 active taxel (at least 2 above 5 counts are needed)",))
    assert why_dropped(one) == (
        "The only press was not used: 1 active taxel (at least 2 above 5 counts are needed)."
    )
    assert why_dropped(replace(problem, status=("used", "used"))) == "All 2 presses were used."
    assert why_dropped(replace(problem, status=("used", "no position"))) == (
        "Of 2 presses 1 was not used: 1 with no position."
    )


def test_a_calibration_comes_back_from_its_folder(session: Dataset, tmp_path: Path) -> None:
    few = replace(session, presses=session.presses.select(np.arange(30)))
    outcome = calibrate(few, options=ROUGH, workers=1, checkpoint=tmp_path / "kept", command="test")
    assert len(list((tmp_path / "kept").glob("turn-*.npz"))) == len(outcome.result.grid.grid.alpha_rad)
    write_calibration(outcome.calibration, tmp_path / "cal")
    back = read_calibration(tmp_path / "cal")
    assert back.model == outcome.calibration.model
    assert back.intervals == outcome.calibration.intervals
    assert back.slack is not None and back.draws is not None and back.grid is not None
    assert back.slack["used"].sum() == back.loss.presses_used == len(outcome.result.problem)
    assert len(back.grid["mse_counts2"]) == outcome.result.grid.grid.combinations
    low, high = back.intervals["elasticity_pa_per_m"]
    assert low <= back.model.elasticity_pa_per_m <= high
    assert back.skin().parameters.elasticity_pa_per_m == back.model.elasticity_pa_per_m


def _slab(value: float) -> GridSlab:
    return GridSlab(np.full((2, 2, 2), value), np.ones((2, 2, 2)), np.zeros((2, 2, 2)))


@pytest.mark.parametrize(
    "change",
    [
        {"turn": np.inf}, {"turn": "x"}, {"mse_counts2": np.zeros((2, 2))}, {"scale_per_n": np.array("text")},
        {"slack_rms_m": np.zeros((3, 1, 1), dtype=np.int8)},
    ],
)  # fmt: skip
def test_a_checkpoint_of_other_kinds_is_not_used(tmp_path: Path, change: dict[str, Any]) -> None:
    kept = {name: np.zeros((3, 1, 1)) for name in ("mse_counts2", "scale_per_n", "slack_rms_m")}
    np.savez(tmp_path / "turn-000.npz", **{"key": "key", "turn": np.array(0), **kept, **change})
    assert Checkpoint(tmp_path, "key").load() == {}
    table = {name: np.zeros(3) for name in ("key", "reach")} | {"reach": np.full(6, np.inf)}
    np.savez(tmp_path / "table-one.npz", **{**table, "key": "key"})
    assert Checkpoint(tmp_path, "key").table("one") is None


def test_foreign_or_damaged_checkpoints_are_not_used(
    session: Dataset, tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    box = search_box(session)
    key = fit_key("abc", "fast", QUICK, box)
    assert key == fit_key("abc", "fast", replace(QUICK, level=0.9), box)
    assert key != fit_key("abc", "fast", replace(QUICK, active_counts=7.0), box)
    kept = Checkpoint(tmp_path / "kept", key)
    kept.keep(0, _slab(1.0))
    kept.keep(3, _slab(2.0))
    assert set(kept.load()) == {0, 3}
    assert (kept.load()[3].mse_counts2 == 2.0).all()
    assert Checkpoint(tmp_path / "kept", "other").load() == {}
    assert "nothing of this fit; it begins anew" in caplog.text
    file = tmp_path / "kept" / "turn-003.npz"
    file.write_bytes(file.read_bytes()[:100])
    assert set(kept.load()) == {0}
    kept.remove()
    assert not (tmp_path / "kept").exists()


def _square(value: int) -> int:
    return value * value


def test_checkpoint_on_a_full_disk_names_its_file(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def full(*_: object, **__: object) -> None:
        raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr("numpy.savez", full)
    with pytest.raises(OSError, match=r"cal\.fit/turn-003\.npz"):
        Checkpoint(tmp_path / ".cal.fit", "key").keep(3, GridSlab(*np.zeros((3, 1, 1, 1))))
    assert not list((tmp_path / ".cal.fit").iterdir())


@pytest.mark.parametrize("workers", [1, 2])
def test_a_mapper_keeps_the_order(workers: int) -> None:
    with mapper(workers) as spread:
        assert list(spread(_square, range(6))) == [0, 1, 4, 9, 16, 25]


def test_taxels_in_another_order_are_named_and_give_no_interval(session: Dataset, tmp_path: Path) -> None:
    presses = session.presses.select(np.arange(32))
    mirrored = presses.counts.reshape(-1, 4, 4)[:, :, ::-1].reshape(-1, 16)
    turned = replace(session, presses=replace(presses, counts=mirrored), frames=None)
    found = calibrate(turned, options=ROUGH, workers=1).calibration
    write_calibration(found, tmp_path / "cal")
    back = read_calibration(tmp_path / "cal")
    assert back.findings[0].code == "taxel_order"
    assert back.findings[0].mapping == "flip_cols = true"
    assert "dead_taxel" not in {one.code for one in back.findings}
    assert not np.isfinite(list(back.intervals.values())).any()
    assert "mapping" not in {key for one in back.findings[1:] for key in one.plain()}


def test_a_fit_that_is_done_removes_only_what_it_kept(tmp_path: Path) -> None:
    kept = Checkpoint(tmp_path / ".cal.fit", "key")
    kept.keep(3, GridSlab(*np.zeros((3, 1, 1, 1))))
    (kept.folder / "thesis.txt").write_text("mine")
    kept.remove()
    assert [path.name for path in kept.folder.iterdir()] == ["thesis.txt"]
    (kept.folder / "thesis.txt").unlink()
    kept.keep(3, GridSlab(*np.zeros((3, 1, 1, 1))))
    kept.remove()
    assert not kept.folder.exists()


@pytest.mark.parametrize("sigma_m", [1e-3, float("inf")])
def test_advice_fits_what_is_known_of_the_places(
    session: Dataset, monkeypatch: pytest.MonkeyPatch, sigma_m: float
) -> None:
    def nowhere(*_: object, **__: object) -> None:
        raise FitError(NO_DENSITY)

    monkeypatch.setattr(dataset_fit, "solve", nowhere)
    placed = replace(session, meta=replace(session.meta, position=PositionSpec(sigma_m, 2e-3)))
    with pytest.raises(WorkError) as caught:
        calibrate(placed, options=QUICK, workers=1)
    asked = "Are positions in the fingertip frame" in str(caught.value)
    assert asked == np.isfinite(sigma_m)
    assert asked != ("Write the contact point in x_m, y_m, z_m" in str(caught.value))


def test_linear_algebra_has_one_thread(session: Dataset) -> None:
    """As the command line's has: with more, a fit from Python gave other bytes, and took three times as long."""

    class SeenError(Exception):
        pass

    def threads() -> set[int]:
        return {one["num_threads"] for one in threadpool_info() if one["user_api"] == "blas"}

    def look(*_: object) -> None:
        raise SeenError(threads())

    with threadpool_limits(2, "blas"):
        with pytest.raises(SeenError) as found:
            calibrate(session, workers=1, progress=look)
        assert found.value.args[0] == {1}
        assert threads() == {2}
