"""Every verb that writes is killed at its write events: its output is whole or absent, and is the same when run again."""

from __future__ import annotations

import contextlib
import io
from collections.abc import Callable
from pathlib import Path

import numpy as np
from calibrations import make_calibration
from killing import Content, Verb, content

from skincal.calibration import write_calibration
from skincal.cli.main import main
from skincal.collect import Plan, PlannedPress, write_plan
from skincal.dataset import read_dataset, write_dataset


def _verb(*words: str) -> Callable[[Path, bool], None]:
    """A verb with its output ``out``, or as it is given."""

    def run(_: Path, force: bool) -> None:
        out = [] if "--out" in words else ["--out", "out"]
        with contextlib.redirect_stderr(io.StringIO()) as said:
            try:
                main([*words, *out, *(["--force"] if force else [])])
            except SystemExit as ended:
                if ended.code:
                    raise AssertionError(said.getvalue()) from None

    return run


def _calibration(folder: Path) -> None:
    write_calibration(make_calibration(rows=20), folder / "cal")


def _session(folder: Path) -> None:
    from benchmarks.sessions import make_session

    write_dataset(make_session(np.random.default_rng(5), presses=12)[0], folder / "data")


def _recording(folder: Path) -> None:
    from imports.foreign import PRESS_ROWS, mapping, press_table, write_mapping, write_press_table

    from benchmarks.sessions import make_session

    data = make_session(np.random.default_rng(5), presses=12)[0]
    write_press_table(folder / "p.csv", press_table(data))
    write_mapping(folder, mapping(PRESS_ROWS))


def _diagnosis(_: Path, force: bool) -> None:
    """What ``skincal diagnose`` does when it has its result; the search itself writes nothing but its cache."""

    def beside(folder: Path) -> None:
        for name in ("diagnosis.json", "gap.png", "report.html"):
            (folder / name).write_text("told")
        write_plan(PLAN, folder / "next-presses.toml")

    write_calibration(make_calibration(rows=20), "out", force=force, beside=beside)


def _evaluation(_: Path, force: bool) -> None:
    """What ``skincal eval`` does when it has its runs."""
    from skincal.cli import eval as cli
    from skincal.files import whole_folder

    with whole_folder("out", force=force, marker=cli.MARKER) as folder:
        for name in (cli.MARKER, "runs.csv", "runs.png", "error.png"):
            (folder / name).write_text("told")


def _names(path: Path) -> Content:
    """Keys are drawn anew each time."""
    return dict.fromkeys(content(path), "")


PLAN = Plan(
    "killed",
    tuple(PlannedPress(1e-3 * i, 0.0, 1.5, 0.04, 0.3, pose="A") for i in range(2)),
    {"A": (0.0, 0.25, 0.83)},
)


def _collected(path: Path) -> Content:
    """Where a session is interrupted, its clock goes on; its presses are where they were planned."""
    presses = read_dataset(path).presses
    return {"presses": presses.press.tolist(), "targets": presses.columns["target_force_n"].tolist()}


def _trained(path: Path) -> Content:
    """Networks and learning curve, bit for bit; times that it took left out."""
    if not (path / "policy.onnx").exists():
        return {}
    import onnx

    from skincal.train import read_curve

    curve = read_curve(path / "curve.csv")
    weights = [value.raw_data for value in onnx.load(path / "policy.onnx").graph.initializer]
    return {
        "weights": weights,
        "curve": [curve[name].tobytes() for name in ("steps", "reward", "actor_loss")],
    }


def _train(place: Path, force: bool) -> None:
    import small_runs  # pyright: ignore[reportMissingImports]

    from skincal.ranges import preset
    from skincal.train import begin, train

    if not (place / "out").exists():
        begin(small_runs.work(), preset("iros24"), place / "out")
    train(place / "out", small_runs.make, 2 * small_runs.CHECKPOINT_STEPS)


FIT = [
    "--y-step-mm",
    "2",
    "--arc-step-mm",
    "4",
    "--alpha-step-deg",
    "20",
    "--e-count",
    "2",
    "--no-report",
    "--workers",
    "1",
    "--draws",
    "20",
]

VERBS = {
    verb.name: verb
    for verb in (
        Verb("export-dr", _verb("export-dr", "cal", "--out", "out.toml"), ("out.toml",), prepare=_calibration),
        Verb("hand keys", _verb("hand", "keys"), look=_names),
        Verb("import", _verb("import", "csv", "map.toml", "p.csv"), prepare=_recording),
        Verb(
            "predict",
            _verb("predict", "cal", "data"),
            prepare=lambda folder: (_calibration(folder), _session(folder)) and None,
        ),
        Verb("dataset show", _verb("dataset", "show", "data", "--out", "out.png"), ("out.png",), prepare=_session),
        Verb("fit", _verb("fit", "data", *FIT), prepare=_session),
        Verb("diagnose", _diagnosis),
        Verb("eval", _evaluation),
        Verb(
            "collect --plan-only",
            _verb("collect", "--plan", "plan.csv", "--plan-only"),
            ("out-plan.toml", "out-plan.png"),
            prepare=lambda folder: write_plan(PLAN, folder / "plan.csv"),
        ),
        Verb(
            "collect",
            _verb("collect", "--driver", "sim", "--seed", "5", "--plan", "plan.toml"),
            look=_collected,
            prepare=lambda folder: write_plan(PLAN, folder / "plan.toml"),
        ),
        Verb("train", _train, look=_trained, partial=True),
    )
}  # fmt: skip
