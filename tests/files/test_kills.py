"""Every verb that writes is killed at its write events: its output is whole or absent, and the same when run again."""

from __future__ import annotations

import contextlib
import io
import json
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
import typer.main
from calibrations import make_calibration
from killing import Content, Study, Verb, content

from skincal.calibrate.checkpoint import Checkpoint
from skincal.calibration import write_calibration
from skincal.cli.main import app, main
from skincal.collect import Plan, PlannedPress, write_plan
from skincal.dataset import read_dataset, write_dataset
from skincal.fitting.grid import GridSlab


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


def _both(folder: Path) -> None:
    _calibration(folder)
    _session(folder)


def _recording(folder: Path) -> None:
    from imports.foreign import PRESS_ROWS, mapping, press_table, write_mapping, write_press_table

    from benchmarks.sessions import make_session

    data = make_session(np.random.default_rng(5), presses=12)[0]
    write_press_table(folder / "p.csv", press_table(data))
    write_mapping(folder, mapping(PRESS_ROWS))


def _fit(_: Path, force: bool) -> None:
    """Store grid results and the output as ``skincal fit`` does."""
    kept = Checkpoint(Path(".out.fit"), "key")
    slabs = kept.load()
    for turn in range(4):
        if turn not in slabs:
            kept.keep(turn, GridSlab(*np.full((3, 2, 2, 2), float(turn))))
    grid = {"mse_counts2": np.array([slab.mse_counts2[0, 0, 0] for _, slab in sorted(kept.load().items())])}
    write_calibration(make_calibration(rows=20, grid=grid), "out", force=force)
    kept.remove()


def _diagnosis(_: Path, force: bool) -> None:
    """Write the output as ``skincal diagnose`` does; its search writes nothing but its cache."""

    def beside(folder: Path) -> None:
        for name in ("diagnosis.json", "gap.png", "report.html"):
            (folder / name).write_text("told")
        write_plan(PLAN, folder / "next-presses.toml")

    write_calibration(make_calibration(rows=20), "out", force=force, beside=beside)


def _audit(_: Path, force: bool) -> None:
    """Write the output as ``skincal audit`` does, a picture; what it shows takes seconds to compute."""
    from matplotlib.figure import Figure

    from skincal.cli.audit import PICTURE
    from skincal.files import whole_folder
    from skincal.report.style import save

    with whole_folder("out", force=force, marker=PICTURE) as folder:
        save(Figure(), folder / PICTURE)


def _evaluation(_: Path, force: bool) -> None:
    """Write the output as ``skincal eval`` does."""
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
    """Return the presses and their targets; the clock of an interrupted session goes on, so times differ."""
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
        "curve": [curve[name].tobytes() for name in ("steps", "reward", "error_m", "drops")],
    }


def _rolled(path: Path) -> Content:
    """Return what is written; of ``deploy.json`` without the time that the policy took, which its picture shows too."""
    found = content(path)
    for name in found:
        if name.endswith("run.png"):
            found[name] = ""
    if (path / "deploy.json").exists():
        told = json.loads((path / "deploy.json").read_text())
        found[f"{path.name}/deploy.json"] = {**told, "inference_s": 0.0}
    return found


def _train(place: Path, force: bool) -> None:
    import small_runs  # pyright: ignore[reportMissingImports]

    from skincal.ranges import preset
    from skincal.train import begin, train

    if not (place / "out").exists():
        begin(small_runs.work(), preset("iros24"), place / "out")
    train(place / "out", small_runs.make, 2 * small_runs.CHECKPOINT_STEPS)


VERBS = {
    verb.name: verb
    for verb in (
        Verb("export-dr", _verb("export-dr", "cal", "--out", "out.toml"), ("out.toml",), prepare=_calibration),
        Verb("hand keys", _verb("hand", "keys"), look=_names),
        Verb("import", _verb("import", "csv", "map.toml", "p.csv"), prepare=_recording),
        Verb(
            "predict",
            _verb("predict", "cal", "data"),
            prepare=_both,
        ),
        Verb("dataset show", _verb("dataset", "show", "data", "--out", "out.png"), ("out.png",), prepare=_session),
        Verb("audit", _audit),
        Verb("fit", _fit),
        Verb("diagnose", _diagnosis),
        Verb("eval", _evaluation),
        Verb(
            "deploy",
            _verb("deploy", "marble", "marble-tactile-1", "--trajectory", "still", "--duration-s", "0.5"),
            look=_rolled,
        ),
        Verb(
            "collect --plan-only",
            _verb("collect", "--plan", "plan.toml", "--plan-only"),
            ("out-plan.toml", "out-plan.png"),
            prepare=lambda folder: write_plan(PLAN, folder / "plan.toml"),
        ),
        Verb(
            "collect",
            _verb("collect", "--driver", "sim", "--seed", "5", "--plan", "plan.toml"),
            look=_collected,
            prepare=lambda folder: write_plan(PLAN, folder / "plan.toml"),
        ),
        Verb(
            "collect with a stage",
            _verb("collect", "--driver", "skincal.hand.stage_sim:StageSim", "--plan", "plan.toml"),
            look=_collected,
            prepare=lambda folder: write_plan(PLAN, folder / "plan.toml"),
        ),
        Verb("train", _train, look=_trained, partial=True),
    )
}  # fmt: skip

WAYS = {"new": (False, True), "replaced": (True, True), "replaced by two moves": (True, False)}
"""Whether there is an earlier output, and whether the kernel can exchange two names."""

GOING_ON = ("collect", "collect with a stage", "train")
CASES = [(verb, way) for verb in VERBS for way in WAYS if way == "new" or verb not in GOING_ON]
"""Sessions and runs go on in place of beginning again; what replaces them is written as all else."""


def make_study(folder: Path, verb: str, way: str) -> Study:
    if verb in ("hand keys", "train"):
        pytest.importorskip("zmq" if verb == "hand keys" else "stable_baselines3")
    typer.main.get_command(app)  # built here, and not in every fork
    return Study(VERBS[verb], folder / "study", *WAYS[way])


@pytest.mark.parametrize("verb", ["export-dr", "import", "fit", "eval"])
def test_a_kill_loses_nothing(tmp_path: Path, verb: str) -> None:
    """The last moves, and two events before."""
    study = make_study(tmp_path, verb, "replaced")
    for at in (study.events // 3, 2 * study.events // 3, study.events - 2):
        study.kill(at)


@pytest.mark.parametrize(("verb", "way"), [("export-dr", "new"), ("eval", "replaced")])
def test_an_interrupt_leaves_nothing(tmp_path: Path, verb: str, way: str) -> None:
    """At every write event, those of cleaning up among them."""
    study = make_study(tmp_path, verb, way)
    for at in range(1, study.events + 1):
        study.interrupt(at)


@pytest.mark.slow
@pytest.mark.parametrize(("verb", "way"), CASES)
def test_no_kill_loses_anything(tmp_path: Path, verb: str, way: str) -> None:
    """At every write event."""
    study = make_study(tmp_path, verb, way)
    for at in range(1, study.events + 1):
        study.kill(at)
    print(f"{verb}, {way}: {study.events} kills")
