"""Making tables of images with the skin model, some presses at a time."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, dataclass
from hashlib import sha256
from typing import Protocol

import numpy as np

from skincal.fitting.general_skin import SkinShares
from skincal.fitting.general_table import SkinTable, TableReach, levels_of, lit_nodes, smoothed, turns_of
from skincal.fitting.posterior import Peak
from skincal.fitting.problem import FitProblem
from skincal.fitting.seen import from_patch, to_patch
from skincal.fitting.types import Floats, Ints

PART = 6
"""Presses tabled in one piece of work."""

_CENTRE_STEP_M = 1e-3
"""Longer than the facets of a mesh, whose edges are not what a place on a finger is known by."""

_LOADED = 1e-6
"""A taxel that never gets this share of the force is left out."""


@dataclass(frozen=True, eq=False)
class TableTask:
    """Some presses to be tabled.

    Attributes:
        problem: presses with contacts in space.
        presses: (K,) numbers of those to table.
        macro: (5,) macro variables in the middle of the table.
        reach: how far it goes.
    """

    problem: FitProblem
    presses: Ints
    macro: Floats
    reach: TableReach


class TableStore(Protocol):
    """Keeps tables of images between runs of a fit."""

    def table(self, name: str, /) -> SkinTable | None:
        """The table that was kept under a name; None where there is none."""
        ...

    def keep_table(self, name: str, table: SkinTable, /) -> None:
        """Keeps a table."""
        ...


class _NoStore:
    def table(self, name: str, /) -> SkinTable | None:
        del name

    def keep_table(self, name: str, table: SkinTable, /) -> None:
        del name, table


NO_STORE: TableStore = _NoStore()
"""Keeps nothing."""


def name_of(task: TableTask) -> str:
    """Return what a table of one problem depends on, as a hash: its presses, its middle and its reach."""
    problem, reach = task.problem, np.array(list(asdict(task.reach).values()), dtype=np.float64)
    depends = (problem.rows, task.presses, task.macro[:4], reach)
    return sha256(b"".join(np.ascontiguousarray(part).tobytes() for part in depends)).hexdigest()[:24]


def table_tasks(problem: FitProblem, macro: Floats, reach: TableReach) -> list[TableTask]:
    """The pieces of work that make a table of all presses."""
    parts = np.array_split(np.arange(len(problem)), -(-len(problem) // PART))
    return [TableTask(problem, part, macro, reach) for part in parts]


def reach_of(peak: Peak) -> TableReach:
    """A fine table that holds what a peak leaves open, four sigmas to each side."""
    sigma = np.sqrt(np.maximum(np.diag(peak.covariance), 0.0))
    return TableReach(
        centre_m=float(np.clip(4 * sigma[:2].max(), 0.2e-3, 1.0e-3)),
        alpha_rad=float(np.clip(4 * sigma[2], np.radians(1.5), np.radians(6.0))),
        # Wide enough for the E of other contact laws, too.
        log_ratio=float(np.clip(4 * sigma[3], 0.6, 0.9)),
    )


def run_table(task: TableTask) -> SkinTable:
    """Tables the presses of one task."""
    return _Lattice.of(task).tabled()


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


@dataclass(frozen=True, eq=False)
class _Lattice:
    """Places on the patch at which K presses are tabled, n = K N² of them."""

    task: TableTask
    anchor_m: Floats  # (K, 2)
    press: Ints  # (n,)
    uv_m: Floats  # (n, 2)
    log_ratio: Floats  # (n,) in the middle of the tabled ones
    side: int  # N

    @classmethod
    def of(cls, task: TableTask) -> _Lattice:
        problem, presses, reach, centre = task.problem, task.presses, task.reach, task.macro[:3]
        across, along = problem.across_m - centre[0], problem.along_m - centre[1]
        anchor = to_patch(across, along, np.full(len(problem), centre[2]))
        # A turn moves the places that a press can have on the patch; as far for all, so that tables can be joined.
        swept = reach.alpha_rad * float(np.hypot(*anchor.T).max())
        # Two more nodes all round, so that a look-up at the edge has all its neighbours.
        count = int(np.ceil((problem.rig.slack_m + reach.centre_m + swept) / reach.step_m)) + 2
        axis = np.arange(-count, count + 1) * reach.step_m
        lattice = np.stack(np.meshgrid(axis, axis, indexing="ij"), axis=-1).reshape(-1, 2)
        uv = (anchor[presses, None] + lattice).reshape(-1, 2)
        press = np.repeat(presses, len(lattice))
        return cls(
            task, anchor[presses], press, uv, np.log(problem.force_n[press]) - task.macro[3], 2 * count + 1
        )

    def tabled(self) -> SkinTable:
        """Evaluates the skin model on the lattice."""
        problem, presses, reach = self.task.problem, self.task.presses, self.task.reach
        levels = levels_of(reach)
        home = self._skin(np.zeros(3))
        channels: list[Floats] = []
        for turn in turns_of(reach):
            channels += self._images(home, np.array([0.0, 0.0, turn]), levels)
        for shift in _CENTRE_STEP_M * np.eye(2, 3):
            ahead, behind = (self._images(home, s, np.zeros(1))[0] for s in (shift, -shift))
            channels.append((ahead - behind) / (2 * _CENTRE_STEP_M))
        stacked = np.stack(channels, axis=-1).reshape(len(presses), self.side, self.side, -1, len(channels))
        stacked = np.moveaxis(stacked, 3, 1)
        loaded = stacked[..., :-2].max(axis=(2, 3, 4)) > _LOADED
        plane = np.full(loaded.shape, -1, dtype=np.intp)
        plane[loaded] = np.arange(loaded.sum())
        slot = np.full(len(problem.status), -1, dtype=np.intp)
        slot[problem.rows[presses]] = np.arange(len(presses))
        shares = smoothed(np.ascontiguousarray(stacked[loaded]), home.lost_m2() / reach.step_m**2)
        middle = self.log_ratio[:: self.side**2]
        return SkinTable(
            shares, lit_nodes(shares), plane, self.anchor_m, slot, middle, self.task.macro[:3], reach
        )

    def _skin(self, shift: Floats) -> SkinShares:
        at = (float(x) for x in self.task.macro[:3] + shift)
        return SkinShares(self.task.problem, *at, resolution_m=self.task.reach.resolution_m)

    def _images(self, home: SkinShares, shift: Floats, levels: Floats) -> list[Floats]:
        """Shares (n, J) at every level, with the sensor's centre and turn shifted (3,).

        Where the taxels would not fit on the surface, the image is taken not to change.
        """
        skin = self._skin(shift)
        if not skin.placed:
            skin, shift = home, np.zeros(3)
        at, problem = self.task.macro[:3] + shift, self.task.problem
        offset = from_patch(self.uv_m, np.full(len(self.uv_m), at[2]))
        slack = offset + at[:2] - np.stack([problem.across_m, problem.along_m], axis=1)[self.press]
        return [skin.shares(self.press, slack, self.log_ratio + v).astype(np.float32) for v in levels]
