"""Which presses are fitted, which choose among explanations, and which are looked at once, at the end.

Presses are drawn in blocks of session time, never frame by frame: frames of one press share its errors, and presses
that follow each other share drifts. Some sites are left out as a whole: all presses there are for the end.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from skincal.model.arrays import BoolArray, IntArray

TRAIN, SELECTION, FINAL = range(3)


@dataclass(frozen=True)
class SplitOptions:
    """How a session is split.

    Attributes:
        block: presses in a block.
        selection: share of the presses that choose.
        final: share of the presses for the end, those of the sites left out among them.
        sites: share of the sites that are left out as a whole.
    """

    block: int = 5
    selection: float = 0.25
    final: float = 0.25
    sites: float = 0.1


@dataclass(frozen=True, eq=False)
class Split:
    """The part (P,) of each press: ``TRAIN``, ``SELECTION`` or ``FINAL``."""

    part: IntArray

    def rows(self, part: int, press: IntArray) -> BoolArray:
        """Which observations (N,) are of a part, from the rows of their presses; none at rest."""
        return (press >= 0) & (self.part[np.maximum(press, 0)] == part)


def split_presses(site: IntArray, rng: np.random.Generator, options: SplitOptions | None = None) -> Split:
    """Splits presses, given in the order of session time.

    Args:
        site: (P,) number of the site of each press.
        rng: the only source of chance.
        options: shares.

    Raises:
        ValueError: fewer than three presses.
    """
    options = options or SplitOptions()
    count = len(site)
    if count < 3:
        raise ValueError(f"split: expected three presses at least; got {count}")
    part: IntArray = np.full(count, -1, dtype=np.int64)
    part[_left_out(site, rng, options)] = FINAL
    length = max(1, min(options.block, count // 6))
    blocks: list[IntArray] = [np.arange(i, min(i + length, count)) for i in range(0, count, length)]
    wanted = {FINAL: options.final * count, SELECTION: options.selection * count}
    for i in rng.permutation(len(blocks)):
        block = blocks[int(i)]
        free: IntArray = block[part[block] < 0]
        short = {p: w - int((part == p).sum()) for p, w in wanted.items()}
        most = max(short, key=lambda p: short[p])
        part[free] = most if short[most] >= len(free) / 2 else TRAIN
    for missing in (TRAIN, SELECTION, FINAL):
        if not (part == missing).any():
            part[rng.choice(np.flatnonzero(part == np.bincount(part).argmax()))] = missing
    return Split(part)


def _left_out(site: IntArray, rng: np.random.Generator, options: SplitOptions) -> BoolArray:
    """Presses (P,) at the sites that are left out; the site that is visited most, an anchor, stays."""
    sites, visits = np.unique(site, return_counts=True)
    others = np.delete(sites, np.argmax(visits))
    chosen = rng.permutation(others)[: round(options.sites * len(sites))]
    return np.isin(site, chosen)
