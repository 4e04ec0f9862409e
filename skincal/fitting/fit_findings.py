"""Findings of a fit: what the user should know, with advice."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numpy as np
from scipy.special import bdtrc, ndtr

from skincal.fitting.problem import FEW_PRESSES
from skincal.fitting.result import FEWEST_DRAWS, POSE, FitFinding, FitResult, at_one_place, extent_m
from skincal.fitting.sigmas import MISFIT
from skincal.model import FlatPunch, Plane

BENT = 0.4
"""A smooth position error of this fraction of the independent one widens alpha by a tenth or more."""

AT_BOUND = 0.01
"""Fraction of presses beyond a bound of two and a half sigmas, the least a bound should be."""

FORCES_OFF = 0.03
"""Relative scatter of forces from which it is reported."""

BENDS, CHANCE = 0.25, 1e-3
"""Fraction of the variance of the force errors (one half of their scatter) that the force must explain to report
a nonlinear response, and the probability of such a correlation by chance."""

MISFIT_TIMES = 3.0
"""Ratio of the residual to the expected one from which a misfit is reported; set by eye. The ratio to the noise
alone is 1.3 at most in 20 sessions with nothing hidden, elastic layers and noise that grows with load among
them; 4 in one with dropped readings, and 15 to 26 with a crosstalk of 3 to 8 %."""

MISFIT_PART = 0.05
"""Misfit relative to the signal from which it is reported, if the noise of weak signals hides it from the ratio
above; set by eye. In six blind sessions with nothing hidden it is 0.2 % at most, and 3 % where noise grows by
3 % of the signal; 3 to 15 % where two effects are hidden, or one that the catalogue does not have."""

NONLINEAR_NATS = 8.0
"""Log evidence over the linear response from which a nonlinear one is reported: odds of 1 to 600, with five
candidates. With a linear response it was 3.2 at most in 41 sessions of the foundation, and 6.8 in 18 on
elastic layers."""

SPREAD_NATS = 10.0
"""Log evidence over no spread from which the widest spread of the contact law is reported: odds of 1 to 20000.
It is 3 at most in sessions of the foundation, and the widest is not the best on elastic layers of 1 to 2.5
mm."""

_NAMES = {
    "across_m": "position across (beta, on a plane x)",
    "y_m": "y",
    "alpha_rad": "alpha",
    "elasticity_pa_per_m": "elasticity E",
    "scale_per_n": "scale S",
}
"""Names of the parameters in messages."""

_CHECK_FIRST = {
    "elasticity_pa_per_m": "Check the unit of the forces and the radius of the indenter: E grows with both. "
}
"""What to check before the range of a parameter is widened."""

_LIKE_A_DEPTH = 1.25
"""Power of the measured force, from which it may be a depth: half-way between 1 and that of a ball on a half-space,
3/2; on a foundation it is 2."""


def add_findings(result: FitResult, *, dropped: int) -> FitResult:
    """Return the result with its findings; ``dropped`` is the number of outlier presses."""
    checks = (
        _check_edges,
        _check_identified,
        _check_press_count,
        _check_press_spread,
        _check_rig,
        _check_misfit,
        _check_dead_taxels,
        _check_dropped_readings,
        _check_rest_levels,
        _check_sampling,
    )
    found = [finding for check in checks for finding in check(result)]
    if dropped:
        text = f"{dropped} presses are outliers and were left out."
        found.append(_warn("glitches", text, "Look at them in the report; repeat them if the hand slipped."))
    return replace(result, findings=tuple(found))


def _warn(code: str, text: str, advice: str) -> FitFinding:
    """Return a warning."""
    return FitFinding(code, "warning", text, advice)


def _check_edges(result: FitResult) -> Iterator[FitFinding]:
    """Warn of intervals that reach an end of the searched range."""
    for name in ("across_m", "y_m", "alpha_rad", "elasticity_pa_per_m"):
        low, high = getattr(result.box, name)
        margin = 0.02 * (high - low)
        interval = result.intervals[name]
        if high <= low or not np.isfinite(interval).all():
            continue
        at_low, at_high = interval[0] <= low + margin, interval[1] >= high - margin
        if at_low or at_high:
            side = "both ends" if at_low and at_high else "the lower end" if at_low else "the upper end"
            yield _warn(
                "range_edge",
                f"The interval of {_NAMES[name]} reaches {side} of the searched range: the truth may lie outside.",
                _CHECK_FIRST.get(name, "")
                + "Widen the range (dataset.toml [mount], or the range options of the command).",
            )


def _check_identified(result: FitResult) -> Iterator[FitFinding]:
    """Warn of parameters that the data do not determine."""
    if not result.gives_intervals:  # another finding says so, for all parameters
        return
    said = POSE if at_one_place(result.problem) else ()
    rig = result.problem.rig
    # The pressure below a flat punch on a plane is even, however stiff the skin is.
    flat = isinstance(rig.surface, Plane) and all(isinstance(one, FlatPunch) for one in rig.indenters)
    for name, interval in result.intervals.items():
        if not np.isfinite(interval).all() and name not in said:
            advice = (
                "Widen that range if you do not know it so well. Press at more places and with more forces, with an "
                "indenter smaller than the patch."
            )
            if flat and name == "elasticity_pa_per_m":
                advice = (
                    "A flat punch on a plane does not show it: its pressure is even, however stiff the skin is. Press "
                    "with a sphere smaller than the patch."
                )
            yield _warn(
                "not_identified",
                f"The data do not determine {_NAMES[name]}: its valley does not close within the searched range.",
                advice,
            )


def _check_press_count(result: FitResult) -> Iterator[FitFinding]:
    """Warn of too few presses."""
    problem, used = result.problem, len(result.problem)
    advice = f"Collect until at least {2 * FEW_PRESSES} presses have two active taxels or more"
    if not problem.determined:
        yield _warn(
            "too_few_presses",
            f"The {used} usable presses do not determine the parameters: they give {problem.readings} readings for "
            f"{problem.unknowns} unknowns (five parameters, and two coordinates of every press). Many other points "
            "match them as well as the best one, so no interval is given.",
            f"Do not use this calibration. {advice}, spread over the patch.",
        )
    elif used < FEW_PRESSES:
        text = f"Only {used} presses could be used; intervals from so few are rough."
        yield _warn("few_presses", text, f"{advice}.")


def _check_press_spread(result: FitResult) -> Iterator[FitFinding]:
    """Warn of presses that lie close together."""
    if at_one_place(result.problem):
        yield _warn(
            "one_place",
            f"All presses lie within {1e3 * extent_m(result.problem):.1f} mm of each other, which cannot separate the "
            "turn of the sensor from its position: they have no interval.",
            "Spread the presses over the whole patch.",
        )


def _check_rig(result: FitResult) -> Iterator[FitFinding]:
    """Report errors of positions and forces beyond those declared, and a nonlinear response."""
    declared, found = result.problem.rig.position_sigma_m, result.sigmas.position_m
    if np.isfinite(declared) and found > 1.5 * declared:
        yield _warn(
            "positions_worse",
            f"Contact positions scatter by {1e3 * found:.2f} mm, more than the {1e3 * declared:.2f} mm declared.",
            "Check the kinematic calibration; raise [position] sigma_m and slack_m.",
        )
    field = result.sigmas.field_m
    if field > BENT * found and result.bound == "noise":
        yield FitFinding(
            "positions_bent",
            "info",
            "The error of the measured positions changes smoothly with place, force or posture, by about "
            f"{1e3 * field:.2f} mm. A rotation of the measured positions cannot be distinguished from alpha; the "
            "intervals are widened for it.",
            "Calibrate the kinematics (joint offsets) for a sharper alpha.",
        )
    slack, at_bound = result.problem.rig.slack_m, 0
    if slack > 0:
        at_bound = int((np.abs(result.presses.slack_m).max(axis=1) > 0.98 * slack).sum())
    # By chance, at most one session in a hundred has so many.
    if at_bound > 1 and bdtrc(at_bound - 1, len(result.problem), AT_BOUND) <= 0.01:
        yield _warn(
            "slack_too_tight",
            f"{at_bound} of {len(result.problem)} presses sit at the bound of their slack ({1e3 * slack:.1f} mm): the "
            "rig is further off than the bound allows, and the intervals of the pose are too narrow.",
            "Raise [position] slack_m to three times what the rig can be off, a constant error included.",
        )
    response = result.nonlinearity
    if response.rise > NONLINEAR_NATS:
        bends = "less" if response.grows > 1 else "more"
        yield _warn(
            "response_bends",
            "Images do not grow with the force as they should: with readings straightened, so that the largest one is "
            f"{response.grows:.{1 if abs(response.grows - 1) > 0.1 else 3}f} times as large beside typical ones, "
            f"presses at all places and forces agree better (log evidence {response.rise:.0f}). The sensor seems to "
            f"answer {bends} the more it is pressed; E and S may lie outside of their intervals.",
            "Check the converter's range and the zero of the force, and run `skincal diagnose`: it tells such causes "
            "apart.",
        )
    elif result.force_low > FORCES_OFF:
        power, part = _fit_power_of_force(result)
        scatter = (
            f"Measured forces scatter by {100 * result.sigmas.force:.1f} % around those that the images imply"
        )
        if part > BENDS:
            yield _warn(
                "response_bends",
                f"{scatter}, and {100 * part:.0f} % of its variance goes with the force: images grow as its power of "
                f"{power:.2f} beyond what the skin's contact explains. A response that is no line, or a zero of the "
                "force that is off, does this; E and S may lie outside of their intervals.",
                ("Is the column a force, or the depth of the press? " if power > _LIKE_A_DEPTH else "")
                + "Check the zero of the force, and run `skincal diagnose`: it tells such causes apart.",
            )
        else:
            yield _warn(
                "force_scatter",
                f"{scatter}.",
                "Check the torque sensors' zero. `skincal diagnose` looks for a bias that depends on the pose.",
            )


def _fit_power_of_force(result: FitResult) -> tuple[float, float]:
    """Return the power of the measured force by which images grow beyond the model, and the variance that it explains.

    The second number is the fraction of the variance of the log force errors that a line in the log force
    explains; 0 if chance explains as much in one session of a thousand. Errors of the measured forces alone
    give a falling line: if a force is measured too high, the images imply less (regression to the mean).
    """
    force, off = np.log(result.problem.force_n), result.presses.force_off
    if len(off) < FEW_PRESSES or np.ptp(force) == 0 or np.ptp(off) == 0:
        return 1.0, 0.0
    like, wide = float(np.corrcoef(force, off)[0, 1]), float(off.std() / force.std())
    by_errors = -min(wide, 1 - 1e-9) if like < 0 else 0.0
    # Fisher's transformation makes a correlation approximately normal, with this standard deviation.
    sigmas = (np.arctanh(like) - np.arctanh(by_errors)) * np.sqrt(len(off) - 3.0) * np.sign(like)
    return 1.0 + like * wide, like**2 if ndtr(-sigmas) < CHANCE / 2 else 0.0


def _lit_residuals(result: FitResult) -> tuple[float, float]:
    """Return the rms residual of lit readings, and the expected one [counts].

    The first is from the fit, with the misfit, which grows with the signal. The second combines the noise of
    untouched taxels with the error of a good model, one percent of the signal, as in a diagnosis.
    """
    problem, sigmas = result.problem, result.sigmas
    readings, rows = problem.observation, np.arange(len(problem))
    lit = problem.lit & problem.used
    squares = readings.variance(
        np.full(len(rows), sigmas.noise_counts), np.full(len(rows), sigmas.misfit), rows
    )[lit]
    noise, image = (readings.share * problem.noise_sigma_counts)[lit], MISFIT * readings.signal[lit]
    return float(np.sqrt(squares.mean())), float(np.sqrt((noise**2 + image**2).mean()))


def _check_misfit(result: FitResult) -> Iterator[FitFinding]:
    """Report images that the model does not match, and an empty valley."""
    found, noise = _lit_residuals(result)
    bad = int((~result.presses.good).sum())
    if found > MISFIT_TIMES * noise or result.misfit_low > MISFIT_PART:
        beyond = (
            "noise and 1 % of the signal explain"
            if found > MISFIT_TIMES * noise
            else f"that is {100 * result.sigmas.misfit:.0f} % of the signal beyond the noise; noise and 1 % explain"
        )
        yield _warn(
            "misfit",
            f"Where taxels are pressed images differ by {found:.3g} counts, and {beyond} "
            f"{noise:.3g}: the base model lacks something. Pose, E and S may take it up, and lie outside of their "
            "intervals.",
            "Run `skincal diagnose` before you use them: it looks for what is missing, and fits them anew beside it.",
        )
    if result.law_rise > SPREAD_NATS:
        yield _warn(
            "contact_law",
            f"The skin spreads pressure sideways by {1e3 * result.law_spread_m:.1f} mm or more, the most that a fit "
            "looks at. E and S are those of a skin that spreads no more; they may lie outside of their intervals.",
            "Run `skincal diagnose`: it looks for a spread, a crosstalk, or another contact law.",
        )
    if bad:
        text = f"{bad} of {len(result.problem)} presses fit clearly worse than the rest."
        yield FitFinding("bad_presses", "info", text, "They are marked red in the report.")
    if result.bound == "fixed" and not result.grid.in_valley.any():
        yield _warn(
            "empty_valley",
            f"No combination of the grid comes below the bound of {result.valley_mse_counts2:g} counts²; the least "
            f"loss there is {float(result.grid.mse_counts2.min()):.3g} counts².",
            "Leave the bound out, so that it follows the noise of the data. A finer grid seldom helps: on the grid, "
            "presses are placed by normalised images, which leaves more than the noise.",
        )


def _check_dead_taxels(result: FitResult) -> Iterator[FitFinding]:
    """Warn of taxels that do not respond where they are pressed."""
    for j in np.flatnonzero(result.dead_taxels).tolist():
        text = f"Taxel {result.problem.rig.layout.names([j])} does not answer where it is pressed; it was left out."
        yield _warn("dead_taxel", text, "Check its wiring.")


def _check_dropped_readings(result: FitResult) -> Iterator[FitFinding]:
    """Report readings at which a taxel dropped out."""
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


def _check_rest_levels(result: FitResult) -> Iterator[FitFinding]:
    """Warn of taxels that every press touches, so that their rest level is not seen."""
    problem = result.problem
    doubtful = ~problem.observed.level_known & problem.lit.any(axis=0)
    # A level that is known from a bound of the converter, from a subtraction, or from the other taxels
    # needs no presses to show it.
    doubtful &= problem.shared.level_sigma > problem.noise_sigma_counts
    if doubtful.any():
        taxels = problem.rig.layout.names(np.flatnonzero(doubtful))
        yield _warn(
            "rest_in_doubt",
            f"Every press touches taxel {taxels}, so the level at rest is "
            "not seen there; it is estimated along with the other parameters, from the spread of the other levels.",
            "Record frames at rest (phase idle), or press at places that leave it alone.",
        )


def _check_sampling(result: FitResult) -> Iterator[FitFinding]:
    """Warn of a small effective sample size."""
    if result.bound == "fixed" or result.effective_draws >= 100:
        return
    found = max(1, round(result.effective_draws))
    rough = result.effective_draws >= FEWEST_DRAWS
    yield _warn(
        "few_draws",
        f"The draws from the valley are worth only {found} independent one{'s' if found > 1 else ''}: "
        + ("intervals are approximate." if rough else "too few to show its width, so no interval is given."),
        "Several sets of parameters fit the data; more presses, spread over the patch, tell them apart.",
    )
