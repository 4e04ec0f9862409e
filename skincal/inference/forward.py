"""The observation model: y = c(g(theta, law, effects, press) + rest), and its slopes.

A state is the pose, E, S, the level at rest, four parameters of the contact law, the parameters of effects, and a shift
and force scale of every press. Loads come from tables (:mod:`skincal.inference.press_table`); everything after the
contact is the chain of effects itself, so each slope by a parameter is a difference of that chain.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np
from scipy.sparse import csr_array

from skincal.effects import EffectSkin, InputEffect, LawEffect, Samples, SpreadEffect, effect
from skincal.effects.effect import Stage
from skincal.effects.registry import at_work
from skincal.inference.noise import Noise
from skincal.inference.paths import Paths
from skincal.inference.press_table import STEP_M, Presses, PressTable, press_table
from skincal.inference.session import GapSession
from skincal.model import (
    ContactLaw,
    Converter,
    Patch,
    SensorPose,
    Skin,
    SkinParameters,
    Sphere,
    StressLaw,
    Surface,
    TaxelLayout,
)
from skincal.model.arrays import FloatArray, IntArray
from skincal.model.patch import Rule

Effects = Mapping[str, Mapping[str, FloatArray]]
"""Parameters by effect and name; those left out are neutral."""

BASE = ("y", "turn", "alpha", "elasticity", "scale", "rest")
CONTACT = ("power", "blur", "radius")
LAW = (*CONTACT, "bare")
_STEP = {"y": 5e-5, "turn": 5e-5, "alpha": 0.06}
_SOFT, _POWER, _RADIUS = 0.015, 0.05, 0.015
"""Steps of central differences. A stiffer skin and a larger sphere have nearly the same effect; both steps are equal,
so that the same points come into contact and the slopes do not differ by discretisation."""
LAW_WAYS = np.array(
    [[1.0, 0.0, 0.0, 0.0], [-0.3, 1.0, 0.0, 0.0], [-0.65, 0.0, 1.0, 0.0], [0.0, 0.0, 0.0, 1.0]]
)
"""From a state's parameters to power, blur, radius and bare. Blur and radius of elastic layers vary with the power
(slopes fitted to the twins); a state has their differences from that."""
BLUR_M2 = STEP_M**2 / 2
"""Variance of one unit of spreading [m²]."""
_NEAR_M = 1.2e-4
"""Move of a press up to which the tables of a nearby state are used [m]."""
_COARSE_M = 6e-4
"""Spacing of points for the search of places [m]."""
_PLACE_M = 1.5e-4
"""Grid of the places of tables [m]: a press that moves by less keeps its table."""


@dataclass(frozen=True, eq=False)
class State:
    """Parameters of the sensor, and the nuisance parameters of each press.

    Attributes:
        pose: of the patch.
        log_e: logarithm of E [Pa/m].
        log_s: logarithm of S [1/N]; (J,) where taxels have their own.
        rest: level that all taxels share [counts].
        law: (4,) power of the stress less 1; blur and relative radius, each less what goes with the power
            (``LAW_WAYS``);
            and bare, the part of the unprojected pressure in what taxels feel: 0 if it is projected (paper, equation
            3).
        move: (P, 3) shift of each press across and along [m], and logarithm of its force scale.
        effects: parameters of effects beyond the base model.
    """

    pose: SensorPose
    log_e: float
    log_s: FloatArray
    rest: float
    law: FloatArray
    move: FloatArray
    effects: Effects = field(default_factory=dict)


@dataclass(frozen=True, eq=False)
class StatePrediction:
    """A state and its prediction.

    Attributes:
        state: the state.
        felt: samples after effects on place and force.
        loads: (K, J) [N].
        values: (K, J) levels above rest [counts].
        moves: (3, K, J) slopes of loads by the move across and along [N/m], and by the logarithm of the force.
        table: of the presses.
        places: (P, 2) places of the presses in the table, relative to the measured ones [m].
        paths: of the presses, whose nodes are the rows of the table.
        key: everything else that the table depends on.
    """

    state: State
    felt: Samples
    loads: FloatArray
    values: FloatArray
    moves: FloatArray
    table: PressTable
    places: FloatArray
    paths: Paths
    key: object


class Means:
    """Averages samples to observations: ``means @ values`` is (N, ...) for (K, ...)."""

    def __init__(self, parts: csr_array) -> None:
        """Take the weight (N, K) of each sample in each observation."""
        self._parts = parts
        every = np.arange(parts.shape[1])
        self._plain = parts.shape[0] == len(every) and np.array_equal(parts @ every, every)

    def __matmul__(self, values: FloatArray) -> FloatArray:
        """Average over the samples of each observation."""
        if self._plain:
            return values
        flat = values.reshape(len(values), int(np.prod(values.shape[1:])))
        return np.asarray(self._parts @ flat).reshape(self._parts.shape[0], *values.shape[1:])


class Forward:
    """Observation model of one session; tables are cached from one state to the next."""

    def __init__(
        self,
        session: GapSession,
        surface: Surface,
        layout: TaxelLayout,
        noise: Noise,
        *,
        clipped: bool,
        resolution_m: float = 3.5e-4,
        margin_m: float = 6e-3,
        rule: Rule = "gauss",
    ) -> None:
        """Take what all states share.

        Args:
            session: samples and their observed means.
            surface: that carries the sensor.
            layout: its taxels.
            noise: of a frame, and the converter.
            clipped: True if an untouched taxel rests at the converter's lower bound, so that none reads less.
            resolution_m: of the patch.
            margin_m: of the patch beyond the taxels.
            rule: position of a tactile point in its cell.
        """
        self.session, self.surface, self.layout, self.noise = session, surface, layout, noise
        self.samples = session.remembered
        self._patch = (resolution_m, margin_m, rule)
        self._converter = Converter(0.0 if clipped else None, None, integer=False)
        s = session
        own = np.flatnonzero(s.observation >= 0)
        count = np.bincount(s.observation[own], minlength=len(s)).astype(float)
        part = 1.0 / count[s.observation[own]]
        self.mean = Means(csr_array((part, (s.observation[own], own)), shape=(len(s), len(s.samples))))
        self.row = np.asarray(s.row, dtype=np.int64)
        self.presses = s.presses
        self._weight = self._weights()
        self._measured = self._presses()
        self._axes = self._measured.axes(surface)
        self.within_m = self._moves_within()
        self._patches: dict[tuple[SensorPose, float], Patch] = {}
        self._tables: dict[object, tuple[FloatArray, PressTable]] = {}
        self._spread: tuple[object, Patch, FloatArray] | None = None
        self._moves: tuple[StatePrediction, FloatArray] | None = None
        self._skin: tuple[State, EffectSkin] | None = None

    def __getstate__(self) -> dict[str, object]:
        """Return what another process needs; caches are left out."""
        found_again = {"_patches": {}, "_tables": {}, "_spread": None, "_moves": None, "_skin": None}
        return {**self.__dict__, **found_again}

    @property
    def rests_clipped(self) -> bool:
        """True if an untouched taxel rests at the converter's lower bound."""
        return self._converter.value_min is not None

    def of_holds(self) -> Forward:
        """Return the model of the holds alone, with coarser points: for the first search of the pose."""
        part, (resolution, margin, rule) = self.session.of_holds_alone(), self._patch
        return Forward(
            part, self.surface, self.layout, self.noise, clipped=self.rests_clipped,
            resolution_m=max(resolution, _COARSE_M), margin_m=margin, rule=rule,
        )  # fmt: skip

    def contact_law(self, numbers: FloatArray) -> ContactLaw:
        """Return the contact law of a state's parameters without ``bare``; its E is for the session's first sphere."""
        return self._contact_law(LAW_WAYS @ numbers)

    def _contact_law(self, law: FloatArray) -> ContactLaw:
        power, blur, radius = (float(x) for x in law[: len(CONTACT)])
        first = self.samples.indenters[0]
        own = first.radius_m if isinstance(first, Sphere) else 0.0
        return ContactLaw(1 + power, blur * BLUR_M2, 1 + radius, reference_radius_m=own)

    # ------------------------------------------------------------------ what was measured

    def _weights(self) -> FloatArray:
        """Return the weight (K,) of each sample in the place of its press: its force, if that is high."""
        force = np.where(self.row >= 0, np.maximum(np.nan_to_num(self.samples.contacts.force_n), 0.0), 0.0)
        most = np.zeros(self.presses + 1)
        np.maximum.at(most, self.row, force)
        return np.where(force > 0.8 * most[self.row], force, 0.0)

    def _presses(self) -> Presses:
        c, count = self.samples.contacts, self.presses
        points, normals = np.full((count, 3), np.nan), np.tile([0.0, 0.0, 1.0], (count, 1))
        indenter, most = np.zeros(count, dtype=np.int64), np.zeros(count)
        ok = (
            (self.row >= 0)
            & self.samples.touching
            & np.isfinite(c.points_m).all(axis=1)
            & np.isfinite(c.force_n)
        )
        for p in np.unique(self.row[ok]):
            mine = np.flatnonzero(ok & (self.row == p))
            force, w = np.maximum(c.force_n[mine], 0.0), self._weight[mine] + 1e-12
            points[p] = (w[:, None] * c.points_m[mine]).sum(axis=0) / w.sum()
            n = (w[:, None] * c.normals[mine]).sum(axis=0)
            normals[p] = n / np.linalg.norm(n)
            indenter[p] = self.samples.indenter[mine[0]]
            most[p] = 1.25 * force.max() + 0.15 * np.median(force) + 1e-9
        known = np.isfinite(points).all(axis=1)
        points[known] = self.surface.project(points[known])
        return Presses(points, normals, indenter, most)

    def _moves_within(self) -> FloatArray:
        """(K, 2) how far each sample lies from its press's place [m]: contacts that slide or roll."""
        return self._offsets(self.samples)

    def session_with_paths(self, part: FloatArray) -> GapSession:
        """Return the session with a part (P,) of the measured motion of each contact within its press."""
        row, c = np.maximum(self.row, 0), self.samples.contacts
        moves = (self.row >= 0) & (np.abs(self.within_m).max(axis=1) > 0) & (part[row] < 1)
        if not moves.any():
            return self.session
        points, normals, own = c.points_m.copy(), c.normals.copy(), row[moves]
        step = part[own, None] * self.within_m[moves]
        points[moves] = self.surface.offset(self._measured.points_m[own], step[:, 0], step[:, 1])
        turn = self.surface.normal_at(points[moves]) - self.surface.normal_at(c.points_m[moves])
        normals[moves] += turn
        normals[moves] /= np.linalg.norm(normals[moves], axis=1, keepdims=True)
        samples = replace(self.session.samples, contacts=replace(c, points_m=points, normals=normals))
        return replace(self.session, samples=samples)

    def _offsets(self, samples: Samples) -> FloatArray:
        row = np.maximum(self.row, 0)
        step = samples.contacts.points_m - self._measured.points_m[row]
        found = np.einsum("kdx,kx->kd", self._axes[row], step)
        return np.where(((self.row >= 0) & samples.touching)[:, None], np.nan_to_num(found), 0.0)

    # ------------------------------------------------------------------ a state

    def skin(self, state: State, effects: Effects | None = None) -> EffectSkin:
        """Return the skin of a state; the last one is cached."""
        if effects is not None or self._skin is None or not _has_same_skin(self._skin[0], state):
            skin = self._new_skin(state, effects)
            if effects is not None:
                return skin
            self._skin = state, skin
        return self._skin[1]

    def _new_skin(self, state: State, effects: Effects | None, coarse_m: float = 0.0) -> EffectSkin:
        resolution, margin, rule = self._patch
        key = state.pose, max(resolution, coarse_m)
        if key not in self._patches:
            if len(self._patches) > 8:
                self._patches.clear()
            self._patches[key] = Patch.build(self.surface, self.layout, *key, margin, rule)
        scale = np.exp(state.log_s)
        skin = Skin(
            self._patches[key],
            SkinParameters(float(np.exp(state.log_e)), scale if scale.ndim else float(scale)),
            self._converter,
        )
        given = state.effects if effects is None else effects
        return EffectSkin.of(skin, self.surface, given, missing="abstain")

    def predict(self, state: State, near: StatePrediction | None = None) -> StatePrediction:
        """Predict a state.

        Args:
            state: the state.
            near: an earlier prediction; if only places differ, by little, its table and slopes are used, so that small
                differences are not those of two tables.
        """
        skin = self.skin(state)
        felt, off = self._felt_samples(skin)
        places, key = self._press_means(off) + state.move[:, :2], self._key(skin, felt, state)
        reach = _NEAR_M + _PLACE_M / 2
        if near is not None and key == near.key and np.abs(places - near.places).max(initial=0.0) < reach:
            places, paths, table = near.places, near.paths, near.table
        else:
            places = _PLACE_M * np.round(places / _PLACE_M)
            paths = self._own_paths if off is self.within_m else self._paths_of(off)
            table = self._table(key, skin, felt, state, paths.nodes_at(places), paths.press)
        row, nearest, e = np.maximum(self.row, 0), paths.nearest, float(np.exp(state.log_e))
        at = off + state.move[row, :2] - paths.nodes_at(places)[np.maximum(nearest, 0)]
        at = np.where((self.row >= 0)[:, None], at, 0.0)
        loads, *moves = e * table.with_slopes(nearest, self.force_n(felt, state) / e, at)
        values = self._after(skin, loads, felt)
        return StatePrediction(state, felt, loads, values, np.array(moves), table, places, paths, key)

    def _felt_samples(self, skin: EffectSkin) -> tuple[Samples, FloatArray]:
        """Return samples after effects on place and force, and their offsets (K, 2) from the measured places."""
        felt = self.samples
        for _, one, values in at_work(skin.effects, felt, InputEffect, "abstain"):
            felt = one.apply(felt, values, skin.setting)
        off = (
            self.within_m if felt.contacts.points_m is self.samples.contacts.points_m else self._offsets(felt)
        )
        return felt, off

    def contact_shifts(self, state: State) -> FloatArray:
        """Return the shift (P, 2) of the contact of each press by effects, across and along [m]."""
        return self._press_means(self._felt_samples(self.skin(state))[1])

    def _press_means(self, off: FloatArray) -> FloatArray:
        """Average offsets (K, 2) over each press where its force is high: (P, 2)."""
        r, w = np.maximum(self.row, 0), self._weight
        total = np.bincount(r, w, self.presses)
        return (
            np.stack([np.bincount(r, w * off[:, k], self.presses) for k in (0, 1)], axis=1)
            / np.maximum(total, 1e-12)[:, None]
        )

    def _key(self, skin: EffectSkin, felt: Samples, state: State) -> object:
        """Return everything that a table depends on except the places."""
        spread = [a for a in skin.effects if isinstance(a.effect, SpreadEffect) and not a.neutral]
        law = tuple((LAW_WAYS @ state.law).tolist())
        return _stress(skin), law, spread[0].key if spread else None, felt.indenters, state.pose, state.log_e

    def _table(
        self, key: object, skin: EffectSkin, felt: Samples, state: State, places: FloatArray, rows: IntArray
    ) -> PressTable:
        """Return the tables of presses (R,) at places (R, 2); only those that have moved are computed again.

        The result depends on the state alone, not on the states before it.
        """
        blur = float((LAW_WAYS @ state.law)[1])
        key = key, rows.tobytes()
        if key not in self._tables:
            if len(self._tables) > 40:
                self._tables.clear()
            self._tables[key] = places, self._make_table(skin, felt, state, places, rows).spread(blur)
        before, table = self._tables[key]
        if len(new := np.flatnonzero((before != places).any(axis=1))):
            terms = table.terms.copy()
            terms[:, new] = self._make_table(skin, felt, state, places[new], rows[new]).spread(blur).terms
            table = PressTable(terms, table.most_m3)
        self._tables[key] = places, table
        return table

    def _make_table(
        self,
        skin: EffectSkin,
        felt: Samples,
        state: State,
        places: FloatArray,
        rows: IntArray,
        *,
        lattice: bool = True,
        law: FloatArray | None = None,
    ) -> PressTable:
        weights, patch = None, skin.skin.patch
        for a in skin.effects:
            if isinstance(a.effect, SpreadEffect) and not a.neutral:
                if not self._spread or self._spread[0] != a.key or self._spread[1] is not patch:
                    self._spread = a.key, patch, a.effect.weights(a.values, patch)
                weights = self._spread[2]
        moved = self.presses_at(places, rows)
        law = LAW_WAYS @ state.law if law is None else law
        return press_table(
            patch, self.surface, felt.indenters, moved, float(np.exp(state.log_e)), _stress(skin),
            weights, contact=self._contact_law(law), bare=float(law[3]), lattice=lattice,
        )  # fmt: skip

    def presses_at(self, places: FloatArray, rows: IntArray) -> Presses:
        """Return presses (R,) at places (R, 2) relative to the measured ones [m]."""
        return self._measured.of(rows).moved(self.surface, places)

    def paths(self, spacing_m: float, least_m: float) -> Paths:
        """Return the paths of the presses as measured."""
        found = self._paths_of(self.within_m, spacing_m, least_m)
        return replace(found, offset_m=found.offset_m + self._press_means(self.within_m)[found.press])

    @cached_property
    def _own_paths(self) -> Paths:
        return self._paths_of(self.within_m)

    def _paths_of(self, off: FloatArray, *spacing: float) -> Paths:
        """Return paths about the mean offset (P, 2) of each press."""
        middle = self._press_means(off)
        return Paths.of(off - middle[np.maximum(self.row, 0)], self.row, self.presses, *spacing)

    def force_n(self, felt: Samples, state: State) -> FloatArray:
        """Return the force (K,) of each sample in a state [N]."""
        row = np.maximum(self.row, 0)
        force = np.where(felt.touching & (self.row >= 0), np.nan_to_num(felt.contacts.force_n), 0.0)
        return np.maximum(force * np.exp(state.move[row, 2]), 0.0)

    def predictor_at(self, state: State, at: IntArray) -> Callable[[FloatArray, IntArray], FloatArray]:
        """Return a function that predicts presses at other places, at one sample (B,) each.

        Effects with memory scale the prediction by the same factor as at the present place.

        Returns:
            from moves (C, G, 2) [m] of some of these samples (C,) to levels (C, G, J).
        """
        still = {n: v for n, v in state.effects.items() if not effect(n).has_memory}
        skin = self._new_skin(state, still, _COARSE_M)
        felt, off = self._felt_samples(skin)
        middle, prediction = self._press_means(off), self.predict(state)
        part = np.ones(len(at))
        if len(still) < len(state.effects):
            ways = prediction.values[at], self._after(skin, prediction.loads, felt)[at]
            now, plain = (np.maximum(x.sum(axis=1), 1e-12) for x in ways)
            part = np.clip(now / plain, 0.2, 5.0)
        force = self.force_n(felt, replace(state, move=np.zeros_like(state.move)))[at]
        e = float(np.exp(state.log_e))

        def read(moves: FloatArray, some: IntArray) -> FloatArray:
            many, taxels, own = moves.shape[1], self.layout.taxels, np.repeat(at[some], moves.shape[1])
            rows = self.row[own]
            places = moves.reshape(-1, 2) + middle[rows]
            table = self._make_table(skin, felt, state, places, rows, lattice=False)
            loads = e * table.at(np.arange(len(rows)), np.repeat(force[some], many) / e)
            values = self._after(skin, loads, felt[own])
            return values.reshape(-1, many, taxels) * part[some, None, None] + state.rest

        return read

    @staticmethod
    def _after(skin: EffectSkin, loads: FloatArray, felt: Samples) -> FloatArray:
        return skin.after(loads, felt, {})

    # ------------------------------------------------------------------ slopes

    def values_by_loads(self, prediction: StatePrediction, change: FloatArray) -> FloatArray:
        """Return the change (K, J) of values by a small change of loads."""
        skin = self.skin(prediction.state)
        if not any(a.effect.stage >= Stage.MEMORY and not a.neutral for a in skin.effects):
            return change * skin.skin.parameters.scale_per_n
        ends = (self._after(skin, prediction.loads + side * change, prediction.felt) for side in (1, -1))
        return (next(ends) - next(ends)) / 2

    def with_effects(self, prediction: StatePrediction, effects: Effects) -> FloatArray:
        """Return values (K, J) with other effects; contacts are computed again only if an effect on them changes."""
        skin = self.skin(prediction.state, effects)
        if _contact_parameters(effects) == _contact_parameters(prediction.state.effects):
            return self._after(skin, prediction.loads, prediction.felt)
        return self.predict(replace(prediction.state, effects=effects), prediction).values

    def base_columns(self, prediction: StatePrediction, *, contact: bool = True) -> FloatArray:
        """Compute slopes (K, J, 6 + 4) by ``BASE`` (place in metres, angle, logarithms, counts) and ``LAW``.

        Slopes by ``CONTACT`` are zero without ``contact``, and those by ``LAW`` without spheres, to which these
        parameters belong.
        """
        s, near = prediction.state, _LocalTables(self, prediction)
        out = np.zeros((*prediction.values.shape, len(BASE) + len(LAW)))
        alike = self.surface.is_uniform
        far, ends = self._from_centre(s, near.places) if alike else None, list[FloatArray]()
        for angle in (_STEP["alpha"], -_STEP["alpha"]):
            # On a uniform surface presses turn with the patch.
            along = 0.0 if far is None else angle * np.stack([-far[:, 1], far[:, 0]], axis=1)
            ends.append(near.loads(pose=moved_pose(self.surface, s.pose, "alpha", angle), along=along))
        out[..., 2] = self.values_by_loads(prediction, (ends[0] - ends[1]) / 2) / _STEP["alpha"]
        if far is not None:
            # On a uniform surface a move of the patch equals the opposite move of all presses. The slopes must be
            # equal exactly, or their difference would seem to identify one of them. A turn is a shift of each press and
            # a turn about it; what memory keeps of the press before is shifted alike, an approximation.
            moves, way = self.press_columns(prediction), far[np.maximum(self.row, 0)][:, None]
            out[..., 0], out[..., 1] = -moves[..., 1], -moves[..., 0]
            out[..., 2] += way[..., 1] * moves[..., 0] - way[..., 0] * moves[..., 1]
        for k, name in enumerate(() if alike else ("y", "turn")):
            change = near.loads(pose=moved_pose(self.surface, s.pose, name, _STEP[name])) - near.loads()
            out[..., k] = self.values_by_loads(prediction, change) / _STEP[name]
        # What a press leaves in the rest after it has no shift of its own, so it must not inform the pose.
        out[self.row < 0, :, :3] = 0.0
        out[..., 3] = self.values_by_loads(prediction, _SOFT * near.by_elasticity()) / _SOFT
        more = self._after(self.skin(replace(s, log_s=s.log_s + _SOFT)), prediction.loads, prediction.felt)
        out[..., 4] = (more - prediction.values) / np.expm1(_SOFT)
        out[..., 5] = 1.0
        balls = any(isinstance(one, Sphere) for one in prediction.felt.indenters)
        if contact and balls:
            by = near.by_contact() @ LAW_WAYS[: len(CONTACT), : len(CONTACT)]
            for k in range(len(CONTACT)):
                out[..., len(BASE) + k] = self.values_by_loads(prediction, 0.02 * by[..., k]) / 0.02
        if balls:
            out[..., -1] = self.values_by_loads(prediction, 0.02 * near.by_bare()) / 0.02
        return out

    def _from_centre(self, state: State, places: FloatArray) -> FloatArray:
        """Return the places (P, 2) of presses relative to the patch's centre, across and along [m]."""
        centre = self.surface.wrap(state.pose, np.zeros((1, 2)))[0]
        return np.nan_to_num(
            self.surface.unrolled(self.surface.project(self._measured.points_m), centre) + places
        )

    def press_columns(self, prediction: StatePrediction) -> FloatArray:
        """Compute slopes (K, J, 3) by the shift of a press across and along [1/m] and the logarithm of its force.

        The last ones are cached.
        """
        if self._moves is not None and self._moves[0] is prediction:
            return self._moves[1]
        steps = zip((2e-5, 2e-5, _SOFT), prediction.moves, strict=True)
        self._moves = (
            prediction,
            np.stack([self.values_by_loads(prediction, h * x) / h for h, x in steps], axis=-1),
        )
        return self._moves[1]


