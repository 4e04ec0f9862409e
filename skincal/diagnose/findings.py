"""What a person should know of a session beside the verdict: glitches, jumps, taxels that were never read."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from skincal.calibration import Finding
from skincal.gap.robust import Dead, Jump
from skincal.model import TaxelLayout
from skincal.model.arrays import BoolArray, IntArray


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
) -> tuple[Finding, ...]:
    """Findings in words.

    Args:
        layout: names taxels.
        presses: (P,) numbers of the presses.
        glitches: rows of glitch presses.
        jumps: of the level at rest.
        dead: taxels that do not answer.
        seen: (N, J) where something was read.
    """
    found: list[Finding] = []
    if len(glitches):
        numbers = ", ".join(str(presses[row]) for row in glitches)
        text = f"press {numbers}: the image is out of all proportion to that of other presses; left out"
        found.append(Finding("glitch", "warning", text, "Look at its frames; press there again."))
    for jump in jumps:
        names = ", ".join(taxel_name(layout, t) for t in jump.taxels)
        text = f"{names}: the level at rest jumps at {jump.at_s:.1f} s by {_heights(jump)} counts; taken off"
        found.append(
            Finding("jump", "warning", text, "Look for a loose connector or a restart of the electronics.")
        )
    for one in dead:
        since = "throughout" if one.from_s <= 0 else f"from {one.from_s:.1f} s on"
        text = (
            f"{taxel_name(layout, one.taxel)} does not answer {since}; it reads {one.stuck_counts:.1f} counts"
        )
        found.append(
            Finding("dead_taxel", "warning", text, "Check its wiring; leave it out where it is used.")
        )
    never = np.flatnonzero(~seen.any(axis=0))
    if len(never):
        names = ", ".join(taxel_name(layout, int(t)) for t in never)
        found.append(Finding("never_read", "warning", f"{names}: never read (NaN throughout); left out", ""))
    return tuple(found)


def _heights(jump: Jump) -> str:
    return ", ".join(f"{c:+.1f}" for c in jump.counts)
