"""``skincal demo``: the main job, end to end, on the simulated hand.

Runs the verbs as a person would, and ends with a summary of the results. A second session uses a skin with an effect
that no fit includes: the diagnosis finds it, names it and adds it, and the gap shrinks. The hand is simulated, so the
true parameters are known and the results can be checked.
"""

from __future__ import annotations

import json
import shutil
import subprocess
import sys
import time
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from skincal.cli.common import example
from skincal.errors import InputError, Problem
from skincal.files.manifest import strangers, write_manifest

if TYPE_CHECKING:
    from collections.abc import Iterable

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


def demo(
    out: Annotated[
        Path, typer.Option("--out", help="Folder to write; an earlier demonstration is replaced.")
    ] = Path("demo"),
) -> None:
    """Run the main job on a simulated hand: collect, fit, find what is missing, export ranges, try a policy.

    Takes some minutes. The last step needs `skincal[policy]`; without it, the rest runs.
    """
    make_room(out)
    try:
        _show(out)
    finally:
        write_manifest(out)


def make_room(out: Path) -> None:
    """Remove an earlier demonstration, and nothing else.

    Raises:
        InputError: the folder holds something else.
    """
    if out.exists():
        others = strangers(out) if out.is_dir() else [out.name]
        if others:
            got = ", ".join(others[:5]) + (" and more" if len(others) > 5 else "")
            raise InputError(
                [
                    Problem(
                        f"--out {out}", "no folder, or an earlier demonstration", got, "Give another folder."
                    )
                ]
            )
        shutil.rmtree(out)
    out.mkdir(parents=True)


def _show(out: Path) -> None:
    began = time.monotonic()
    run, cal, truth = (str(out / name) for name in ("run", "cal", "truth.json"))
    collect = ("collect", "--driver", "sim", "--seed", SEED, "--protocol", "paper")
    skincal(*collect, "--out", run, "--truth", truth)
    skincal("dataset", "show", run, "--out", str(out / "presses.png"))
    fitted = json.loads(skincal("fit", run, "--out", cal, "--json", quiet=True))
    skincal("predict", cal, run, "--out", str(out / "predicted"), "--slack", "--json", quiet=True)
    skincal("export-dr", str(out / "cal"), "--out", str(out / "ranges.toml"))
    policy = _installed(("gymnasium", "onnxruntime"))
    if policy:
        skin = ("--ranges", str(out / "ranges.toml"), "--seed", SEED)
        skincal("eval", "marble", POLICY, *skin, "--episodes", "20", "--out", str(out / "evaluation"))
    else:
        print("\nNo policy was run; it needs: pip install 'skincal[policy]'")
    gap = close_a_gap(out)
    story(fitted, out, time.monotonic() - began, policy=policy)
    gap_story(gap, out)


def _installed(packages: Iterable[str]) -> bool:
    from importlib.util import find_spec

    return all(find_spec(name) is not None for name in packages)


def close_a_gap(out: Path) -> dict[str, Any]:
    """Collect a second session from a skin with an effect that no fit includes, fit it coarsely, and diagnose it."""
    run, cal, closed = (str(out / name) for name in ("gap", "gap-cal", "gap-closed"))
    hidden = ("--effect", HIDDEN, "--truth", str(out / "gap-truth.json"))
    from skincal.sample import sample_path

    plan = str(sample_path("short-plan.toml"))
    skincal("collect", "--driver", "sim", "--seed", SEED, "--plan", plan, *hidden, "--out", run)
    coarse = ("--y-step-mm", "0.5", "--alpha-step-deg", "5", "--e-count", "12", "--no-report")
    skincal("fit", run, "--out", cal, *coarse, "--json", quiet=True)
    found = json.loads(skincal("diagnose", run, cal, "--out", closed, "--json", quiet=True))
    skincal("export-dr", closed, "--out", str(out / "gap-ranges.toml"), "--json", quiet=True)
    return found


def skincal(*arguments: str, quiet: bool = False) -> str:
    """Run one command of skincal; exit when it fails."""
    print(f"\n$ skincal {' '.join(arguments)}", flush=True)
    command = [sys.executable, "-m", "skincal", *arguments]
    done = subprocess.run(command, stdout=subprocess.PIPE if quiet else None, text=True, check=False)
    if done.returncode:
        sys.exit(done.returncode)
    return done.stdout or ""


