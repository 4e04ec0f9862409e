"""No verb replaces what it did not write, or what it reads; a missing input leaves nothing behind."""

from __future__ import annotations

import shutil
from pathlib import Path

import pytest
from calibrations import make_calibration
from commands import Run

from skincal.calibration import write_calibration
from skincal.dataset import write_dataset
from tests.conftest import make_session

PLAN = "u_m,v_m,force_n\n0,0,2\n"
VERBS = {
    "dataset show": "dataset show session --out out.png",
    "audit": "audit session --calibration cal --out out",
    "fit": "fit session --effects cal --out out",
    "predict": "predict cal session --out out",
    "diagnose": "diagnose session cal --out out",
    "export-dr": "export-dr cal --out out.toml",
    "collect": "collect --plan plan.csv --out out",
    "collect --plan-only": "collect --plan plan.csv --plan-only --out out",
    "train": "train marble --out out",
    "eval": "eval marble marble-desired-1 --calibration cal --out out",
    "deploy": "deploy marble marble-desired-1 --trajectory path.csv --out out",
    "rescale": "rescale cal session --out out",
    "hand keys": "hand keys --out out",
}
INPUTS = ("session", "cal", "plan.csv")


@pytest.fixture(scope="module")
def inputs(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with a dataset, a calibration and a plan."""
    path = tmp_path_factory.mktemp("inputs")
    write_dataset(make_session(), path / "session")
    write_calibration(make_calibration(), path / "cal")
    (path / "plan.csv").write_text(PLAN)
    return path


@pytest.fixture(autouse=True)
def here(inputs: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A working folder with copies of them."""
    shutil.copytree(inputs, tmp_path, dirs_exist_ok=True)
    monkeypatch.chdir(tmp_path)
    return tmp_path


def content(folder: Path) -> dict[str, bytes]:
    return {str(p.relative_to(folder)): p.read_bytes() for p in folder.rglob("*") if p.is_file()}


@pytest.mark.parametrize("force", ["", " --force"])
@pytest.mark.parametrize("verb", VERBS)
def test_others_work_stays(here: Path, verb: str, force: str, run: Run) -> None:
    if verb == "train":
        pytest.importorskip("stable_baselines3", reason="needs skincal[train]")
    out = here / VERBS[verb].split("--out ")[1]
    mine = out.with_name("out-plan.toml") if "--plan-only" in verb else out
    if mine.suffix:
        mine.write_text("mine")
    else:
        mine.mkdir()
        (mine / "thesis.tex").write_text("mine")
    before = content(here)
    status, shown, err = run(*f"{VERBS[verb]}{force}".split())
    assert (status, shown) == (2, "") and mine.name in err and "Traceback" not in err
    assert force or "--force" in err
    assert content(here) == before


FOLDERS = [verb for verb, line in VERBS.items() if line.endswith(" out") and "--plan-only" not in line]


@pytest.mark.parametrize(
    ("verb", "one"), [(verb, one) for verb in FOLDERS for one in INPUTS if one in VERBS[verb].split()]
)
def test_inputs_are_not_replaced(here: Path, verb: str, one: str, run: Run) -> None:
    before = content(here)
    for same in (one, f"session/../{one}"):
        line = f"{VERBS[verb].removesuffix(' out')} {same} --force"
        status, shown, err = run(*line.split())
        assert (status, shown) == (2, "") and "an output that is not an input" in err
        assert content(here) == before


@pytest.mark.parametrize("verb", [verb for verb, line in VERBS.items() if {*INPUTS} & {*line.split()}])
def test_missing_input_leaves_nothing(here: Path, verb: str, run: Run) -> None:
    line = VERBS[verb]
    for one in INPUTS:
        line = line.replace(f" {one} ", " nowhere ")
    before = content(here)
    status, shown, err = run(*line.split())
    assert (status, shown) == (2, "") and "nowhere" in err and "Traceback" not in err
    assert content(here) == before
