"""The command line as a whole: fast help, an example for every verb, exit statuses, JSON."""

from __future__ import annotations

import asyncio
import importlib.util
import inspect
import json
import os
import resource
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from types import UnionType
from typing import Any, get_args, get_type_hints

import numpy as np
import pytest
import typer
from commands import Run

from skincal.cli.main import app, main
from skincal.cli.options import Pair
from skincal.cli.terminal import answer, print_json, say, table
from skincal.progress import progress, stage_bars
from skincal.version import __version__

SLOW = ("numpy", "pandas", "pyarrow", "matplotlib", "scipy", "trimesh", "nlopt", "jinja2")


def verbs(command: Any, path: tuple[str, ...] = ()) -> Iterator[tuple[tuple[str, ...], Any]]:
    """Every verb, and every group of verbs: a person who asks a group for help is shown an example too."""
    yield path, command
    for name, child in getattr(command, "commands", {}).items():
        yield from verbs(child, (*path, name))


VERBS = dict(verbs(typer.main.get_command(app)))


def _children_cpu_s() -> float:
    used = resource.getrusage(resource.RUSAGE_CHILDREN)
    return used.ru_utime + used.ru_stime


def test_help_comes_in_half_a_second() -> None:
    # Processor time, not the clock on the wall: other tests run beside this one.
    times: list[float] = []
    while min(times, default=1.0) >= 0.5 and len(times) < 3:
        start = _children_cpu_s()
        done = subprocess.run([sys.executable, "-m", "skincal", "--help"], capture_output=True, check=True)
        times.append(_children_cpu_s() - start)
        assert b"dataset" in done.stdout
    assert min(times) < 0.5


def test_help_imports_nothing_heavy() -> None:
    code = "import sys; from skincal.cli.main import main\ntry: main(['fit', '--help'])\nfinally: print(*sys.modules)"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert not {name.split(".")[0] for name in done.stdout.splitlines()[-1].split()} & {*SLOW, "rich"}


@pytest.mark.parametrize("path", [(), ("dataset",), ("import",), ("hand",)], ids=" ".join)
def test_no_line_of_the_list_of_verbs_is_cut(path: tuple[str, ...], run: Run) -> None:
    commands = run(*path, "--help")[1].partition("Commands:")[2]
    assert commands
    assert "..." not in commands


@pytest.mark.parametrize("path", VERBS, ids=" ".join)
def test_every_verb_has_an_example_and_help(path: tuple[str, ...], run: Run) -> None:
    status, out, _ = run(*path, "--help")
    shown = " ".join(out.split())
    assert status == 0 and "Example" in shown
    assert f"skincal {' '.join(path)}" in shown.split("Example", 1)[1]
    for parameter in VERBS[path].params:
        if parameter.param_type_name == "option":
            assert parameter.help, f"{' '.join(path)} {parameter.name} has no help"


def test_version(run: Run) -> None:
    assert run("--version") == (0, f"skincal {__version__}\n", "")


def test_a_shell_completes_verbs(run: Run, monkeypatch: pytest.MonkeyPatch) -> None:
    for name, value in (
        ("_SKINCAL_COMPLETE", "complete_bash"),
        ("COMP_WORDS", "skincal di"),
        ("COMP_CWORD", "1"),
    ):
        monkeypatch.setenv(name, value)
    assert run()[1].split() == ["diagnose"]


@pytest.mark.parametrize(
    "arguments", [["nonsense"], ["dataset", "chek"], ["dataset", "check"], ["dataset", "check", "--no"]]
)
def test_a_wrong_command_line_is_status_two(arguments: list[str], run: Run) -> None:
    status, out, err = run(*arguments)
    assert (status, out) == (2, "") and "Traceback" not in err


CHATTY = """
import atexit, os
from skincal.hand.stage_sim import StageSim

print("imported")
atexit.register(print, "the process ends")

class Chatty(StageSim):
    def connect(self):
        super().connect()
        print("connected")
        os.write(1, b"a library writes to the descriptor\\n")
"""


def test_standard_output_is_json_whatever_a_driver_prints(tmp_path: Path) -> None:
    (tmp_path / "chatty.py").write_text(CHATTY)
    command = ["hand", "test", "chatty:Chatty", "--no-move", "--json"]
    done = subprocess.run(
        [sys.executable, "-m", "skincal", *command], cwd=tmp_path, capture_output=True, text=True, check=False
    )
    assert json.loads(done.stdout)["ok"], done.stderr
    assert all(text in done.stderr for text in ("imported", "connected", "a library writes", "process ends"))


