"""Cost of the fit's grid in a plain implementation of the paper's method.

    python benchmarks/plain_fit.py [--presses 2] [--rounds 3] [--json]

The plain method evaluates a combination of pose and elasticity by nlopt over the contact position of every press,
with an image for every step of it: a ray from each of the 14 884 tactile points through trimesh's location query, and
a search of the penetration in steps of 0.1 mm (Kasolowsky & Baeuml, IROS 2024, sections II-B and III-B). nlopt starts
once, at the measured position, without derivatives, and stops at 10 µm: the least that can be called a search. Only a
few presses at one combination are measured; what all presses of all combinations of the default grid would take is
extrapolated from them. Ours are measured on whole combinations: the general way (nlopt on skincal's own model) at
one, the fast way (tables and Gauss-Newton) on one turn of the default grid, tables included.

All on one core, in turns; medians over the rounds of the processor time used.
"""

# ruff: noqa: E402 - the number of threads is read when numpy is imported
from __future__ import annotations

import os

for _threads in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "VECLIB_MAXIMUM_THREADS"):
    os.environ[_threads] = "1"

import argparse
import json
import sys
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import nlopt
import numpy as np

from benchmarks.model_speed import ELASTICITY_PA_PER_M, PlainSkin, ball_mesh, cpu_model, one_core, seconds
from benchmarks.sessions import make_session
from skincal.calibrate import Way, fit_problem, search_box
from skincal.fitting import grid
from skincal.fitting.fit_options import FitOptions
from skincal.fitting.general import evaluate_pose, micro_objective
from skincal.fitting.general_skin import SkinShares
from skincal.fitting.grid import MacroGrid, MicroSettings
from skincal.fitting.problem import FitProblem
from skincal.fitting.solve import micro_settings, plan_grid
from skincal.model import Contacts, Patch, SensorPose

PRESSES = 24
TOLERANCE_M = 1e-5


@dataclass(frozen=True)
class Setting:
    """One session, seen by every way, and the combination at which it is evaluated."""

    general: FitProblem
    fast: FitProblem
    macro_grid: MacroGrid
    settings: MicroSettings
    macro: np.ndarray


def make_setting(seed: int) -> Setting:
    """A session of the paper's size: the first 24 presses that can be used."""
    session, truth = make_session(np.random.default_rng(seed), presses=90)
    general, fast = (fit_problem(session, FitOptions(), Way(method)) for method in ("nlopt", "fast"))
    keep = np.arange(len(fast)) < PRESSES
    general, fast = (p.subset(keep, "one too many") for p in (general, fast))
    assert len(fast) == PRESSES
    grid = plan_grid(fast, search_box(session), FitOptions())
    told = truth.as_positions_tell
    arc = np.radians(told.beta_deg) * (fast.rig.arc_radius_m or 0.0)
    macro = np.array([arc, told.y_m, np.radians(told.alpha_deg), np.log(ELASTICITY_PA_PER_M)])
    return Setting(general, fast, grid, micro_settings(fast), macro)


class PlainMicro:
    """The micro problem of a press, with images made the paper's way."""

    def __init__(self, setting: Setting, *, every_hit: bool) -> None:
        self.problem, self.settings = setting.general, setting.settings
        rig = self.problem.rig
        across, y, alpha = setting.macro[:3]
        pose = SensorPose(y, alpha, beta_rad=across / (rig.arc_radius_m or 1.0))
        self.skin = PlainSkin(Patch.build(rig.surface, rig.layout, pose), ball_mesh(), every_hit=every_hit)
        self.images = 0

    def solve(self, press: int) -> float:
        """The objective at the position that nlopt finds."""
        problem, weight = self.problem, self.problem.weight[press]
        assert problem.contacts is not None
        contacts = problem.contacts

        def objective(slack_mm: np.ndarray, _gradient: np.ndarray) -> float:
            slack = np.asarray(slack_mm)[None] * 1e-3
            points, normals = contacts.at(problem.rows[[press]], slack)
            image, _ = self.skin.image(Contacts(points, normals, problem.force_n[[press]]), 0)
            self.images += 1
            observed = problem.values[[press]] * weight
            return float(micro_objective(observed, image[None] * weight, slack, self.settings)[0])

        solver = nlopt.opt(nlopt.LN_BOBYQA, 2)
        bound = 1e3 * self.settings.slack_m
        solver.set_lower_bounds(-bound)
        solver.set_upper_bounds(bound)
        solver.set_min_objective(objective)
        solver.set_xtol_abs(1e3 * TOLERANCE_M)
        solver.optimize(np.zeros(2))
        return float(solver.last_optimum_value())


