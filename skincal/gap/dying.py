"""Taxels that were found not to answer, as a start of the search for ``dead_taxel``."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from skincal.effects import EFFECTS
from skincal.gap.candidates import Bench, Start
from skincal.gap.free import Coordinate, coordinates
from skincal.gap.robust import Dead

NAME = "dead_taxel"


def dead_start(bench: Bench, dead: Sequence[Dead]) -> Start | None:
    """How much each dead taxel answers and what it reads, from the moment that was found; None without any."""
    if not dead or NAME in bench.hypothesis.effects:
        return None
    looked = bench.session.taxels
    flat = {(d.taxel if looked is None else int(looked[d.taxel])): d for d in dead}
    from_s = np.zeros(bench.sizes["per-taxel"])
    for taxel, one in flat.items():
        from_s[taxel] = one.from_s
    coords: list[Coordinate] = []
    x: list[float] = []
    for c in coordinates(EFFECTS[NAME], bench.sizes, bench.lacking):
        one = flat.get(c.index)
        if one is None or c.parameter.name == "from_s":
            continue
        if c.is_strength:
            coords.append(c)
            x.append((one.answer - c.start) / c.unit)
        else:
            coords.append(
                replace(c, start=float(np.clip(one.stuck_counts, c.parameter.low, c.parameter.high)))
            )
            x.append(0.0)
    lasting = {} if "time" in bench.lacking else {NAME: {"from_s": from_s}}
    return Start(NAME, tuple(coords), lasting, tuple(x))
