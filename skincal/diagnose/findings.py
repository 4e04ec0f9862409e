"""What a person should know of a session beside the verdict: glitches, jumps, taxels that were never read."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from types import MappingProxyType
from typing import TYPE_CHECKING

import numpy as np

from skincal.calibration import Finding
from skincal.gap.faults import Stuck
from skincal.gap.heldout import FEWEST, Gap
from skincal.gap.noise import ASSUMED, LEFT_BY_FIT, NoiseFloor
from skincal.gap.robust import Dead, Jump
from skincal.model import TaxelLayout
from skincal.model.arrays import BoolArray, IntArray

if TYPE_CHECKING:
    from skincal.diagnose.diagnosis import NamedEffect

LAW = 0.15
"""What a law explains is told from this on, in units of the noise."""
_MOST_PULLED = 6
"""So many presses, or taxels, of a kind are listed."""
_CLOCKS = 2.0
"""A delay within so many standard deviations of the clocks may be theirs."""
_WIDER = 2.0
"""Noise that is no more than something so many times the least that it can be is hardly known."""
_LOOK = "Look at its frames; press there again."


def few_of_the_end(gap: Gap) -> tuple[Finding, ...]:
    """Whether so few presses were kept for the end that they cannot speak against what is named."""
    if gap.presses >= FEWEST:
        return ()
    text = (
        f"{gap.presses} press{'es' if gap.presses != 1 else ''} kept for the end: too few to be sure of the gap, "
        "or to take back what is named"
    )
    return (
        Finding("few_of_the_end", "warning", text, "Press more often: about a quarter is kept for the end."),
    )


def of_noise(
    floor: NoiseFloor, *, frames: bool, repeated: bool | None, uniform: bool = False
) -> tuple[Finding, ...]:
    """What the data do not say of the noise: without it, or without repeats, a gap of its size is hard to tell.

    Args:
        floor: as it was used.
        frames: whether there are any.
        repeated: whether any press is an exact repeat of another; None where targets do not say so.
        uniform: whether the pressure is uniform, so that there are no sites.
    """
    again = "Press a few sites twice with the same force, hand pose and pace, and record the targets."
    found: list[Finding] = []
    if not floor.measured:
        left = (
            "assumed"
            if floor.mean_from == ASSUMED
            else f"taken to be {floor.mean_from}, which the gap is part of"
        )
        text = (
            f"nothing shows the noise: that of a hold mean is {left}: {floor.mean_counts:.2f} counts; what is much "
            "smaller than that may stay unseen"
        )
        fix = "Hold longer, and record frames at rest." if frames else "Record frames."
        found.append(Finding("noise_not_measured", "warning", text, fix if uniform else f"{fix} {again}"))
    elif floor.mean_from == LEFT_BY_FIT and floor.mean_counts > _WIDER * floor.mean_interval[0] > 0:
        # The interval is half to twice of what they scatter.
        untouched = (floor.mean_interval[0] * floor.mean_interval[1]) ** 0.5
        text = (
            f"the noise of a hold mean is taken to be {LEFT_BY_FIT}, which the gap is part of: "
            f"{floor.mean_counts:.2f} counts, though untouched taxels scatter by {untouched:.2f}; what is "
            "much smaller than the first may stay unseen"
        )
        found.append(Finding("noise_not_measured", "info", text, f"Record frames. {again}"))
    if not repeated and not uniform:
        what = "no press is an exact repeat of another"
        if repeated is None:
            what = "targets were not recorded, and do not say which presses repeat others"
        text = f"{what}: whether presses come back to the same image is not known"
        if frames:
            text += ", and the noise is that of the frames alone"
        found.append(Finding("no_repeats", "info", text, again))
    return tuple(found)


def within_the_clocks(effects: Sequence[NamedEffect], clock_sigma_s: float | None) -> tuple[Finding, ...]:
    """Whether a latency that was named may be one of the clocks of force and taxels.

    Args:
        effects: that were named.
        clock_sigma_s: standard deviation of the clocks; None where the data do not say how well they agree.
    """
    # Clocks shift; what lags as a filter does is not theirs.
    shifts = [
        np.abs(e.parameters["delay_s"]) * (1 - e.parameters["filtered"])
        for e in effects
        if e.name == "latency"
    ]
    delay = max((float(one.max()) for one in shifts), default=0.0)
    if delay <= 0:
        return ()
    fix = "Measure how far the clocks are apart; until then leave latency out where the policy is to run."
    if clock_sigma_s is None:
        text = (
            f"latency, of which {1e3 * delay:.3g} ms are a pure delay: the data do not say how well the clocks of "
            "force and taxels agree (dataset.toml, [clock] sigma_s); if they do not, it may be theirs"
        )
        return (Finding("clock", "info", text, fix),)
    if delay > _CLOCKS * clock_sigma_s:
        return ()
    text = (
        f"latency, of which {1e3 * delay:.3g} ms are a pure delay: the clocks of force and taxels are known to agree "
        f"within {1e3 * clock_sigma_s:.3g} ms (one standard deviation), so that it may be theirs and not the skin's"
    )
    return (Finding("clock", "warning", text, fix),)


def too_many_glitches(presses: IntArray, wild: IntArray) -> tuple[Finding, ...]:
    """Presses whose images are out of all proportion, but are too many to be left out."""
    if not len(wild):
        return ()
    text = (
        f"press {_numbers(presses, wild.tolist())}: the image is out of all proportion to that of other presses; they "
        "are too many to be left out as glitches, and had their say"
    )
    return (
        Finding("many_glitches", "warning", text, "Look at their frames; take out presses that went wrong."),
    )


def taxel_name(layout: TaxelLayout, taxel: int) -> str:
    """``taxel_R_C`` of a flat index."""
    return "taxel_{}_{}".format(*divmod(int(taxel), layout.cols))


def findings_of(
    layout: TaxelLayout,
    presses: IntArray,
    glitches: Sequence[int],
    jumps: Sequence[Jump],
    dead: Sequence[Dead],
    seen: BoolArray,
    taxels: IntArray | None = None,
    of_law: float = 0.0,
    stuck: Sequence[Stuck] = (),
    all_taxels: int | None = None,
    doubted: Sequence[int] = (),
    pulled: Mapping[int, float] = MappingProxyType({}),
    noise: tuple[float, Sequence[float]] = (0.0, ()),
    order: IntArray | None = None,
    *,
    of_single: Sequence[str] = (),
) -> tuple[Finding, ...]:
    """Findings in words.

    Args:
        layout: names taxels.
        presses: (P,) numbers of the presses.
        glitches: rows of glitch presses.
        jumps: of the level at rest.
        dead: taxels that do not answer.
        seen: (N, J) where something was read.
        taxels: (J,) which of the layout's taxels were looked at; None for all of them.
        stuck: taxels that sit at a bound for a while.
        all_taxels: how many taxels the sensor has; None: as many as were looked at.
        of_law: root mean square of what another contact law would explain, in units of the noise.
        doubted: rows of presses that look like glitches, though others differ as well.
        pulled: rows of presses that fit best with quite another force, and by which part it is larger.
        order: (N,) rows of the presses, observation by observation, where there is no clock, so that times are numbers
            of observations; None where there is one.
        of_single: effects of which the new calibration has numbers of the taxels that were looked at alone.
        noise: of a frame, usually and of each taxel that was looked at, where some are noisier [counts].
    """

    def at(moment: float) -> str:
        if order is None:
            return f"{moment:.1f} s"
        return f"press {presses[order[min(round(moment), len(order) - 1)]]}"

    looked: list[int] = list(range(seen.shape[1])) if taxels is None else taxels.tolist()
    found: list[Finding] = []
    if len(glitches):
        numbers = _numbers(presses, glitches)
        text = f"press {numbers}: the image is out of all proportion to that of other presses; left out"
        found.append(Finding("glitch", "warning", text, _LOOK))
    if len(doubted):
        numbers = _numbers(presses, doubted)
        text = f"press {numbers}: the image differs most; others differ as well, so they were kept"
        found.append(Finding("kept_presses", "info", text, _LOOK))
    if pulled:
        most = sorted(sorted(pulled, key=lambda row: -abs(pulled[row]))[:_MOST_PULLED])
        numbers = ", ".join(f"{presses[row]} ({100 * pulled[row]:+.0f} %)" for row in most)
        more = f" and {len(pulled) - len(most)} more" if len(pulled) > len(most) else ""
        text = f"press {numbers}{more}: fits best with a force so far from the measured one"
        fix = "Few presses cannot tell why: look at their frames, press more like them."
        found.append(Finding("force", "warning", text, fix))
    for jump in jumps:
        names = ", ".join(taxel_name(layout, looked[t]) for t in jump.taxels)
        back = f" and back at {at(jump.until_s)}" if np.isfinite(jump.until_s) else ""
        text = f"{names}: the level at rest jumps at {at(jump.at_s)} by {_heights(jump)} counts{back}; allowed for"
        found.append(
            Finding("jump", "warning", text, "Look for a loose connector or a restart of the electronics.")
        )
    for (since, until, level), taxels_then in _together(stuck).items():
        names = ", ".join(taxel_name(layout, looked[t]) for t in taxels_then)
        text = f"{names}: stuck at {level:g} counts from {at(since)} to {at(until)}; not looked at then"
        found.append(
            Finding(
                "stuck_taxel", "warning", text, "Check wiring and electronics; leave it out where it is used."
            )
        )
    if noisy := {taxel: own for taxel, own in enumerate(noise[1]) if own > noise[0]}:
        first = sorted(noisy, key=lambda taxel: -noisy[taxel])[:_MOST_PULLED]
        names = ", ".join(f"{taxel_name(layout, looked[t])} ({noisy[t]:.1f})" for t in first)
        more = f" and {len(noisy) - len(first)} more" if len(noisy) > len(first) else ""
        text = (
            f"{names}{more}: a frame scatters by so many counts, those of other taxels by {noise[0]:.1f}; they have "
            "less say for it"
        )
        found.append(Finding("noisy_taxel", "warning", text, "Look at wiring, connectors and ground."))
    for one in dead:
        since = "throughout" if one.from_s <= 0 else f"from {at(one.from_s)} on"
        name = taxel_name(layout, looked[one.taxel])
        text = f"{name} does not answer {since}; it reads {one.stuck_counts:.1f} counts"
        found.append(
            Finding("dead_taxel", "warning", text, "Check its wiring; leave it out where it is used.")
        )
    if of_law > LAW:
        text = (
            "another contact law (an elastic layer, or one that stiffens) would explain a residual of "
            f"{of_law:.2f} times the noise; it is not counted as an effect, and the calibration keeps the law it has"
        )
        found.append(Finding("contact_law", "info", text, "E and S make up for it as far as they can."))
    if all_taxels is not None and all_taxels > len(looked):
        text = (
            f"{len(looked)} of {all_taxels} taxels were looked at, evenly spread over those that the presses reach; "
            "what is said of single taxels is said of these"
        )
        if of_single:
            text += f"; of {' and '.join(of_single)} the new calibration has numbers of these alone, the others none"
        found.append(Finding("some_taxels", "info", text, ""))
    never = np.flatnonzero(~seen.any(axis=0))
    if len(never):
        names = ", ".join(taxel_name(layout, looked[t]) for t in never)
        found.append(Finding("never_read", "warning", f"{names}: never read (NaN throughout); left out", ""))
    return tuple(found)


def _numbers(presses: IntArray, rows: Sequence[int]) -> str:
    return ", ".join(str(presses[row]) for row in rows)


def _together(stuck: Sequence[Stuck]) -> dict[tuple[float, float, float], list[int]]:
    """Taxels by when, and where, they stick."""
    groups: dict[tuple[float, float, float], list[int]] = {}
    for one in stuck:
        groups.setdefault((one.from_s, one.until_s, one.counts), []).append(one.taxel)
    return groups


def _heights(jump: Jump) -> str:
    return ", ".join(f"{c:+.1f}" for c in jump.counts)