def story(fitted: dict[str, Any], out: Path, seconds: float, *, policy: bool) -> None:
    """Print the results of the fit next to the true values."""
    hidden = json.loads((out / "truth.json").read_text(encoding="utf-8"))
    truth: dict[str, float] = hidden["model"] | hidden["session"]["truth_as_the_positions_tell_it"]
    print(f"\nWhat happened, in {seconds:.0f} s\n")
    print(
        f"The simulated hand pressed its skin 60 times. {fitted['presses_used']} presses touched two taxels or more "
        "and were fitted.\nAt the best point the simulated images differ from the measured ones by "
        f"{fitted['loss_mse_counts2'] ** 0.5:.2f} counts (root mean\nsquare per taxel).\n"
    )
    print(f"{'':8}{'best':>10}{'interval':>24}{'truth':>10}")
    for name, (label, factor, unit) in UNITS.items():
        low, high = fitted["intervals"][name]
        span = f"[{low * factor:.4g}, {high * factor:.4g}]"
        inside = low <= truth[name] <= high
        note = "" if inside else "   outside"
        best = fitted["best"][name] * factor
        print(f"{label:8}{best:>10.4g}{span:>24}{truth[name] * factor:>10.4g} {unit}{note}")
    off = hidden["session"]["constant_position_error_m"]
    across, along = (f"{1e3 * off[name]:.1f} mm" for name in ("across", "along"))
    print(
        "\nThe joint sensors have constant errors, as on a real hand: measured positions are off by\n"
        f"{across} around the finger and {along} along it. The fit explains this as a sensor that sits\n"
        "elsewhere, which suits a policy on this hand: it uses the same joint sensors. The true values of\n"
        "y and beta shown here include that error. The force scale is known to 1 %, which the\n"
        "intervals of E and S include.\n"
    )
    print(f"report    {out / 'cal' / 'report.html'}")
    print(f"ranges    {out / 'ranges.toml'}")
    print(f"presses   {out / 'presses.png'}")
    if policy:
        print(f"policy    {out / 'evaluation'}: a bundled policy rolls a marble on the calibrated skin")


def gap_story(found: dict[str, Any], out: Path) -> None:
    """Print the hidden effect of the second session, the diagnosis, and the gap before and after."""
    from skincal.effects import EFFECTS

    name, strength = HIDDEN.split("=")
    hidden = json.loads((out / "gap-truth.json").read_text(encoding="utf-8"))["effects"]
    sizes = ", ".join(f"{key} {value:.3g}" for key, value in hidden[0]["parameters"].items())
    print("\nA skin with an effect that the model lacks\n")
    print(f"Hidden:   {name}, {strength} times a typical case: {sizes}")
    print(f"Verdict:  {found['verdict']}")
    for effect in found["effects"]:
        numbers = ", ".join(f"{key} {_plain(value)}" for key, value in effect["parameters"].items())
        print(f"Named:    {' or '.join(effect['consistent_with'])} (p = {effect['p_value']:.2g}): {numbers}")
        if EFFECTS[effect["name"]].in_places:
            print("          This hand always has it: its position errors depend on the posture.")
    print(f"Where:    {found['where']}\n")
    gap = found["gap"]
    before = gap["heldout_rmse_before"]
    print(f"Error on {gap['presses']} held-out test presses, counts rms per taxel:")
    for label, key in (
        ("before", "heldout_rmse_before"),
        ("after", "heldout_rmse_after"),
        ("noise", "noise_floor_rmse"),
    ):
        print(f"{label:8}{gap[key]:7.3f}  {'#' * round(60 * gap[key] / before)}")
    if gap["closed"] is not None:
        low, high = gap["closed_interval"]
        print(f"{100 * gap['closed']:.0f} % of the gap is closed ({100 * low:.0f} to {100 * high:.0f} %).")
    print(f"\nreport    {out / 'gap-closed' / 'report.html'}")
    print(f"ranges    {out / 'gap-ranges.toml'}")


def _plain(value: Any) -> str:
    return f"{value:.3g}" if isinstance(value, int | float) else f"{len(value)} values"
