"""What a person should know of a fit, said in words, with what to do."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numpy as np
from scipy.stats import binom

from skincal.fitting.problem import FEW_PRESSES
from skincal.fitting.result import FEWEST_DRAWS, FitFinding, FitResult
from skincal.fitting.valley import POSE, at_one_place, extent_m

BENT = 0.4
"""A smooth error of positions of this part of the independent one widens alpha by a tenth and more."""

MOST_NAMED = 6
"""Taxels that a finding names."""

AT_BOUND = 0.01
"""Part of the presses that lies beyond a bound of two and a half sigmas, as a bound should be at least."""

_NAMES = {
    "across_m": "position across (beta)",
    "y_m": "y",
    "alpha_rad": "alpha",
    "elasticity_pa_per_m": "elasticity E",
    "scale_per_n": "scale S",
}


def find(result: FitResult, *, dropped: int) -> FitResult:
    """The result with its findings.

    Args:
        result: a fit.
        dropped: how many presses were left out as glitches.
    """
    checks = (_edges, _flat, _presses, _spread, _rig, _misfit, _taxels, _lost, _rest, _sampling)
    found = [finding for check in checks for finding in check(result)]
    if dropped:
        found.append(
            FitFinding(
                "glitches",
                "warning",
                f"{dropped} presses do not fit with the others and were left out.",
                "Look at them in the report; repeat them if the hand slipped.",
            )
        )
    return replace(result, findings=tuple(found))


def _edges(result: FitResult) -> Iterator[FitFinding]:
    for name in ("across_m", "y_m", "alpha_rad", "elasticity_pa_per_m"):
        low, high = getattr(result.box, name)
        margin = 0.02 * (high - low)
        interval = result.intervals[name]
        if high <= low or not np.isfinite(interval).all():
            continue
        at_low, at_high = interval[0] <= low + margin, interval[1] >= high - margin
        if at_low or at_high:
            side = "both ends" if at_low and at_high else "the lower end" if at_low else "the upper end"
            yield FitFinding(
                "range_edge",
                "warning",
                f"The interval of {_NAMES[name]} reaches {side} of the searched range: the truth may lie outside.",
                "Widen the range (dataset.toml [mount], or the range options of the command).",
            )


def _flat(result: FitResult) -> Iterator[FitFinding]:
    if not result.told:  # that is said once, of all parameters
        return
    said = POSE if at_one_place(result.problem) else ()
    for name, interval in result.intervals.items():
        if not np.isfinite(interval).all() and name not in said:
            yield FitFinding(
                "not_identified",
                "warning",
                f"The data do not tell {_NAMES[name]}: its valley does not close within the searched range.",
                "Press at more places and with more forces, with an indenter smaller than the patch.",
            )


def _presses(result: FitResult) -> Iterator[FitFinding]:
    problem, used = result.problem, len(result.problem)
    advice = f"Collect until at least {2 * FEW_PRESSES} presses have two active taxels or more"
    if not problem.determined:
        yield FitFinding(
            "too_few_presses",
            "warning",
            f"The {used} presses that could be used do not tell the parameters: they give {problem.readings} readings "
            f"for {problem.unknowns} unknowns (five parameters, and two coordinates of every press). The best point is "
            "one of many that match them as well, so no interval is given.",
            f"Do not use this calibration. {advice}, spread over the patch.",
        )
    elif used < FEW_PRESSES:
        yield FitFinding(
            "few_presses",
            "warning",
            f"Only {used} presses could be used; intervals from so few are rough.",
            f"{advice}.",
        )


def _spread(result: FitResult) -> Iterator[FitFinding]:
    if at_one_place(result.problem):
        yield FitFinding(
            "one_place",
            "warning",
            f"All presses lie within {1e3 * extent_m(result.problem):.1f} mm of each other: turn and position of the "
            "sensor cannot be told apart, so they have no interval.",
            "Spread the presses over the whole patch.",
        )


def _rig(result: FitResult) -> Iterator[FitFinding]:
    declared, found = result.problem.rig.position_sigma_m, result.sigmas.position_m
    if np.isfinite(declared) and found > 1.5 * declared:
        yield FitFinding(
            "positions_worse",
            "warning",
            f"Contact positions scatter by {1e3 * found:.2f} mm, more than the {1e3 * declared:.2f} mm declared.",
            "Check the kinematic calibration; raise [position] sigma_m and slack_m.",
        )
    field = result.sigmas.field_m
    if field > BENT * found and result.bound == "noise":
        yield FitFinding(
            "positions_bent",
            "info",
            "The error of the measured positions changes smoothly with place, force or posture, by about "
            f"{1e3 * field:.2f} mm. Its turn cannot be told from alpha; the intervals are widened for it.",
            "Calibrate the kinematics (joint offsets) for a sharper alpha.",
        )
    slack, at_bound = result.problem.rig.slack_m, 0
    if slack > 0:
        at_bound = int((np.abs(result.presses.slack_m).max(axis=1) > 0.98 * slack).sum())
    if at_bound > max(1, binom.isf(0.01, len(result.problem), AT_BOUND)):
        yield FitFinding(
            "slack_too_tight",
            "warning",
            f"{at_bound} of {len(result.problem)} presses sit at the bound of their slack ({1e3 * slack:.1f} mm): the "
            "rig is further off than the bound allows, and the pose is then told too sharply.",
            "Raise [position] slack_m to three times what the rig can be off, a constant error included.",
        )
    if result.force_low > 0.03:
        yield FitFinding(
            "force_scatter",
            "warning",
            f"Forces scatter by {100 * result.sigmas.force:.1f} % against what the images tell.",
            "Check the torque sensors' zero. `skincal diagnose` looks for a bias that depends on the pose.",
        )


def _misfit(result: FitResult) -> Iterator[FitFinding]:
    floor, found = result.problem.noise_sigma_counts, result.sigmas.noise_counts
    bad = int((~result.presses.good).sum())
    if found > 3.0 * floor:
        yield FitFinding(
            "misfit",
            "warning",
            f"Images differ by {found:.2f} counts where noise explains {floor:.2f}: the base model lacks something.",
            "The intervals are widened for it. `skincal diagnose` looks for what is missing.",
        )
    if bad:
        yield FitFinding(
            "bad_presses",
            "info",
            f"{bad} of {len(result.problem)} presses are matched clearly worse than the rest.",
            "They are marked red in the report.",
        )
    if result.bound == "fixed" and not result.grid.in_valley.any():
        yield FitFinding(
            "empty_valley",
            "warning",
            f"No combination of the grid comes below the bound of {result.valley_mse_counts2:g} counts²; the least "
            f"loss there is {float(result.grid.mse_counts2.min()):.3g} counts².",
            "Leave the bound out, so that it follows the noise of the data. A finer grid seldom helps: on the grid, "
            "presses are placed by normalised images, which leaves more than the noise.",
        )


def _taxels(result: FitResult) -> Iterator[FitFinding]:
    cols = result.problem.rig.layout.cols
    for j in np.flatnonzero(result.dead_taxels):
        yield FitFinding(
            "dead_taxel",
            "warning",
            f"Taxel ({j // cols}, {j % cols}) does not answer where it is pressed; it was left out.",
            "Check its wiring.",
        )


def _lost(result: FitResult) -> Iterator[FitFinding]:
    problem = result.problem
    lost = problem.observation.read & ~problem.used & ~result.dead_taxels
    if lost.any():
        yield FitFinding(
            "lost_readings",
            "info",
            f"{lost.sum()} readings of {lost.any(axis=1).sum()} presses are far below what the rest of their images "
            "agrees on, and were left out: a taxel dropped out there.",
            "Look at the connection of the sensor; read each taxel again where it fails.",
        )


def _rest(result: FitResult) -> Iterator[FitFinding]:
    problem = result.problem
    doubtful = ~problem.observed.level_known & problem.lit.any(axis=0)
    # A level that a bound of the converter or a subtraction tells, or that taxels share, needs no presses to tell it.
    doubtful &= problem.shared.level_sigma > problem.noise_sigma_counts
    if doubtful.any():
        cols = problem.rig.layout.cols
        names = ", ".join(f"({j // cols}, {j % cols})" for j in np.flatnonzero(doubtful)[:MOST_NAMED])
        more = f" and {doubtful.sum() - MOST_NAMED} more" if doubtful.sum() > MOST_NAMED else ""
        yield FitFinding(
            "rest_in_doubt",
            "warning",
            f"No press leaves taxel {names}{more} alone, so its level at rest is not seen; it is estimated along with "
            "the other parameters, from how far the levels of the others lie apart.",
            "Record frames at rest (phase idle), or press at places that leave it alone.",
        )


def _sampling(result: FitResult) -> Iterator[FitFinding]:
    if result.bound == "fixed" or result.effective_draws >= 100:
        return
    rough = result.effective_draws >= FEWEST_DRAWS
    found = max(1, round(result.effective_draws))
    yield FitFinding(
        "few_draws",
        "warning",
        f"The draws from the valley are worth only {found} independent one{'s' if found > 1 else ''}: "
        + (
            "intervals are approximate."
            if rough
            else "they do not tell how wide it is, so no interval is given."
        ),
        "The parameters have more than one answer that fits; more presses, spread over the patch, tell them apart.",
    )
