"""Making tables of images with the skin model, some presses at a time."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict
from hashlib import sha256

import numpy as np

from skincal.fitting.general_skin import SkinShares
from skincal.fitting.general_table import SkinTable, TableReach, levels_of, lit_nodes, smoothed, turns_of
from skincal.fitting.posterior import Peak
from skincal.fitting.presses import from_patch, to_patch
from skincal.fitting.problem import FitProblem
from skincal.fitting.types import Floats, Ints

PART = 6
"""Presses tabled in one piece of work."""

_CENTRE_STEP_M = 1e-3
"""Longer than the facets of a mesh, whose edges are not what a place on a finger is known by."""

_LOADED = 1e-6
"""A taxel that never gets this share of the force is left out."""


def parts_of(problem: FitProblem) -> list[Ints]:
    """Numbers of the presses of each piece of work that makes a part of a table of all presses."""
    return np.array_split(np.arange(len(problem)), -(-len(problem) // PART))


def name_of(problem: FitProblem, presses: Ints, macro: Floats, reach: TableReach) -> str:
    """Return what a table of one problem depends on, as a hash: its presses, its middle and its reach."""
    steps = np.array(list(asdict(reach).values()), dtype=np.float64)
    depends = (problem.rows, presses, macro[:4], steps)
    return sha256(b"".join(np.ascontiguousarray(part).tobytes() for part in depends)).hexdigest()[:24]


def reach_of(peak: Peak) -> TableReach:
    """A fine table that holds what a peak leaves open, four sigmas to each side."""
    sigma = np.sqrt(np.maximum(np.diag(peak.covariance), 0.0))
    return TableReach(
        centre_m=float(np.clip(4 * sigma[:2].max(), 0.2e-3, 1.0e-3)),
        alpha_rad=float(np.clip(4 * sigma[2], np.radians(1.5), np.radians(6.0))),
        # Wide enough for the E of other contact laws, too.
        log_ratio=float(np.clip(4 * sigma[3], 0.6, 0.9)),
    )


def joined(parts: Sequence[SkinTable]) -> SkinTable:
    """One table of all presses, of tables of some."""
    first = parts[0]
    slot = np.full_like(first.slot, -1)
    planes, presses = 0, 0
    plane: list[Ints] = []
    for part in parts:
        slot = np.where(part.slot >= 0, part.slot + presses, slot)
        plane.append(np.where(part.plane >= 0, part.plane + planes, -1))
        planes, presses = planes + len(part.shares), presses + len(part.plane)
    return SkinTable(
        np.concatenate([p.shares for p in parts]),
        np.concatenate([p.lit for p in parts]),
        np.concatenate(plane),
        np.concatenate([p.anchor_m for p in parts]),
        slot,
        np.concatenate([p.log_ratio for p in parts]),
        first.centre,
        first.reach,
    )


def run_table(problem: FitProblem, presses: Ints, macro: Floats, reach: TableReach) -> SkinTable:
    """Table some presses, by the skin model on a lattice of places on the patch.

    Args:
        problem: presses with contacts in space.
        presses: (K,) numbers of those to table.
        macro: (5,) macro variables in the middle of the table.
        reach: how far it goes.
    """
    measured = np.stack([problem.across_m, problem.along_m], axis=1)
    anchor = to_patch(*(measured - macro[:2]).T, np.full(len(problem), macro[2]))
    # A turn moves the places that a press can have on the patch; as far for all, so that tables can be joined.
    swept = reach.alpha_rad * float(np.hypot(*anchor.T).max())
    # Two more nodes all round, so that a look-up at the edge has all its neighbours.
    count = int(np.ceil((problem.rig.slack_m + reach.centre_m + swept) / reach.step_m)) + 2
    axis = np.arange(-count, count + 1) * reach.step_m
    lattice = np.stack(np.meshgrid(axis, axis, indexing="ij"), axis=-1).reshape(-1, 2)
    uv = (anchor[presses, None] + lattice).reshape(-1, 2)
    press = np.repeat(presses, len(lattice))
    middle = np.log(problem.force_n) - macro[3]

    def placed(shift: Floats) -> SkinShares:
        at = (float(x) for x in macro[:3] + shift)
        return SkinShares(problem, *at, resolution_m=reach.resolution_m)

    home = placed(np.zeros(3))

    def images(shift: Floats, levels: Floats) -> list[Floats]:
        """Shares (n, J) at every level, with the sensor's centre and turn shifted (3,)."""
        skin = placed(shift)
        if not skin.placed:  # where the taxels would not fit on the surface, the image is taken not to change
            skin, shift = home, np.zeros(3)
        at = macro[:3] + shift
        slack = from_patch(uv, np.full(len(uv), at[2])) + at[:2] - measured[press]
        return [skin.shares(press, slack, middle[press] + v).astype(np.float32) for v in levels]

    channels: list[Floats] = []
    for turn in turns_of(reach):
        channels += images(np.array([0.0, 0.0, turn]), levels_of(reach))
    for shift in _CENTRE_STEP_M * np.eye(2, 3):
        ahead, behind = (images(s, np.zeros(1))[0] for s in (shift, -shift))
        channels.append((ahead - behind) / (2 * _CENTRE_STEP_M))
    stacked = np.stack(channels, axis=-1).reshape(len(presses), len(axis), len(axis), -1, len(channels))
    stacked = np.moveaxis(stacked, 3, 1)
    loaded = stacked[..., :-2].max(axis=(2, 3, 4)) > _LOADED
    plane = np.full(loaded.shape, -1, dtype=np.intp)
    plane[loaded] = np.arange(loaded.sum())
    slot = np.full(len(problem.status), -1, dtype=np.intp)
    slot[problem.rows[presses]] = np.arange(len(presses))
    shares = smoothed(np.ascontiguousarray(stacked[loaded]), home.lost_m2() / reach.step_m**2)
    return SkinTable(
        shares, lit_nodes(shares), plane, anchor[presses], slot, middle[presses], macro[:3], reach
    )
