"""What a person should know of a session beside the verdict."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np

from skincal.calibration import Calibration, Finding
from skincal.diagnosis.dataset_session import repeats
from skincal.diagnosis.diagnosis import NamedEffect
from skincal.diagnosis.gap import Gap
from skincal.diagnosis.observed import NoiseFloor, Observed
from skincal.diagnosis.spells import Spell
from skincal.effects import EFFECTS
from skincal.inference.fit import Fitted
from skincal.inference.start import outlier_presses, outlier_rows, raw_residual
from skincal.model import TaxelLayout

FEWEST, _PULLED = 4, 6.0
_CLOCKS = 2.0
_LOOK = "Look at its frames; press there again."


def taxel_name(layout: TaxelLayout, taxel: int) -> str:
    """``taxel_R_C`` of a flat index."""
    return "taxel_{}_{}".format(*divmod(int(taxel), layout.cols))


def findings_of(
    observed: Observed,
    calibration: Calibration,
    final: Calibration,
    base: Fitted,
    fit: Fitted,
    effects: Sequence[NamedEffect],
    gap: Gap,
) -> tuple[Finding, ...]:
    """All of them.

    Args:
        observed: the session.
        calibration: that was given.
        final: that comes out.
        base: the base model's fit.
        fit: the final one.
        effects: that were named.
        gap: on the presses of the end.
    """
    return (
        *_noise(observed.floor, observed),
        *_glitches(observed, base, fit),
        *far_readings(observed, fit),
        *_forces(observed, fit),
        *_taxels(observed, effects),
        *_spells(observed),
        *_clocks(effects, observed),
        *_few(gap),
        *_law(final),
        *_numbers(observed, calibration, fit),
    )


def _noise(floor: NoiseFloor, observed: Observed) -> Iterator[Finding]:
    if not observed.session.has_frames:
        text = (
            f"no frames: the noise of a hold mean is that of taxels that are not pressed, "
            f"{floor.mean_counts:.3g} counts"
        )
        yield Finding("noise_not_measured", "info", text, "Record frames; press a few sites twice.")
    if not len(repeats(observed.dataset)[0]):
        text = "no press is an exact repeat of another: whether presses repeat their images is not known"
        yield Finding(
            "no_repeats",
            "info",
            text,
            "Press a few sites twice with the same force, pose and pace, and record the targets.",
        )
    if floor.grows:
        text = (
            f"the noise grows with the signal, by {100 * floor.grows:.1f} % of it beside "
            f"{floor.frame_counts:.3g} counts at rest; allowed for"
        )
        yield Finding("noise_grows", "info", text, "")


def _glitches(observed: Observed, base: Fitted, fit: Fitted) -> Iterator[Finding]:
    wild = outlier_presses(observed.fitter, fit.state)
    first = outlier_presses(observed.fitter, base.state)
    kept = first[~np.isin(first, wild)]
    if len(kept):
        names = ", ".join(str(observed.dataset.presses.press[p]) for p in kept)
        text = f"press {names}: the image differs most from the base model; others differ as well, so they were kept"
        yield Finding("kept_presses", "info", text, _LOOK)
    if len(wild):
        names = ", ".join(str(observed.dataset.presses.press[p]) for p in wild)
        text = (
            f"press {names}: the image differs far more from the model than those of other presses; left out of the "
            f"calibration"
        )
        yield Finding("glitch", "warning", text, _LOOK)


def far_readings(observed: Observed, fit: Fitted) -> Iterator[Finding]:
    """Yield the presses that are far off at one taxel, though their images as a whole are like those of others."""
    press, pressed = observed.fitter.press, observed.fitter.press >= 0
    residual = np.nan_to_num(np.abs(raw_residual(observed.fitter, fit.state)))
    largest = np.zeros((observed.session.presses, residual.shape[1]))
    np.maximum.at(largest, press[pressed], residual[pressed])
    off = np.setdiff1d(outlier_rows(largest.max(axis=1)), outlier_presses(observed.fitter, fit.state))
    if len(off):
        layout, numbers = observed.dataset.layout(), observed.dataset.presses.press
        names = "; ".join(
            f"press {numbers[p]}: {taxel_name(layout, int(own.argmax()))} reads {own.max():.0f} noises off"
            for p, own in zip(off, largest[off], strict=True)
        )
        text = f"{names}; readings that are so far off have less weight in the fit"
        yield Finding("far_readings", "info", text, _LOOK)


def _forces(observed: Observed, fit: Fitted) -> Iterator[Finding]:
    own = fit.state.move[:, 2]
    scale = max(1.4826 * float(np.median(np.abs(own))), 0.01)
    far = np.flatnonzero((np.abs(own) > _PULLED * scale) & ~observed.held)
    if len(far):
        words = ", ".join(
            f"{observed.dataset.presses.press[p]} ({100 * np.expm1(own[p]):+.0f} %)" for p in far[:6]
        )
        text = f"press {words}: fits best with a force that far from the measured one"
        yield Finding(
            "force",
            "warning",
            text,
            "Few presses cannot show why: look at their frames, and record more like them.",
        )


def _taxels(observed: Observed, effects: Sequence[NamedEffect]) -> Iterator[Finding]:
    layout = observed.dataset.layout()
    if observed.never.any():
        names = ", ".join(taxel_name(layout, int(t)) for t in np.flatnonzero(observed.never))
        yield Finding("never_read", "warning", f"{names}: never read (NaN throughout); left out", "")
    noise = observed.fitter.forward.noise
    noisy = np.flatnonzero(noise.sigma > 1.01 * noise.frame)
    if len(noisy):
        names = ", ".join(f"{taxel_name(layout, int(t))} ({noise.sigma[t]:.1f})" for t in noisy[:6])
        text = (
            f"{names}: a frame scatters by so many counts, those of other taxels by "
            f"{noise.frame:.1f}; they are given less weight"
        )
        yield Finding("noisy_taxel", "warning", text, "Look at wiring, connectors and ground.")
    for one in effects:
        for p in EFFECTS[one.name].parameters:
            if EFFECTS[one.name].single_taxels and p.role == "strength" and p.name in one.parameters:
                off = np.flatnonzero(np.asarray(one.parameters[p.name]) < 0.5 * p.neutral)
                if len(off):
                    names = ", ".join(taxel_name(layout, int(t)) for t in off)
                    yield Finding(
                        one.name,
                        "warning",
                        f"{names}: does not answer",
                        "Check wiring; leave it out where it is used.",
                    )


def _spells(observed: Observed) -> Iterator[Finding]:
    """Taxels that step or stick, those together that do so at one moment."""
    layout, groups = observed.dataset.layout(), dict[tuple[bool, float, int, float, str], list[Spell]]()
    for one in observed.spells:
        level = f"{one.counts:.0f}" if one.stuck else ""
        groups.setdefault((one.stuck, one.begin_s, one.press, one.end_s, level), []).append(one)
    for (stuck, begin, press, end, level), own in groups.items():
        names = ", ".join(taxel_name(layout, one.taxel) for one in own)
        at = f"{begin:.1f} s" if np.isfinite(begin) else f"press {observed.dataset.presses.press[press]}"
        last = [p for p in own[0].blocks.tolist() if p >= 0][-1]
        until = f"{end:.1f} s" if np.isfinite(end) else f"press {observed.dataset.presses.press[last]}"
        if stuck:
            text = f"{names}: stuck at {level} counts from {at} to {until}; ignored meanwhile"
            yield Finding(
                "stuck_taxel", "warning", text, "Check wiring and electronics; leave it out where it is used."
            )
            continue
        back = "" if own[0].lasts else f" and back at {until}"
        heights = ", ".join(f"{one.counts:+.1f}" for one in own)
        text = f"{names}: the level at rest steps at {at} by {heights} counts{back}; corrected"
        yield Finding("jump", "warning", text, "Look for a loose connector or a restart of the electronics.")


def _clocks(effects: Sequence[NamedEffect], observed: Observed) -> Iterator[Finding]:
    clock = observed.dataset.meta.clock
    for one in effects:
        delay = EFFECTS[one.name].shift_of_clocks_s(one.parameters)
        if delay <= 0:
            continue
        fix = f"Measure how far the clocks are apart; until then leave {one.name} out where the policy is to run."
        sigma = None if clock is None else clock.sigma_s
        if sigma is None:
            text = (
                f"{one.name}, of which {1e3 * delay:.3g} ms are a pure delay: the data do "
                f"not say how well the clocks of "
                "force and taxels agree (dataset.toml, [clock] sigma_s); if they do not, it may be theirs"
            )
            yield Finding("clock", "info", text, fix)
        elif delay <= _CLOCKS * sigma:
            text = (
                f"{one.name}, of which {1e3 * delay:.3g} ms are a pure delay: the clocks of "
                f"force and taxels are known to "
                f"agree within {1e3 * sigma:.3g} ms (one standard deviation), so that it "
                f"may be theirs and not the skin's"
            )
            yield Finding("clock", "warning", text, fix)


def _few(gap: Gap) -> Iterator[Finding]:
    if len(gap.errors) < FEWEST:
        text = f"only {len(gap.errors)} test presses: too few to be sure of the gap, or to withdraw a name"
        yield Finding(
            "few_of_the_end", "warning", text, "Record more presses: about a sixth of them are test presses."
        )


def _law(final: Calibration) -> Iterator[Finding]:
    if final.contact_law is not None:
        own = final.contact_law.law
        text = (
            f"the contact law differs from the elastic foundation (exponent {own.exponent:.2f}, spreading "
            f"{1e6 * own.spread_m2:+.3f} mm², balls as if {100 * (own.radius_scale - 1):+.1f} % larger), as that of an "
            f"elastic layer does; the calibration has it"
        )
        yield Finding("contact_law", "info", text, "")


def _numbers(observed: Observed, calibration: Calibration, fit: Fitted) -> Iterator[Finding]:
    """Where a calibration of another session has a pose, E and S that this one does not agree with."""
    sha = observed.dataset.sha256
    if not sha or sha == calibration.provenance.dataset_sha256:
        return
    start = observed.fitter.priors.start
    begin = np.array(
        [start.log_e, float(np.mean(start.log_s)), start.pose.alpha_rad, start.pose.y_m, start.pose.beta_rad]
    )
    now = np.array(
        [
            fit.state.log_e,
            float(np.mean(fit.state.log_s)),
            fit.state.pose.alpha_rad,
            fit.state.pose.y_m,
            fit.state.pose.beta_rad,
        ]
    )
    names = ("elasticity_pa_per_m", "scale_per_n", "alpha_deg", "y_m", "beta_deg")
    scale = np.array([0.3, 0.15, 0.1, 1e-3, 0.1])
    off = [n for n, d, s in zip(names, now - begin, scale, strict=True) if abs(d) > s]
    if off:
        text = (
            f"this session fits with another {', '.join(off)} than the calibration, which was fitted to another "
            f"session"
        )
        yield Finding(
            "other_numbers",
            "warning",
            text,
            "Fit this session (skincal fit) and diagnose it with that calibration.",
        )


__all__ = ["findings_of", "taxel_name"]