@pytest.mark.parametrize("words", ["fit d --out o --workers", "train marble --out o --seed"])
def test_numbers_beyond_the_bounds_of_an_option(words: str, run: Run) -> None:
    status, _, err = run(*words.split(), 1000000000000)
    assert status == 2 and "Invalid value" in err


def numeric_options() -> Iterator[Any]:
    """Yield every option of every verb that takes numbers: the verb, the option, and how many numbers."""
    for path, command in VERBS.items():
        if hasattr(command, "commands"):
            continue
        hints = get_type_hints(inspect.unwrap(command.callback))
        for parameter in command.params:
            kind = hints.get(parameter.name)
            kinds = get_args(kind) if isinstance(kind, UnionType) else (kind,)
            if {int, float, Pair}.intersection(kinds):
                option = parameter.opts[0]
                yield pytest.param([*path, option], 2 if Pair in kinds else 1, id=" ".join([*path, option]))


@pytest.mark.parametrize(("words", "count"), [*numeric_options()])
def test_every_numeric_option_is_bounded(words: list[str], count: int, run: Run) -> None:
    for number in ("nan", "inf", "-inf", "1e308", "1e40", "9" * 30, "9" * 5000):
        status, _, err = run(*words, *[number] * count)
        assert status == 2, number
        assert f"Invalid value for '{words[-1]}'" in err, number


