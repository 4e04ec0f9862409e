"""Does it pay to find an effect? ``python -m benchmarks.proof --out DIR --from RUN [--steps 40000] [--seeds 2]``.

A simulated hand has an effect hidden in its skin. It is calibrated (`collect`, `fit`) and diagnosed (`diagnose`), and
policies are trained over three kinds of ranges: (a) those of the calibration, (b) those of the calibration with what
`diagnose` has named, (c) those of the truth. All of them, and the policy that training went on from, then run on
reference hands with that same skin, everything else drawn, through the driver and the guard, in both engines: the same
hands for all. The table gives error and drops, what (a) loses to (c), and how much of it (b) recovers.

Everything is kept in DIR, and what is there is not done again: the command goes on where it was interrupted, and with
more steps, runs, seeds or effects it adds to what there is. ``--from RUN`` goes on from a training run with its critics
and its memory; ``--from none`` trains from scratch.
"""

from __future__ import annotations

import argparse
import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from skincal.calibration import read_calibration
from skincal.cli.main import main as skincal
from skincal.deploy.trials import reference_runs
from skincal.errors import WorkError
from skincal.ranges import Parameter, Ranges, from_calibration, preset, write_ranges
from skincal.train import Task, policy_path, read_policy
from skincal.train.evaluate import Trial
from skincal.train.scores import settled_m
from skincal.train.training_run import CHECKPOINT, MARKER, POLICY

FloatArray = NDArray[np.float64]

EFFECTS = ("latency=2", "spread=2", "response_curve=2")
"""One with memory, one between taxels, one of transfer; each of those costs a policy something (`effects_cost`)."""
VARIANTS = {"a": "base", "b": "after", "c": "truth"}
BLOCK = 5
"""Runs that are kept together."""
FIRST_SEED = 4000
"""Of the hands that policies are judged on."""


def run(*arguments: str | Path) -> None:
    """Run a command of skincal in this process.

    Raises:
        WorkError: it failed.
    """
    texts = [str(one) for one in arguments]
    print("$ skincal", *texts, flush=True)
    try:
        skincal(texts)
    except SystemExit as end:
        if end.code not in (0, None):
            raise WorkError(f"skincal {texts[0]} ended with status {end.code}") from end


def calibrate(folder: Path, effect: str, seed: int) -> None:
    """Collect on a simulated hand with a hidden effect, fit, and diagnose."""
    folder.mkdir(parents=True, exist_ok=True)
    data, base, after = (folder / name for name in ("data", "base", "after"))
    if not data.exists():
        hidden = ("--effect", effect, "--truth", folder / "truth.json")
        run("collect", "--driver", "sim", "--seed", str(seed), "--protocol", "full", *hidden, "--out", data)
    if not base.exists():
        run("fit", data, "--out", base, "--seed", str(seed))
    if not after.exists():
        run("diagnose", data, base, "--out", after, "--seed", str(seed))


def true_ranges(truth: dict[str, Any]) -> Ranges:
    """The published ranges, with the skin as it is."""
    skin = {f"skin.{name}": value for name, value in truth["model"].items()}
    for effect in truth["effects"]:
        skin |= {f"skin.effects.{effect['name']}.{k}": v for k, v in effect["parameters"].items()}
    known = {name: Parameter.constant(_plain(value)) for name, value in skin.items()}
    return preset("iros24").replace(known)


def _plain(value: Any) -> Any:
    return float(value) if np.ndim(value) == 0 else tuple(np.ravel(value).tolist())


def ranges_of(folder: Path, variant: str) -> Ranges:
    """The ranges that a variant is trained over."""
    if variant == "c":
        return true_ranges(json.loads((folder / "truth.json").read_text(encoding="utf-8")))
    calibration = read_calibration(folder / VARIANTS[variant])
    return from_calibration(calibration, joint=calibration.draws is not None)


def named(folder: Path) -> list[str]:
    """What `diagnose` has added."""
    before = [effect.name for effect in read_calibration(folder / "base").effects]
    return [e.name for e in read_calibration(folder / "after").effects if e.name not in before]


def train(folder: Path, variant: str, seed: int, asked: argparse.Namespace) -> Path:
    """Train a variant's policy, or go on with it; return its file."""
    out, file = folder / f"policy-{variant}", folder / f"ranges-{variant}.toml"
    if not file.exists():
        write_ranges(ranges_of(folder, variant), file)
    policy = out / "policy.onnx"
    if policy.exists() and read_policy(policy).description.steps >= asked.steps:
        return policy
    if (out / MARKER).exists() and (out / CHECKPOINT).exists():
        run("train", "marble", "--out", out, "--steps", str(asked.steps), "--resume")
        return policy
    start = () if asked.start == "none" else ("--from", asked.start)
    how = ("--backend", asked.backend, "--engine", asked.train_engine, "--seed", str(seed), "--force")
    run("train", "marble", *start, "--ranges", file, "--steps", str(asked.steps), *how, "--out", out)
    return policy


