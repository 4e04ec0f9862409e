"""Samples of a session (contacts, forces, covariates) and geometry of the skin, on which effects act."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from skincal.covariates import COVARIATES
from skincal.model import Contacts, Indenter, Patch, Surface, contact_rotations
from skincal.model.arrays import BoolArray, FloatArray, IntArray, as_floats, check_shape, frozen

UNKNOWN, IDLE, LOAD, HOLD, UNLOAD = range(-1, 4)
"""Phases of a sample; from idle on as in a dataset's table of frames."""


@dataclass(frozen=True, eq=False)
class Samples:
    """K samples of one session, in the order of time.

    A covariate is None if it was not recorded at all, and NaN (a phase or pose: -1) in a sample that lacks it.

    Attributes:
        contacts: K contacts; the row of a sample without contact is a placeholder.
        touching: (K,) False without contact: there is no load, whatever the contact says.
        indenter: (K,) index of each sample's indenter.
        press: (K,) number of the press, -1 for none: the dataset's, neither a count nor in order. An environment
            has one press, 0.
        time_s: (K,) session clock, non-decreasing [s].
        phase: (K,) ``IDLE``, ``LOAD``, ``HOLD``, ``UNLOAD``, or ``UNKNOWN``: 0 to 3 and -1.
        speed_m_per_s: (K,) speed of loading of the press [m/s].
        cycle: (K,) number of earlier touches of the same site.
        met_n: (K,) largest force of earlier touches of the same site [N]; 0 at the first.
        pose: (K,) number of the hand's pose, -1 where unknown.
        temperature_c: (K,) temperature at the skin [°C].
        shear_n: (K, 2) tangential force along growing beta and along +y [N].
        start_s: start time of drifts [s]; default: time of the first sample.
        apart_s: (K,) shift of each sample's clock that makes effects forget what came before [s]; it
            acts on memory, not on drifts. None: no shift.
    """

    contacts: Contacts
    touching: BoolArray
    indenters: tuple[Indenter, ...]
    indenter: IntArray
    press: IntArray
    time_s: FloatArray | None = None
    phase: IntArray | None = None
    speed_m_per_s: FloatArray | None = None
    cycle: FloatArray | None = None
    met_n: FloatArray | None = None
    pose: IntArray | None = None
    temperature_c: FloatArray | None = None
    shear_n: FloatArray | None = None
    start_s: float = float("nan")
    apart_s: FloatArray | None = None

    def __post_init__(self) -> None:
        count = len(self.contacts)
        for name, kind in (("touching", np.bool_), ("indenter", np.int64), ("press", np.int64)):
            self._set(name, np.asarray(getattr(self, name), dtype=kind), (count,))
        if len(self.indenter) and not 0 <= self.indenter.min() <= self.indenter.max() < len(self.indenters):
            raise ValueError(f"samples indenter: expected 0 to {len(self.indenters) - 1}")
        for one in COVARIATES.values():
            value = getattr(self, one.attribute)
            if value is not None:
                shape = (count, len(one.columns)) if len(one.columns) > 1 else (count,)
                kind = np.int64 if one.whole else np.float64
                self._set(one.attribute, np.asarray(value, dtype=kind), shape)
        if self.time_s is not None and count:
            if not np.isfinite(self.time_s).all() or np.any(np.diff(self.time_s) < 0):
                raise ValueError("samples time_s: expected finite times that never fall")
            if self.apart_s is not None:
                self._set("apart_s", as_floats(self.apart_s), (count,))
            if np.isnan(self.start_s):
                object.__setattr__(self, "start_s", float(self.time_s[0]))

    def _set(self, name: str, array: NDArray[Any], shape: tuple[int, ...]) -> None:
        check_shape(f"samples {name}", array, shape)
        object.__setattr__(self, name, frozen(array.view()))

    @classmethod
    def of(
        cls,
        contacts: Contacts,
        indenter: Indenter | tuple[tuple[Indenter, ...], ArrayLike],
        *,
        touching: ArrayLike | None = None,
        press: ArrayLike | None = None,
        complete: bool = False,
        **covariates: ArrayLike | None,
    ) -> Samples:
        """Return samples from columns; one number stands for all rows.

        Args:
            contacts: K contacts; a row of NaN without contact.
            indenter: the indenter, or several and (K,) the index of each sample's.
            touching: (K,) True with contact; by default where the phase is known and not idle, or, if it is
                unknown, where the force is above zero.
            press: (K,) number of the press; by default a new press starts where contact begins.
            complete: whether every covariate has to be given, unknown ones as NaN: a simulation that forgets one
                would let effects abstain, silently.
            covariates: (K,) by the name of the attribute, or of the columns that are its components
                (``shear_u_n`` and ``shear_v_n``: both or none).

        Raises:
            TypeError: a name that no covariate has; or a covariate that is missing, if all are needed.
        """
        count = len(contacts)

        def column(value: ArrayLike, kind: type[np.generic]) -> NDArray[Any]:
            return np.broadcast_to(np.asarray(value, dtype=kind), (count,))

        own: dict[str, Any] = {}
        for one in COVARIATES.values():
            parts = one.columns if len(one.columns) > 1 else (one.attribute,)
            given = [value for name in parts if (value := covariates.pop(name, None)) is not None]
            if len(given) == len(parts):
                values = [column(value, np.int64 if one.whole else np.float64) for value in given]
                own[one.attribute] = values[0] if len(values) == 1 else np.stack(values, axis=1)
        if complete and (missing := [c.attribute for c in COVARIATES.values() if c.attribute not in own]):
            raise TypeError(f"samples: expected every covariate; {', '.join(missing)} is missing")
        if covariates:
            raise TypeError(f"samples: expected covariates; got {', '.join(covariates)}")
        things, which = indenter if isinstance(indenter, tuple) else ((indenter,), 0)
        touches = _touching(contacts, own.get("phase")) if touching is None else column(touching, np.bool_)
        pressing = _presses(touches) if press is None else column(press, np.int64)
        return cls(contacts, touches, tuple(things), column(which, np.int64), pressing, **own)

    def __len__(self) -> int:
        return len(self.touching)

    def __getitem__(self, rows: slice | IntArray | BoolArray) -> Samples:
        """Return some of the samples, in their order."""
        names = ("touching", "indenter", "press", "apart_s", *(c.attribute for c in COVARIATES.values()))
        held = {name: getattr(self, name) for name in names}
        cut = {name: None if array is None else array[rows] for name, array in held.items()}
        return replace(self, contacts=self.contacts[rows], **cut)

    def has(self, covariate: str) -> bool:
        """Return whether a covariate of ``COVARIATES`` was recorded."""
        return getattr(self, COVARIATES[covariate].attribute) is not None

    @property
    def elapsed_s(self) -> FloatArray:
        """Time since ``start_s`` (K,) [s]; zero without a clock."""
        if self.time_s is None:
            return np.zeros(len(self))
        apart = 0.0 if self.apart_s is None else self.apart_s
        return as_floats(self.time_s - apart - self.start_s)