class Counting(SkinShares):
    """The skin model, with a count of the images that are asked of it."""

    images = 0

    def shares(self, press: Any, slack_m: Any, log_ratio: Any) -> Any:
        """See :meth:`SkinShares.shares`."""
        self.images += len(press)
        return super().shares(press, slack_m, log_ratio)


def images_a_press(setting: Setting) -> float:
    """Count the images a press that the general solver makes at the combination."""
    skin = Counting(setting.general, *setting.macro[:3])
    evaluate_pose(setting.general, skin, setting.macro[3:], setting.settings)
    return skin.images / PRESSES


def run(presses: int, rounds: int, seed: int) -> dict[str, Any]:
    """Times a combination [s] of every way, and what the default grid would take [h]."""
    setting = make_setting(seed)
    plain, first = (PlainMicro(setting, every_hit=flag) for flag in (True, False))
    some = np.linspace(0, PRESSES - 1, presses).astype(int)
    turn = int(np.argmin(np.abs(setting.macro_grid.alpha_rad - setting.macro[2])))
    in_a_turn = setting.macro_grid.combinations // len(setting.macro_grid.alpha_rad)
    share = presses / PRESSES
    ways: dict[str, tuple[Callable[[], object], float]] = {
        "the paper's, plainly": (lambda: [plain.solve(k) for k in some], share),
        "the same, first hits only": (lambda: [first.solve(k) for k in some], share),
        "skincal, general way": (
            lambda: evaluate_pose(
                setting.general,
                SkinShares(setting.general, *setting.macro[:3]),
                setting.macro[3:],
                setting.settings,
            ),
            1.0,
        ),
        "skincal, fast way": (
            lambda: grid.evaluate_slab(setting.fast, setting.macro_grid, turn, setting.settings),
            in_a_turn,
        ),
    }
    times: dict[str, list[float]] = {name: [] for name in ways}
    for _ in range(rounds):
        for name, (work, combinations) in ways.items():
            times[name].append(seconds(work) / combinations)
    each = {name: float(np.median(values)) for name, values in times.items()}
    fast, total = each["skincal, fast way"], setting.macro_grid.combinations
    return {
        "cpu": cpu_model(),
        "presses": PRESSES,
        "presses_measured_plainly": presses,
        "images_a_press_plainly": plain.images / (rounds * presses),
        "images_a_press_general_way": images_a_press(setting),
        "combinations_of_the_default_grid": total,
        "ways": {
            name: {
                "seconds_a_combination": one,
                "hours_for_the_default_grid_on_one_core": one * total / 3600,
                "times_the_fast_way": one / fast,
            }
            for name, one in each.items()
        },
    }


def show(result: dict[str, Any]) -> None:
    print(
        f"{result['cpu']}, one core; {result['presses']} presses, {result['combinations_of_the_default_grid']} "
        f"combinations in the default grid.\nThe plain method is measured on {result['presses_measured_plainly']} "
        f"presses of one combination ({result['images_a_press_plainly']:.0f} images a press), the rest extrapolated.\n"
        f"The general way looks at many more places: {result['images_a_press_general_way']:.0f} images a press.\n"
    )
    print(f"{'':28}{'a combination':>16}{'the default grid':>20}{'of the fast way':>18}")
    for name, way in result["ways"].items():
        hours = way["hours_for_the_default_grid_on_one_core"]
        grid_time = f"{hours:.1f} h" if hours > 1 else f"{3600 * hours:.0f} s"
        one = 1e3 * way["seconds_a_combination"]
        print(f"{name:28}{one:13.2f} ms{grid_time:>20}{way['times_the_fast_way']:16.0f} x")


def main() -> int:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--presses", type=int, default=2, help="presses measured by the plain method")
    parser.add_argument("--rounds", type=int, default=3, help="how often each way is measured")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--json", action="store_true", help="print one JSON object and nothing else")
    arguments = parser.parse_args()
    one_core()
    result = run(arguments.presses, arguments.rounds, arguments.seed)
    if arguments.json:
        print(json.dumps(result, indent=2))
    else:
        show(result)
    return 0


if __name__ == "__main__":
    sys.exit(main())
