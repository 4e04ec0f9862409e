"""What a person should know of a session beside the verdict: glitches, jumps, taxels that were never read."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from skincal.calibration import Finding
from skincal.gap.robust import Dead, Jump
from skincal.model import TaxelLayout
from skincal.model.arrays import BoolArray, IntArray

LAW = 0.15
"""What a law explains is told from this on, in units of the noise."""


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
        of_law: root mean square of what another contact law would explain, in units of the noise.
    """
    looked: list[int] = list(range(seen.shape[1])) if taxels is None else taxels.tolist()
    found: list[Finding] = []
    if len(glitches):
        numbers = ", ".join(str(presses[row]) for row in glitches)
        text = f"press {numbers}: the image is out of all proportion to that of other presses; left out"
        found.append(Finding("glitch", "warning", text, "Look at its frames; press there again."))
    for jump in jumps:
        names = ", ".join(taxel_name(layout, looked[t]) for t in jump.taxels)
        text = f"{names}: the level at rest jumps at {jump.at_s:.1f} s by {_heights(jump)} counts; taken off"
        found.append(
            Finding("jump", "warning", text, "Look for a loose connector or a restart of the electronics.")
        )
    for one in dead:
        since = "throughout" if one.from_s <= 0 else f"from {one.from_s:.1f} s on"
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
    never = np.flatnonzero(~seen.any(axis=0))
    if len(never):
        names = ", ".join(taxel_name(layout, looked[t]) for t in never)
        found.append(Finding("never_read", "warning", f"{names}: never read (NaN throughout); left out", ""))
    return tuple(found)


def _heights(jump: Jump) -> str:
    return ", ".join(f"{c:+.1f}" for c in jump.counts)
