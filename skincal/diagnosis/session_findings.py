"""Collect the findings of a diagnosis: notes and warnings about the data, next to the verdict."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np

from skincal.calibration import Calibration, Finding
from skincal.diagnosis.dataset_session import repeats
from skincal.diagnosis.diagnosis import NamedEffect
from skincal.diagnosis.gap import Gap
from skincal.diagnosis.observed import NoiseFloor, Observed
from skincal.diagnosis.taxel_faults import TaxelFault
from skincal.effects import EFFECTS
from skincal.inference.fit import Fitted
from skincal.inference.start import outlier_presses, outlier_rows, raw_residual
from skincal.model.arrays import IntArray
from skincal.statistics import robust_sigma

FEWEST = 4
"""Number of test presses below which the gap is unreliable."""
_FORCE_SIGMAS, _LEAST_FORCE_SCALE = 6.0, 0.01
"""A fitted force is an outlier beyond this multiple of the robust scatter, which is at least so large (relative)."""
_NOISY = 1.01
"""Ratio to the median noise above which a taxel counts as noisy."""
_CLOCK_SIGMAS = 2.0
"""A delay may be a clock offset up to so many standard deviations of the offset."""
_OTHER_SESSION = {
    "elasticity_pa_per_m": 0.3,
    "scale_per_n": 0.15,
    "alpha_deg": 0.1,
    "y_m": 1e-3,
    "beta_deg": 0.1,
}
"""Largest differences from the calibration of another session: relative, in radians or in metres. Set by eye."""
_LISTED = 6
"""Largest number of presses or taxels that a finding lists."""
_LOOK = "Look at its frames; press there again."


def collect_findings(
    observed: Observed,
    calibration: Calibration,
    final: Calibration,
    base: Fitted,
    fit: Fitted,
    effects: Sequence[NamedEffect],
    gap: Gap,
) -> tuple[Finding, ...]:
    """Return all findings of a diagnosis.

    Args:
        observed: the session.
        calibration: the given calibration.
        final: the new calibration.
        base: fit of the base model.
        fit: final fit.
        effects: the named effects.
        gap: the gap on the test presses.
    """
    return (
        *_noise_findings(observed.floor, observed),
        *_moving_rest(calibration),
        *_outlier_presses(observed, base, fit),
        *far_readings(observed, fit),
        *_force_outliers(observed, fit),
        *_bad_taxels(observed, effects),
        *_temporary_faults(observed),
        *_clock_offsets(effects, observed),
        *_few_test_presses(gap),
        *_contact_law(final),
        *_other_parameters(observed, calibration, fit),
    )


def _noise_findings(floor: NoiseFloor, observed: Observed) -> Iterator[Finding]:
    """Yield how the noise was estimated, and whether it grows with the signal."""
    if not observed.session.has_frames:
        text = (
            f"no frames: the noise of a hold mean is estimated from unpressed taxels, "
            f"{floor.mean_counts:.3g} counts"
        )
        yield Finding("noise_not_measured", "info", text, "Record frames; press a few sites twice.")
    if not len(repeats(observed.dataset)[0]):
        text = (
            "no press is an exact repeat of another, so it is not known how well presses repeat their images"
        )
        advice = "Press a few sites twice with the same force, pose and pace, and record the targets."
        yield Finding("no_repeats", "info", text, advice)
    if floor.grows:
        text = (
            f"the noise grows with the signal, by {100 * floor.grows:.1f} % of it, from "
            f"{floor.frame_counts:.3g} counts at rest; the diagnosis allows for this"
        )
        yield Finding("noise_grows", "info", text, "")


def _moving_rest(calibration: Calibration) -> Iterator[Finding]:
    """Yield what re-zeroing does to a diagnosis, if the fit has seen the level at rest move."""
    if any(one.code == "rest_moves" for one in calibration.findings):
        text = (
            "the level at rest moves between presses: a diagnosis knows a steady drift (baseline_drift), and none that "
            "re-zeroing takes back"
        )
        advice = (
            "If the driver re-zeroes meanwhile, what is said of levels at rest and of dead taxels may come from it: "
            "record without it."
        )
        yield Finding("rest_moves", "info", text, advice)


def _outlier_presses(observed: Observed, base: Fitted, fit: Fitted) -> Iterator[Finding]:
    """Yield the presses whose images are outliers: left out, or kept."""
    outliers = outlier_presses(observed.fitter, fit.state)
    first = outlier_presses(observed.fitter, base.state)
    kept = first[~np.isin(first, outliers)]
    if len(kept):
        text = (
            f"press {_press_numbers(observed, kept)}: the image differs most from the base model; others differ as "
            "well, so they were kept"
        )
        yield Finding("kept_presses", "info", text, _LOOK)
    if len(outliers):
        text = (
            f"press {_press_numbers(observed, outliers)}: the image differs far more from the model than those of "
            "other presses; left out of the calibration"
        )
        yield Finding("glitch", "warning", text, _LOOK)


def _press_numbers(observed: Observed, rows: IntArray) -> str:
    return ", ".join(str(observed.dataset.presses.press[p]) for p in rows)


def far_readings(observed: Observed, fit: Fitted) -> Iterator[Finding]:
    """Yield the presses with an outlier at one taxel, whose images as a whole are no outliers."""
    press, is_pressed = observed.fitter.press, observed.fitter.press >= 0
    residual = np.nan_to_num(np.abs(raw_residual(observed.fitter, fit.state)))
    largest = np.zeros((observed.session.presses, residual.shape[1]))
    np.maximum.at(largest, press[is_pressed], residual[is_pressed])
    rows = np.setdiff1d(outlier_rows(largest.max(axis=1)), outlier_presses(observed.fitter, fit.state))
    if len(rows):
        taxels, numbers = observed.dataset.meta.sensor.taxel_columns(), observed.dataset.presses.press
        names = "; ".join(
            f"press {numbers[p]}: {taxels[own.argmax()]} is {own.max():.0f} standard deviations "
            "of the noise off"
            for p, own in zip(rows, largest[rows], strict=True)
        )
        text = f"{names}; readings that are so far off have less weight in the fit"
        yield Finding("far_readings", "info", text, _LOOK)


def _force_outliers(observed: Observed, fit: Fitted) -> Iterator[Finding]:
    """Yield the presses whose fitted force is far from the measured one."""
    log_ratio = fit.state.move[:, 2]
    scale = max(robust_sigma(log_ratio, 0.0), _LEAST_FORCE_SCALE)
    rows = np.flatnonzero((np.abs(log_ratio) > _FORCE_SIGMAS * scale) & ~observed.is_test)
    if len(rows):
        words = ", ".join(
            f"{observed.dataset.presses.press[p]} ({100 * np.expm1(log_ratio[p]):+.0f} %)"
            for p in rows[:_LISTED]
        )
        text = f"press {words}: the best-fitting force is that far from the measured one"
        advice = "So few presses do not show the cause: look at their frames, and record more like them."
        yield Finding("force", "warning", text, advice)


def _bad_taxels(observed: Observed, effects: Sequence[NamedEffect]) -> Iterator[Finding]:
    """Yield the taxels that were never read, are noisy, or do not respond."""
    taxels = observed.dataset.meta.sensor.taxel_columns()
    if observed.is_never_read.any():
        names = ", ".join(taxels[t] for t in np.flatnonzero(observed.is_never_read))
        yield Finding("never_read", "warning", f"{names}: never read (NaN throughout); left out", "")
    noise = observed.fitter.forward.noise
    noisy = np.flatnonzero(noise.sigma > _NOISY * noise.frame)
    if len(noisy):
        names = ", ".join(f"{taxels[t]} ({noise.sigma[t]:.1f})" for t in noisy[:_LISTED])
        text = (
            f"{names}: the noise of a frame is that many counts, against {noise.frame:.1f} for other taxels; these "
            "taxels have less weight"
        )
        yield Finding("noisy_taxel", "warning", text, "Look at wiring, connectors and ground.")
    for effect in effects:
        if not EFFECTS[effect.name].single_taxels:
            continue
        for p in EFFECTS[effect.name].parameters:
            if p.role == "strength" and p.name in effect.parameters:
                dead = np.flatnonzero(np.asarray(effect.parameters[p.name]) < 0.5 * p.neutral)
                if len(dead):
                    names = ", ".join(taxels[t] for t in dead)
                    text, advice = (
                        f"{names}: does not respond",
                        "Check the wiring; ignore it where it is used.",
                    )
                    yield Finding(effect.name, "warning", text, advice)


def _temporary_faults(observed: Observed) -> Iterator[Finding]:
    """Yield the taxels that step or are stuck, one finding for all that do so at the same time."""
    taxels, groups = (
        observed.dataset.meta.sensor.taxel_columns(),
        dict[tuple[bool, float, int, float, str], list[TaxelFault]](),
    )
    for fault in observed.faults:
        level = f"{fault.counts:.0f}" if fault.stuck else ""
        groups.setdefault((fault.stuck, fault.begin_s, fault.press, fault.end_s, level), []).append(fault)
    for (stuck, begin, press, end, level), own in groups.items():
        names = ", ".join(taxels[fault.taxel] for fault in own)
        at = f"{begin:.1f} s" if np.isfinite(begin) else f"press {observed.dataset.presses.press[press]}"
        last = [p for p in own[0].blocks.tolist() if p >= 0][-1]
        until = f"{end:.1f} s" if np.isfinite(end) else f"press {observed.dataset.presses.press[last]}"
        if stuck:
            text = f"{names}: stuck at {level} counts from {at} to {until}; ignored during this time"
            advice = "Check wiring and electronics; ignore it where it is used."
            yield Finding("stuck_taxel", "warning", text, advice)
            continue
        back = "" if own[0].lasts else f" and back at {until}"
        heights = ", ".join(f"{fault.counts:+.1f}" for fault in own)
        text = f"{names}: the level at rest steps by {heights} counts at {at}{back}; corrected"
        yield Finding("jump", "warning", text, "Look for a loose connector or a restart of the electronics.")


def _clock_offsets(effects: Sequence[NamedEffect], observed: Observed) -> Iterator[Finding]:
    """Yield the delays that may be an offset between the clocks of force and taxels."""
    clock = observed.dataset.meta.clock
    sigma = None if clock is None else clock.sigma_s
    for effect in effects:
        delay = EFFECTS[effect.name].shift_of_clocks_s(effect.parameters)
        if delay <= 0:
            continue
        name, what = effect.name, f"{effect.name} contains a pure delay of {1e3 * delay:.3g} ms"
        advice = f"Measure the offset of the clocks; until then leave {name} out where the policy is to run."
        if sigma is None:
            text = (
                f"{what}, which may be an offset between the clocks of force and taxels: the data do not say how well "
                "these agree (dataset.toml, [clock] sigma_s)"
            )
            yield Finding("clock", "info", text, advice)
        elif delay <= _CLOCK_SIGMAS * sigma:
            text = (
                f"{what}, but the clocks of force and taxels agree only within {1e3 * sigma:.3g} ms (one standard "
                "deviation), so the delay may be theirs and not the skin's"
            )
            yield Finding("clock", "warning", text, advice)


def _few_test_presses(gap: Gap) -> Iterator[Finding]:
    if len(gap.errors) < FEWEST:
        text = f"only {len(gap.errors)} test presses: too few to be sure of the gap, or to withdraw a name"
        advice = "Record more presses: about a sixth of them are test presses."
        yield Finding("few_of_the_end", "warning", text, advice)


def _contact_law(final: Calibration) -> Iterator[Finding]:
    """Yield the fitted contact law."""
    if final.contact_law is not None:
        law = final.contact_law.law
        text = (
            f"the contact law differs from the elastic foundation, as that of an elastic layer does: exponent "
            f"{law.exponent:.2f}, spreading {1e6 * law.spread_m2:+.3f} mm², spheres appear "
            f"{100 * (law.radius_scale - 1):+.1f} % larger; the calibration contains it"
        )
        yield Finding("contact_law", "info", text, "")


def _other_parameters(observed: Observed, calibration: Calibration, fit: Fitted) -> Iterator[Finding]:
    """Yield the base parameters in which this session disagrees with a calibration of another session."""
    sha = observed.dataset.sha256
    if not sha or sha == calibration.provenance.dataset_sha256:
        return
    before, now = (
        np.array([s.log_e, float(np.mean(s.log_s)), s.pose.alpha_rad, s.pose.y_m, s.pose.beta_rad])
        for s in (observed.fitter.priors.start, fit.state)
    )
    off = [n for (n, most), d in zip(_OTHER_SESSION.items(), now - before, strict=True) if abs(d) > most]
    if off:
        text = (
            f"the best values of {', '.join(off)} for this session differ from those of the calibration, which was "
            "fitted to other presses"
        )
        advice = "Fit these presses (skincal fit) and diagnose them with that calibration."
        yield Finding("other_numbers", "warning", text, advice)