@pytest.mark.parametrize(
    "words",
    [
        ["collect", "--out", "o", "--effect", "hysteresis={}"],
        ["collect", "--out", "o", "--driver-option", "effects=hysteresis={}"],
        ["collect", "--out", "o", "--driver-option", "start_s={}"],
        ["collect", "--out", "o", "--driver-option", "seed={}"],
        ["deploy", "marble", "marble-desired-1", "--out", "o", "--effect", "hysteresis={}"],
        ["deploy", "marble", "marble-desired-1", "--out", "o", "--driver-option", "orientation_deg={}"],
        ["eval", "marble", "marble-desired-1", "--set", "object.marble.mass_kg={}"],
        ["eval", "marble", "marble-desired-1", "--environment", "duration_s={}"],
        ["hand", "test", "sim", "--driver-option", "indenter_radius_m={}"],
        ["hand", "test", "remote", "--driver-option", "silence_s={}"],
        ["fit", "DATA", "--out", "o", "--bound", "{}"],
    ],
    ids=lambda words: words[-1],
)
def test_numbers_within_texts_are_bounded(
    words: list[str], run: Run, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    data = Path("data/paper-like").resolve()
    monkeypatch.chdir(tmp_path)
    for number in ("nan", "inf", "1e308", "9" * 400, "x"):
        given = (word.format(number).replace("DATA", str(data)) for word in words)
        status, out, err = run(*given)
        assert (status, out) == (2, ""), number
        assert "expected" in err
        assert not [*tmp_path.iterdir()]


@pytest.mark.parametrize("more", ["", "--json"])
def test_a_standard_output_that_is_closed(more: str) -> None:
    command = f"{sys.executable} -m skincal hand show {more} >&-"
    done = subprocess.run(["sh", "-c", command], capture_output=True, text=True, check=False)
    assert done.stderr == "" and not done.returncode


def test_error_stays_off_stdout_when_stderr_is_closed() -> None:
    command = f"{sys.executable} -m skincal hand list --no-such-option --json 2>&-"
    done = subprocess.run(["sh", "-c", command], capture_output=True, text=True, check=False)
    assert done.stdout == "" and done.returncode == 2


def test_a_figure_needs_no_backend_of_the_environment(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("MPLBACKEND", "no such backend")
    with pytest.raises(SystemExit):
        main(["--version"])
    assert os.environ["MPLBACKEND"] == "agg"


def test_json_is_one_object_that_any_reader_takes(capsys: pytest.CaptureFixture[str]) -> None:
    print_json(
        {
            "a": np.array([1.5, np.nan, np.inf]),
            "b": np.int64(3),
            "c": (np.bool_(True), None, "ü"),
            "d": {"e": -np.inf, "f": {1}},
        }
    )
    text = capsys.readouterr().out
    assert text.count("\n") == 1
    told = {"a": [1.5, None, None], "b": 3, "c": [True, None, "ü"], "d": {"e": None, "f": [1]}}
    assert json.loads(text) == told


def test_a_name_does_not_command_the_terminal(capsys: pytest.CaptureFixture[str]) -> None:
    say("\x1b]0;gone\x07.toml:\n\tÄ\x9b")
    assert capsys.readouterr().err == "\\x1b]0;gone\\x07.toml:\n\tÄ\\x9b\n"


def test_progress_leaves_standard_output_alone(capsys: pytest.CaptureFixture[str]) -> None:
    with progress() as bars:
        for _ in bars.track(range(3), description="work"):
            pass
    assert capsys.readouterr() == ("", "")


def test_without_a_terminal_each_stage_is_a_line(capsys: pytest.CaptureFixture[str]) -> None:
    with stage_bars() as update:
        for done in range(3):
            update("grid", done, 2)
        update("draws", 0, 1)
    assert capsys.readouterr() == ("", "grid\ndraws\n")


def test_numbers_of_a_table_stay_on_one_line(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setenv("COLUMNS", "20")
    answer(False, {}, table(("policy", "error\nsettled"), [("tactile", "0.41 (0.37 … 0.47)")], right=True))
    assert "0.41 (0.37 … 0.47)" in capsys.readouterr().out


def test_of_many_mistakes_some_are_shown(tmp_path: Path, run: Run) -> None:
    plan = tmp_path / "plan.csv"
    plan.write_text("u_m,v_m,force_n\n" + "0,0,hard\n" * 40)
    status, _, err = run("audit", plan)
    lines = err.splitlines()
    assert status == 2
    assert len(lines) == 12 and "[line 2] force_n" in lines[0]
    assert lines[-1] == "… and 29 more; --debug shows all of them"


def test_settings_of_numba_in_the_working_folder_are_refused(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, run: Run
) -> None:
    """They say where compiled code is loaded from, and may come with a dataset."""
    (tmp_path / ".numba_config.yaml").write_text("cache_dir: ./code\n")
    monkeypatch.chdir(tmp_path)
    status, _, err = run("hand", "list")
    assert status == 2 and "numba" in err


@pytest.mark.parametrize(
    ("raised", "said"),
    [
        (asyncio.CancelledError("of a driver's library"), "CancelledError"),
        (SystemExit(0), "SystemExit"),
        # As where memory is limited.
        (
            ImportError("x.so: failed to map segment", name="x"),
            "a library cannot be loaded: x.so: failed to map segment",
        ),
    ],
    ids=repr,
)
def test_any_exception_ends_without_a_traceback(
    raised: BaseException, said: str, monkeypatch: pytest.MonkeyPatch, run: Run
) -> None:
    def fail(**_: object) -> None:
        raise raised

    monkeypatch.setattr("skincal.cli.main.app", fail)
    status, _, err = run("hand", "list")
    assert status == 1 and said in err and "Traceback" not in err


@pytest.mark.parametrize(
    "arguments", [["--help"], ["hand", "show", "dlr_hand_2"], ["hand", "list", "--json"]]
)
def test_a_reader_that_is_gone(arguments: list[str]):
    """As ``head`` or ``less`` after its end: nothing is said, as nobody asks any more."""
    read, write = os.pipe()
    os.close(read)
    command = [sys.executable, "-m", "skincal", *arguments]
    done = subprocess.run(command, stdout=write, stderr=subprocess.PIPE, text=True, check=False)
    os.close(write)
    assert (done.returncode, done.stderr) == (1, "")


def test_a_umask_that_takes_the_owners_rights(tmp_path: Path):
    """Nothing is left over that its owner cannot remove."""
    code = "import os; os.umask(0o777); from skincal.cli.main import main; main(['hand', 'keys', '--out', 'keys'])"
    subprocess.run([sys.executable, "-P", "-c", code], cwd=tmp_path, capture_output=True, check=True)
    assert (tmp_path / "keys").stat().st_mode & 0o777 == 0o700
    assert [path.name for path in tmp_path.iterdir()] == ["keys"]


def test_a_working_folder_that_is_gone(tmp_path: Path):
    code = "import os; os.rmdir(os.getcwd()); from skincal.cli.main import main; main(['hand', 'list'])"
    here = tmp_path / "here"
    here.mkdir()
    command = [sys.executable, "-P", "-c", code]
    done = subprocess.run(command, cwd=here, capture_output=True, text=True, check=False)
    assert done.returncode == 2
    assert "the working folder: expected one that exists; got a removed one" in done.stderr


SOURCE = Path(__file__).parents[2] / "docs" / "_ext" / "verbs.py"


@pytest.mark.skipif(not SOURCE.exists(), reason="the documentation's source is not here")
def test_every_verb_on_the_page_has_its_examples():
    pytest.importorskip("sphinx")
    spec = importlib.util.spec_from_file_location("reference_of_verbs", SOURCE)
    assert spec is not None and spec.loader is not None
    page = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(page)
    listed = list(page.verbs(typer.main.get_command(app)))
    assert len(listed) > 10
    for name, command in listed:
        assert any(line.startswith("$ skincal ") for line in page.described(name, command)), name