class _LocalTables:
    """Loads of states near one, all from tables at the same places, so that differences are slopes.

    A press that slides has tables at the nodes of its path; slopes between them are interpolated.
    """

    def __init__(self, forward: Forward, prediction: StatePrediction) -> None:
        self._f, self._seen, self._skin = forward, prediction, forward.skin(prediction.state)
        off = forward._felt_samples(self._skin)[1]
        self.places = forward._press_means(off) + prediction.state.move[:, :2]
        self._force = forward.force_n(prediction.felt, prediction.state)
        self._law = LAW_WAYS @ prediction.state.law
        self._own = self._table()
        # Spreading comes from the second slopes, which only the state's own table has.
        self._blur = prediction.table.curved()

    def loads(
        self,
        *,
        pose: SensorPose | None = None,
        along: FloatArray | float = 0.0,
        law: FloatArray | None = None,
    ) -> FloatArray:
        """Compute loads (K, J) without spreading: at another pose, with moved presses (P, 2) [m], under another law."""
        here = pose is None and law is None
        return self._of(self._own if here else self._table(pose, along, law))

    def by_elasticity(self) -> FloatArray:
        """Return slopes (K, J) by the logarithm of E."""
        return self._by_e + self._spread_by_e

    def by_contact(self) -> FloatArray:
        """Return slopes (K, J, 3) by power, blur and radius.

        Spread load is assumed to change with a parameter in the proportion in which it changes with E. For a press
        between taxels, which feel nothing else, no proportion is known, and spreading counts against it.
        """
        parts = list[FloatArray]()
        for step in (np.array([_POWER, 0, 0, 0]), np.array([0, 0, _RADIUS, 0])):
            more, less = (self.loads(law=self._law + side * step) for side in (1, -1))
            by = (more - less) / (2 * step.sum())
            felt = (self._by_e**2 + self._spread_by_e**2).sum(axis=1)
            alike = (by * self._by_e).sum(axis=1) / np.maximum(felt, 1e-300)
            parts.append(by + alike[:, None] * self._spread_by_e)
        return np.stack([parts[0], self._by_blur(), parts[1]], axis=-1)

    def by_bare(self) -> FloatArray:
        """Return slopes (K, J) by the part of the unprojected pressure, in which loads are linear."""
        other = np.array([*self._law[:3], float(round(1 - self._law[3]))])
        return (self.loads(law=other) - self.loads()) / (other - self._law).sum()

    @cached_property
    def _by_e(self) -> FloatArray:
        return (self._of(self._own, _SOFT) - self._of(self._own, -_SOFT)) / (2 * _SOFT)

    @cached_property
    def _spread_by_e(self) -> FloatArray:
        more, less = (self._by_blur(side * _SOFT) for side in (1, -1))
        return self._law[1] * (more - less) / (2 * _SOFT)

    def _table(
        self, pose: SensorPose | None = None, along: FloatArray | float = 0.0, law: FloatArray | None = None
    ) -> PressTable:
        s = self._seen.state
        skin = self._skin if pose is None else self._f.skin(replace(s, pose=pose))
        paths = self._seen.paths
        nodes = paths.nodes_at(self.places + along)
        return self._f._make_table(skin, self._seen.felt, s, nodes, paths.press, lattice=False, law=law)

    def _by_blur(self, harder: float = 0.0) -> FloatArray:
        """Return slopes (K, J) by the spreading, which is the same all about a node."""
        e = float(np.exp(self._seen.state.log_e + harder))
        return e * self._blur.at(self._seen.paths.nearest, self._force / e)

    def _of(self, table: PressTable, harder: float = 0.0) -> FloatArray:
        e = float(np.exp(self._seen.state.log_e + harder))
        return e * self._seen.paths.between_nodes(table, self._force / e)


def _has_same_skin(one: State, other: State) -> bool:
    """Return whether two states have the same skin; arrays are compared by identity."""
    same = one.pose == other.pose and one.log_e == other.log_e
    return same and one.log_s is other.log_s and one.effects is other.effects


def _stress(skin: EffectSkin) -> StressLaw | None:
    """Return the stress law of an effect; None if stress is proportional to penetration."""
    own = [a.effect.law(a.values) for a in skin.effects if isinstance(a.effect, LawEffect) and not a.neutral]
    return own[-1] if own else None


def _contact_parameters(effects: Effects) -> list[tuple[str, str, bytes]]:
    """Return the parameters of effects that act before the loads are known."""
    early = [n for n in effects if effect(n).stage <= Stage.SPREAD]
    return [(n, k, np.asarray(v).tobytes()) for n in early for k, v in effects[n].items()]


def moved_pose(surface: Surface, pose: SensorPose, name: str, step: float) -> SensorPose:
    """Move a pose along y or around the finger [m], or turn it about its normal [rad]."""
    if name == "alpha":
        return replace(pose, alpha_rad=pose.alpha_rad + step)
    if name == "y":
        return replace(pose, y_m=pose.y_m + step)
    return surface.moved_pose(pose, step)