class Kept:
    """Results on disk, by key.

    Args:
        path: the file.
    """

    def __init__(self, path: Path) -> None:
        self._path = path
        self.values: dict[str, Any] = json.loads(path.read_text(encoding="utf-8")) if path.exists() else {}

    def runs(
        self, key: str, file: str | Path, ranges: Ranges, engine: str, count: int
    ) -> list[dict[str, Any]]:
        """Runs of a policy on hidden hands; those that are missing are made."""
        policy = read_policy(policy_path(file))
        found: list[dict[str, Any]] = []
        for block in range(-(-count // BLOCK)):
            name = f"{key} {policy.description.steps} {engine} {block}"
            if name not in self.values:
                trial = Trial(Task.marble, episodes=BLOCK, seed=FIRST_SEED + block)
                runs = reference_runs(policy, trial, ranges=ranges, engine=engine)
                errors = [float(v) if np.isfinite(v) else None for v in settled_m(runs)]
                self.values[name] = {"error_m": errors, "dropped": runs.dropped.tolist()}
                self._path.write_text(json.dumps(self.values, indent=0) + "\n", encoding="utf-8")
            one = self.values[name]
            pairs = zip(one["error_m"], one["dropped"], strict=True)
            found += [{"error_m": np.nan if e is None else e, "dropped": d} for e, d in pairs]
        return found[:count]


def interval(values: FloatArray) -> tuple[float, float, float]:
    """Mean and its 95 % interval (bootstrap), in mm."""
    values = values[np.isfinite(values)]
    if not values.size:
        return np.nan, np.nan, np.nan
    means = np.random.default_rng(0).choice(values, (2000, len(values))).mean(axis=1)
    low, high = np.quantile(means, [0.025, 0.975])
    return 1e3 * float(values.mean()), 1e3 * float(low), 1e3 * float(high)


def tell(name: str, engine: str, found: dict[str, list[dict[str, Any]]]) -> str:
    """A row of the table."""
    errors = {variant: np.array([one["error_m"] for one in runs]) for variant, runs in found.items()}
    cells = [
        "{:.2f} ({:.2f} to {:.2f}), {} of {}".format(
            *interval(errors[variant]), sum(bool(one["dropped"]) for one in runs), len(runs)
        )
        for variant, runs in found.items()
    ]
    lost, low, high = interval(errors["a"] - errors["c"])
    won = interval(errors["a"] - errors["b"])[0]
    recovered = f"{won / lost:.0%}" if low > 0 else "–"
    return (
        f"| {name} | {engine} | {' | '.join(cells)} | {lost:+.2f} ({low:+.2f} to {high:+.2f}) | {recovered} |"
    )


def main(arguments: Sequence[str] | None = None) -> None:
    """Do all of it, and print the table."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--out", type=Path, required=True, help="folder for everything")
    parser.add_argument("--effects", nargs="+", default=EFFECTS, metavar="NAME=STRENGTH")
    parser.add_argument("--seeds", type=int, default=2, help="hidden hands, each with its own trainings")
    parser.add_argument("--first-seed", type=int, default=1)
    parser.add_argument("--steps", type=int, default=40_000, help="of each training")
    parser.add_argument(
        "--from", dest="start", required=True, help="training run or policy to go on from, or none"
    )
    parser.add_argument("--backend", default="sb3", choices=("sb3", "sbx"))
    parser.add_argument("--train-engine", default="pybullet", choices=("pybullet", "mujoco"))
    parser.add_argument("--engines", nargs="+", default=("pybullet", "mujoco"))
    parser.add_argument("--runs", type=int, default=100, help="of each policy in each engine")
    asked = parser.parse_args(arguments)
    asked.out.mkdir(parents=True, exist_ok=True)
    kept = Kept(asked.out / "runs.json")
    rows: list[str] = []
    for effect in asked.effects:
        for seed in range(asked.first_seed, asked.first_seed + asked.seeds):
            folder = asked.out / f"{effect.replace('=', '-')}-{seed}"
            calibrate(folder, effect, seed)
            truth, added = ranges_of(folder, "c"), named(folder)
            before = Path(asked.start) / POLICY if Path(asked.start).is_dir() else asked.start
            policies: dict[str, str | Path] = {} if asked.start == "none" else {"before": before}
            policies |= {variant: train(folder, variant, seed, asked) for variant in VARIANTS}
            for engine in asked.engines:
                found = {
                    variant: kept.runs(f"{folder.name} {variant}", file, truth, engine, asked.runs)
                    for variant, file in policies.items()
                }
                name = f"`{effect}`, hand {seed} (named: {', '.join(added) or 'nothing'})"
                rows.append(tell(name, engine, found))
    variants = " | ".join(("before", *VARIANTS) if asked.start != "none" else VARIANTS)
    print(f"\nError from 2 s on [mm] with its 95 % interval, drops; {asked.steps} steps of training each.\n")
    print(f"| hidden | engine | {variants} | a − c [mm] | recovered by b |")
    print("|---" * (len(variants.split("|")) + 4) + "|")
    print("\n".join(rows))


if __name__ == "__main__":
    main()
