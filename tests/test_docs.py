"""The documentation matches the program: commands, options, columns, codes, defaults."""

from __future__ import annotations

import ast
import math
import re
import shlex
from pathlib import Path
from types import ModuleType
from typing import Any

import pytest
import typer

from skincal.cli.main import app
from skincal.covariates import TIMES
from skincal.dataset.columns import OPTIONAL
from skincal.diagnosis import session_findings
from skincal.effects import EFFECTS
from skincal.fitting import fit_findings
from skincal.fitting.fit_options import FitOptions, GridSteps
from skincal.fitting.places import MOST
from skincal.fitting.sigmas import FIELD_PART, FORCE_SIGMA, GAIN_SIGMA, MISFIT, SPREADS
from skincal.inference.constants import CONSTANTS
from skincal.inference.twins import LAWS

ROOT = Path(__file__).parent.parent
PAGES = [
    ROOT / "README.md",
    *sorted((ROOT / "docs").glob("*.md")),
    *sorted((ROOT / "docs" / "method").glob("*.md")),
]


def commands() -> list[tuple[str, str]]:
    """Every line of a page that is a command of skincal, with the page's name."""
    found = []
    for page in PAGES:
        for block in re.findall(
            r"```(?:console|\{console\})\n(.*?)```", page.read_text(encoding="utf-8"), re.S
        ):
            lines = [line.removeprefix("$ ") for line in block.splitlines()]
            found += [(page.name, line) for line in lines if line.startswith("skincal ")]
    return found


def verb(words: list[str]) -> tuple[Any, list[str]]:
    """The command that words on the command line name, and the words after it."""
    command: Any = typer.main.get_command(app)
    while hasattr(command, "commands"):
        command, words = command.commands[words[0]], words[1:]
    return command, words


def test_there_are_commands():
    assert len(commands()) > 10


@pytest.mark.parametrize(("page", "line"), commands())
def test_command_exists_with_its_options(page: str, line: str):
    words = shlex.split(re.split(r"&&|\|", line)[0], comments=True)
    command, rest = verb(words[1:])
    known = {option for p in command.params for option in (*p.opts, *p.secondary_opts)} | {
        "--help",
        "--debug",
    }
    assert {word for word in rest if word.startswith("--")} <= known, page


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.name)
def test_pictures_exist(page: Path):
    for picture in re.findall(r"!\[[^]]*\]\(([^)]+)\)", page.read_text(encoding="utf-8")):
        assert (page.parent / picture).is_file()


def test_files_page_names_every_column():
    text = (ROOT / "docs" / "files.md").read_text(encoding="utf-8")
    assert [name for name in (*OPTIONAL, *TIMES) if f"`{name}`" not in text] == []


@pytest.mark.parametrize(("module", "made"), [(fit_findings, "FitFinding"), (session_findings, "Finding")])
def test_files_page_names_every_finding(module: ModuleType, made: str):
    tree = ast.parse(Path(str(module.__file__)).read_text(encoding="utf-8"))
    codes = [
        ast.literal_eval(call.args[0])
        for call in ast.walk(tree)
        if isinstance(call, ast.Call) and isinstance(call.func, ast.Name) and call.func.id == made
        if isinstance(call.args[0], ast.Constant)
    ]
    text = (ROOT / "docs" / "files.md").read_text(encoding="utf-8")
    assert codes
    assert [code for code in codes if f"`{code}`" not in text] == []


def test_fit_page_tells_the_defaults():
    text = " ".join((ROOT / "docs" / "method" / "fit.md").read_text(encoding="utf-8").split())
    options = FitOptions()
    steps = GridSteps()
    assert f"$\\sigma_p$ round `[position] sigma_m` (factor $e^{{{SPREADS[0]:g}}}$)" in text
    assert set(SPREADS[[1, 5]]) == {1.0} and SPREADS[3] == SPREADS[4]
    grown = f"$\\tau$ round {100 * MISFIT:g} % and $\\sigma_g$ round {100 * GAIN_SIGMA:g} %"
    assert f"{grown} (factor $e^{{{SPREADS[3]:g}}}$)" in text
    assert f"$\\sigma_b$ round {100 * FIELD_PART:g} % of `sigma_m` (factor $e$)" in text
    assert f"$\\sigma_f$ round {100 * FORCE_SIGMA:g} % (factor $e$)" in text
    assert f"round the scatter of untouched taxels (factor $e^{{{SPREADS[2]:g}}}$)" in text
    assert MOST == 6
    assert "up to six are kept" in text
    assert f"the central {100 * options.level:g} % of its draws" in text
    assert f"Each round draws {options.round_size} points" in text
    assert (
        f"worth {options.enough_draws} independent ones, after {options.rounds[0]} rounds at least and"
        in text
    )
    assert f"{options.rounds[1]} at most" in text
    assert f"Gaussians of up to {1e3 * options.law_spreads_m[-1]:g} mm" in text
    assert f"steps of {1e3 * steps.across_m:g} mm of arc, {1e3 * steps.y_m:g} mm in $y$" in text
    assert f"{math.degrees(steps.alpha_rad):g}° in $\\alpha$, and {steps.elasticities} values of $E$" in text


def test_pages_count_the_effects() -> None:
    places = {
        "README.md": "{} in all",
        "docs/diagnose.md": "missing among {} {{doc}}`effects/index`",
        "docs/audit.md": "all {} effects",
    }
    for page, words in places.items():
        assert words.format(len(EFFECTS)) in (ROOT / page).read_text(encoding="utf-8"), page


def test_the_trust_page_says_what_a_p_value_is_made_of() -> None:
    text = (ROOT / "docs" / "trust.md").read_text()
    assert f"With {CONSTANTS.null_sessions} such sessions" in text
    assert f"1/{CONSTANTS.null_sessions + 1} (`--thorough`: 1/{5 * CONSTANTS.null_sessions + 1})" in text
    assert f"the null's {100 * CONSTANTS.null_quantile:g} % quantile by a quarter" in text
    assert CONSTANTS.limit_factor == 1.25
    assert f"gain {CONSTANTS.least_gain:g} nats" in text
    layers = [f"{1e3 * thick:g}" for thick in LAWS["layer"]]
    assert f"elastic layers of {layers[0]}, {layers[1]} and {layers[2]} mm" in text


def test_architecture_names_files_that_exist() -> None:
    text = (ROOT / "docs" / "architecture.md").read_text(encoding="utf-8")
    named = set(re.findall(r"`([a-z_]+(?:/[a-z_]+)*\.py)`", text))
    assert len(named) > 100
    missing = [f for f in named if not ((ROOT / "skincal" / f).exists() or (ROOT / f).exists())]
    assert not missing
    places = re.findall(r"`(\w+)` (?:of|in) `([a-z_]+(?:/[a-z_]+)*\.py)`", text)
    assert len(places) > 20
    files = {f: ROOT / "skincal" / f if (ROOT / "skincal" / f).exists() else ROOT / f for _, f in places}
    gone = [(name, f) for name, f in places if not re.search(rf"\b{name}\b", files[f].read_text("utf-8"))]
    assert not gone
