"""The main job, end to end, on the bundled dataset: ``make demo``, or ``python -m data.demo --out FOLDER``.

Runs the verbs as a person would, and ends with a short story of what they found. The dataset is synthetic, so its
truth is known and the story can be checked.
"""

from __future__ import annotations

import argparse
import json
import shutil
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

import numpy as np

ROOT = Path(__file__).resolve().parents[1]
SAMPLE = ROOT / "data" / "paper-like"

UNITS = {
    "y_m": ("y", 1e3, "mm"),
    "beta_deg": ("beta", 1.0, "°"),
    "alpha_deg": ("alpha", 1.0, "°"),
    "elasticity_pa_per_m": ("E", 1e-6, "MPa/m"),
    "scale_per_n": ("S", 1.0, "counts/N"),
}


def main() -> None:
    """Runs the demonstration."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument(
        "--out", type=Path, default=Path("demo"), help="folder to write; an earlier demo is replaced"
    )
    out: Path = parser.parse_args().out
    if out.exists() and not (out / ".skincal-demo").is_file():
        parser.exit(2, f"{out} exists and is not an earlier demo; give another --out\n")
    shutil.rmtree(out, ignore_errors=True)
    out.mkdir(parents=True)
    (out / ".skincal-demo").touch()
    began = time.monotonic()
    skincal("dataset", "show", str(SAMPLE), "--out", str(out / "presses.png"))
    fitted = json.loads(skincal("fit", str(SAMPLE), "--out", str(out / "cal"), "--json", quiet=True))
    skincal(
        "predict",
        str(out / "cal"),
        str(SAMPLE),
        "--out",
        str(out / "predicted"),
        "--slack",
        "--json",
        quiet=True,
    )
    skincal("export-dr", str(out / "cal"), "--out", str(out / "ranges.toml"))
    story(fitted, out, time.monotonic() - began)


def skincal(*arguments: str, quiet: bool = False) -> str:
    """Runs one command of skincal; ends the demonstration when it fails."""
    print(f"\n$ skincal {' '.join(arguments)}", flush=True)
    command = [sys.executable, "-m", "skincal", *arguments]
    done = subprocess.run(command, stdout=subprocess.PIPE if quiet else None, text=True, check=False)
    if done.returncode:
        sys.exit(done.returncode)
    return done.stdout or ""


def story(fitted: dict[str, Any], out: Path, seconds: float) -> None:
    """Prints what was found, against the truth."""
    truth = known_truth()
    print(f"\nWhat happened, in {seconds:.0f} s\n")
    print(
        f"Of 60 presses {fitted['presses_used']} touched two taxels or more and were fitted. At the best point the\n"
        f"simulated images differ from the measured ones by {np.sqrt(fitted['loss_mse_counts2']):.2f} counts (root "
        "mean square per taxel).\n"
    )
    print(f"{'':8}{'best':>10}{'interval':>24}{'truth':>10}")
    for name, (label, factor, unit) in UNITS.items():
        low, high = fitted["intervals"][name]
        inside = "" if low <= truth[name] <= high else "   outside"
        span = f"[{low * factor:.4g}, {high * factor:.4g}]"
        print(
            f"{label:8}{fitted['best'][name] * factor:>10.4g}{span:>24}{truth[name] * factor:>10.4g} {unit}{inside}"
        )
    print(
        "\nThe data are synthetic, so the truth is known (y and beta as the measured positions tell them; see\n"
        "data/README.md). On a real hand it is not, and the interval is what you train over.\n"
    )
    print(f"report    {out / 'cal' / 'report.html'}")
    print(f"ranges    {out / 'ranges.toml'}")
    print(f"presses   {out / 'presses.png'}")


def known_truth() -> dict[str, float]:
    """What the bundled dataset was made with, from the script that made it."""
    sys.path.insert(0, str(ROOT))
    from benchmarks.sessions import make_session
    from data.make_sample import POSITION_SIGMA_M, SEED

    _, truth = make_session(np.random.default_rng(SEED), position_sigma_m=POSITION_SIGMA_M)
    told = truth.as_positions_tell
    values: dict[str, float] = truth.plain() | {"y_m": told.y_m, "beta_deg": told.beta_deg}
    return values


if __name__ == "__main__":
    main()