def _touching(contacts: Contacts, phase: IntArray | None) -> BoolArray:
    pressing = contacts.force_n > 0
    return pressing if phase is None else np.where(phase == UNKNOWN, pressing, phase != IDLE)


def _presses(touching: BoolArray) -> IntArray:
    """Return the numbers of presses (K,): increased by one each time contact begins, -1 without contact."""
    begins = touching & ~np.concatenate([[False], touching[:-1]])
    return np.where(touching, np.cumsum(begins) - 1, -1)


@dataclass(frozen=True, eq=False)
class Setting:
    """Geometry of the skin, for effects that need it."""

    patch: Patch
    surface: Surface

    @property
    def taxels(self) -> int:
        """Number of taxels J."""
        return self.patch.layout.taxels

    @cached_property
    def centre_m(self) -> FloatArray:
        """Centre of the taxels on the surface (3,) [m]."""
        mean = self.patch.points_m[self.patch.taxel >= 0].mean(axis=0)
        return self.surface.project(mean[None])[0]

    @cached_property
    def axes(self) -> FloatArray:
        """Unit vectors at the centre (2, 3): across (towards growing beta) and along (+y)."""
        return contact_rotations(self.surface.normal_at(self.centre_m[None]))[0].T[:2]

    @cached_property
    def neighbours(self) -> FloatArray:
        """Adjacency (J, J): one for neighbouring taxels, else zero.

        Two taxels are neighbours if no other taxel lies in or on the circle between their centres (Gabriel and Sokal
        1969): in a grid the next in row and column, in a hexagonal layout the six around a taxel.
        """
        centres = self.patch.layout.centres_m
        square = ((centres[:, None] - centres) ** 2).sum(axis=-1)
        # A point lies in the circle if its squared distances from both ends add up to less than the diameter's square.
        between = square[:, None, :] + square[None, :, :] <= square[:, :, None] * (1 + 1e-6)
        ends = np.eye(self.taxels, dtype=bool)
        between &= ~(ends[:, None, :] | ends[None, :, :])
        return ((square > 0) & ~between.any(axis=-1)).astype(np.float64)

    @cached_property
    def wires(self) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Indicators (J, J), one for two different taxels that share their row, their column, or neither."""
        own = np.eye(self.taxels)
        row, col = np.divmod(np.arange(self.taxels), self.patch.layout.cols)
        same_row, same_column = (row[:, None] == row) - own, (col[:, None] == col) - own
        return same_row, same_column, 1.0 - own - same_row - same_column

    def moved(self, samples: Samples, across_m: FloatArray, along_m: FloatArray) -> Samples:
        """Return samples with contacts moved over the surface; a free object moves along without turning.

        Normals turn as the surface's own normals do from the old place to the new one.

        Args:
            samples: K samples.
            across_m: (K,) towards growing beta [m].
            along_m: (K,) along +y [m].
        """
        contacts = samples.contacts
        known = np.isfinite(contacts.points_m).all(axis=1) & np.isfinite(contacts.normals).all(axis=1)
        moves = samples.touching & known & ((across_m != 0) | (along_m != 0))
        if not moves.any():
            return samples
        old = self.surface.project(contacts.points_m[moves])
        new = self.surface.offset(old, across_m[moves], along_m[moves])
        points, normals = contacts.points_m.copy(), contacts.normals.copy()
        points[moves] += new - old
        turned = normals[moves] + self.surface.normal_at(new) - self.surface.normal_at(old)
        normals[moves] = turned / np.linalg.norm(turned, axis=1, keepdims=True)
        changes = {"points_m": points, "normals": normals}
        if contacts.origins_m is not None:
            changes["origins_m"] = contacts.origins_m.copy()
            changes["origins_m"][moves] += new - old
        return replace(samples, contacts=replace(contacts, **changes))
