"""``skincal demo``: the main job, end to end, on the simulated hand.

Runs the verbs as a person would, and ends with a summary of the results. A second session uses a skin with an effect
that no fit includes: the diagnosis finds it, names it and adds it, and the gap shrinks. The hand is simulated, so the
true parameters are known and the results can be checked.
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
import time
from importlib.util import find_spec
from pathlib import Path
from typing import Annotated, Any

import typer

from skincal.cli.options import example, option
from skincal.errors import WorkError

EPILOG = example("skincal demo --out demo")

SEED = "7"
HIDDEN = "hysteresis=1"
POLICY = "marble-tactile-1"

UNITS = {
    "y_m": ("y", 1e3, "mm"),
    "beta_deg": ("beta", 1.0, "°"),
    "alpha_deg": ("alpha", 1.0, "°"),
    "elasticity_pa_per_m": ("E", 1e-6, "MPa/m"),
    "scale_per_n": ("S", 1.0, "counts/N"),
}


SESSIONS = ("run", "gap")
FITS = ("cal", "gap-cal")
FOLDERS = (*SESSIONS, *FITS, "predicted", "evaluation", "gap-closed")
FILES = ("truth.json", "presses.png", "ranges.toml", "gap-truth.json", "gap-ranges.toml")
"""What a demonstration writes; listed before it is there, so that one that was killed can be replaced."""

MARKER = "demo.txt"
"""File that identifies a demonstration: other outputs of skincal, such as a session, are never replaced by one."""


def demo(
    out: Annotated[Path, option("Folder to write; an earlier demonstration is replaced.")] = Path("demo"),
) -> None:
    """Run the main job on a simulated hand: collect, fit, find what is missing, export ranges, try a policy.

    Takes some minutes. The last step needs `skincal[policy]`; without it, the rest runs.
    """
    from skincal.files import alone

    make_room(out)
    with alone(out / MARKER, out) as lock:
        os.set_inheritable(lock, True)  # a verb that outlives this process keeps the folder locked
        _show(out)


def make_room(out: Path) -> None:
    """Remove an earlier demonstration, however it ended, and nothing else.

    Raises:
        InputError: the folder holds something else.
    """
    from skincal.files import alone, whole_folder
    from skincal.files.manifest import NAME

    if (out / MARKER).is_file() and not out.is_symlink():
        from skincal.calibrate.checkpoint import Checkpoint, checkpoint_folder
        from skincal.collect import discard_session

        with alone(out / MARKER, out):
            for name in SESSIONS:
                discard_session(out / name)
            for name in FITS:
                Checkpoint(checkpoint_folder(out / name), "").remove()
    later = [*FILES, *(f"{name}/{NAME}" for name in FOLDERS)]
    with whole_folder(out, force=True, marker=MARKER, later=later) as room:
        (room / MARKER).write_text("Made by skincal demo, which replaces this folder.\n", encoding="utf-8")


def _show(out: Path) -> None:
    began = time.monotonic()
    run, cal, truth = (str(out / name) for name in ("run", "cal", "truth.json"))
    collect = ("collect", "--driver", "sim", "--seed", SEED, "--protocol", "paper")
    skincal(*collect, "--out", run, "--truth", truth)
    skincal("dataset", "show", run, "--out", str(out / "presses.png"))
    fitted = json.loads(skincal("fit", run, "--out", cal, "--json", quiet=True))
    skincal("predict", cal, run, "--out", str(out / "predicted"), "--slack", "--json", quiet=True)
    skincal("export-dr", str(out / "cal"), "--out", str(out / "ranges.toml"))
    policy = all(find_spec(name) is not None for name in ("gymnasium", "onnxruntime"))
    if policy:
        skin = ("--ranges", str(out / "ranges.toml"), "--seed", SEED)
        skincal("eval", "marble", POLICY, *skin, "--episodes", "20", "--out", str(out / "evaluation"))
    else:
        print("\nNo policy was run; it needs: pip install 'skincal[policy]'")
    gap = close_a_gap(out)
    print(story(fitted, gap, out, time.monotonic() - began, policy=policy))


def close_a_gap(out: Path) -> dict[str, Any]:
    """Collect a second session from a skin with an effect that no fit includes, fit it coarsely, and diagnose it."""
    run, cal, closed = (str(out / name) for name in ("gap", "gap-cal", "gap-closed"))
    hidden = ("--effect", HIDDEN, "--truth", str(out / "gap-truth.json"))
    plan = str(sample_path("short-plan.toml"))
    skincal("collect", "--driver", "sim", "--seed", SEED, "--plan", plan, *hidden, "--out", run)
    coarse = ("--y-step-mm", "0.5", "--alpha-step-deg", "5", "--e-count", "12", "--no-report")
    skincal("fit", run, "--out", cal, *coarse, "--json", quiet=True)
    found = json.loads(skincal("diagnose", run, cal, "--out", closed, "--json", quiet=True))
    skincal("export-dr", closed, "--out", str(out / "gap-ranges.toml"), "--json", quiet=True)
    return found


def sample_path(name: str) -> Path:
    """Path of a sample: the dataset ``paper-like``, or the plan ``short-plan.toml``.

    Raises:
        WorkError: the installation lacks it.
    """
    here = Path(__file__).parents[1]
    for folder in (here / "sample_data", here.parent / "data"):
        if (folder / name).exists():
            return folder / name
    raise WorkError(
        f"sample {name}: expected it in the installed package; got nothing. Install skincal again."
    )


def skincal(*arguments: str, quiet: bool = False) -> str:
    """Run one command of skincal; exit when it fails."""
    print(f"\n$ skincal {' '.join(arguments)}", flush=True)
    command = [sys.executable, "-m", "skincal", *arguments]
    stdout = subprocess.PIPE if quiet else None
    done = subprocess.run(command, stdout=stdout, text=True, check=False, close_fds=False)
    if done.returncode:
        raise typer.Exit(done.returncode)  # the verb has said why
    return done.stdout or ""


def story(fitted: dict[str, Any], gap: dict[str, Any], out: Path, seconds: float, *, policy: bool) -> str:
    """Return the results next to the hidden truth, for a person."""
    from skincal.diagnosis.diagnosis import SENTENCES
    from skincal.effects import EFFECTS
    from skincal.report.page import rendered

    truth, gap_truth = (
        json.loads((out / name).read_text(encoding="utf-8")) for name in ("truth.json", "gap-truth.json")
    )
    true = truth["model"] | truth["session"]["truth_as_the_positions_tell_it"]
    parameters = [
        (label, *(factor * x for x in (fitted["best"][name], *fitted["intervals"][name], true[name])), unit)
        for name, (label, factor, unit) in UNITS.items()
    ]
    name, strength = HIDDEN.split("=")
    return rendered(
        "demo.txt", fitted=fitted, gap=gap, out=out, seconds=seconds, policy=policy, parameters=parameters,
        off=truth["session"]["constant_position_error_m"], hidden=name, strength=strength,
        verdict=SENTENCES[gap["verdict"]], sizes=gap_truth["effects"][0]["parameters"],
        position_effects=[effect.name for effect in EFFECTS.values() if effect.in_places],
    )  # fmt: skip
