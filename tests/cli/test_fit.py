from __future__ import annotations

import errno
import json
import signal
import time
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from calibrations import make_calibration
from commands import Fork, Run

from benchmarks.sessions import make_session
from skincal.calibration import write_calibration
from skincal.dataset import write_dataset

QUICK = [
    "--y-step-mm", "1", "--arc-step-mm", "1.5", "--alpha-step-deg", "10", "--e-count", "8", "--no-report"
]  # fmt: skip


@pytest.fixture(scope="module")
def session(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("sessions") / "run"
    write_dataset(make_session(np.random.default_rng(5), presses=30)[0], folder)
    return folder


def _is_what_the_contract_says(out: Path, told: dict[str, Any]) -> None:
    names = {"y_m", "beta_deg", "alpha_deg", "elasticity_pa_per_m", "scale_per_n"}
    assert set(told["best"]) == set(told["intervals"]) == names
    assert told["presses_used"] > 10 and told["loss_mse_counts2"] > 0
    for name in names:
        low, high = told["intervals"][name]
        assert low <= told["best"][name] <= high
    tables = {"grid.parquet", "draws.parquet", "slack.csv"}
    assert {p.name for p in out.iterdir()} == {".skincal.json", "calibration.toml", *tables}


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["--bound", "wide"], "--bound: expected `noise`, `paper` or a positive number"),
        (["--y-range-mm", "30", "20"], "--y-range-mm: expected low below high; got 30 and 20"),
        (["--e-range-mpa-per-m", "-3", "20"], "range of E: expected positive values"),
        (["--e-range-mpa-per-m", "1e8", "2e9"], "got 1e+08 and 2e+09. Are they in Pa/m? Divide by 1e6."),
        (
            ["--x-range-mm", "-1", "1"],
            "--x-range-mm: expected no such range on a cylinder; got one. Give --beta-range-deg",
        ),
        (
            ["--y-range-mm", "0.0195", "0.0275"],
            "--y-range-mm: expected low and high [mm] ([mount] has 19.5 to 27.5); got 0.0195 and 0.0275. "
            "Are they in metres? Multiply by 1000.",
        ),
    ],
)
def test_a_wrong_option_is_status_2(
    session: Path, tmp_path: Path, run: Run, arguments: list[str], message: str
) -> None:
    status, _, err = run("fit", str(session), "--out", str(tmp_path / "cal"), *arguments)
    assert status == 2
    assert message in err
    assert not list(tmp_path.iterdir())


def test_a_calibration_without_effects_is_refused_before_the_fit(
    session: Path, tmp_path: Path, run: Run
) -> None:
    write_calibration(make_calibration(), tmp_path / "plain")
    status, _, err = run(
        "fit", str(session), "--out", str(tmp_path / "cal"), "--effects", str(tmp_path / "plain")
    )
    assert status == 2 and "expected a calibration with effects" in err
    assert [path.name for path in tmp_path.iterdir()] == ["plain"]


def test_a_session_without_active_taxels_exits_1(tmp_path: Path, run: Run) -> None:
    data, _ = make_session(np.random.default_rng(1), presses=10)
    presses = type(data.presses)(
        data.presses.press, data.presses.position_m, data.presses.force_n, np.zeros((10, 16))
    )
    write_dataset(type(data)(data.meta, presses), tmp_path / "dark")
    status, _, err = run("fit", str(tmp_path / "dark"), "--out", str(tmp_path / "cal"))
    assert status == 1
    said = "no press can be used. Of 10 presses 10 were not used: 10 with 0 active taxels"
    assert (
        f"skincal: error: {tmp_path / 'dark'}: {said}" in err and "Press harder or nearer the taxels" in err
    )
    assert [path.name for path in tmp_path.iterdir()] == ["dark"]


def test_a_fit_that_fails_after_its_grid_leaves_nothing(session: Path, tmp_path: Path, run: Run) -> None:
    # A sensor far from every press: the grid is evaluated, and no combination of it gives an image.
    far = ["--y-range-mm", "120", "121", "--workers", "1"]
    status, _, err = run("fit", str(session), "--out", str(tmp_path / "cal"), *QUICK, *far)
    assert status == 1
    assert "no combination of the grid gives an image" in err and "kept" not in err
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize(
    ("error", "turns", "kept", "said"),
    [
        (OSError(errno.ENOSPC, "No space left on device", "cal"), 0, False, "No space left"),
        (OSError(errno.ENOSPC, "No space left on device", "cal"), 2, True, "No space left"),
        (np.linalg.LinAlgError("it would come again"), 1, False, "internal error"),
    ],
)
def test_a_fit_that_ends_early_keeps_what_helps(
    session: Path,
    tmp_path: Path,
    run: Run,
    monkeypatch: pytest.MonkeyPatch,
    error: Exception,
    turns: int,
    kept: bool,
    said: str,
) -> None:
    def fails(*_: object, checkpoint: Path, **__: object) -> None:
        checkpoint.mkdir()
        (checkpoint / ".turn-009.npz.part").write_bytes(b"cut sho")
        for turn in range(turns):
            (checkpoint / f"turn-{turn:03d}.npz").write_bytes(b"")
        raise error

    monkeypatch.setattr("skincal.calibrate.calibrate", fails)
    status, _, err = run("fit", str(session), "--out", str(tmp_path / "cal"), *QUICK)
    folder = tmp_path / ".cal.fit"
    assert status == 1 and said in err
    assert [*tmp_path.iterdir()] == [folder] * kept
    assert (f"The grid so far is saved in {folder}; give the same command again to continue" in err) == kept


def test_an_interrupted_fit_goes_on_where_it_was(session: Path, tmp_path: Path, run: Run) -> None:
    command = ["fit", str(session), "--out", str(tmp_path / "cal"), *QUICK]
    command += ["--workers", "1", "--alpha-step-deg", "2.5", "--json"]
    kept = tmp_path / ".cal.fit"
    first = Fork(tmp_path, command)
    deadline = time.monotonic() + 120
    while len(list(kept.glob("turn-*.npz"))) < 3 and time.monotonic() < deadline and first.poll() is None:
        time.sleep(0.02)
    first.send_signal(signal.SIGINT)
    _, err = first.communicate(timeout=60)
    assert first.returncode == 130, err
    assert "Traceback" not in err
    assert f"interrupted. The grid so far is saved in {kept}" in err
    assert kept.is_dir() and not (tmp_path / "cal").exists()
    status, out, err = run(*command)
    assert status == 0, err
    assert "of 17 sensor rotations were already computed" in err
    assert not list(tmp_path.glob(".*"))
    _is_what_the_contract_says(tmp_path / "cal", json.loads(out))
