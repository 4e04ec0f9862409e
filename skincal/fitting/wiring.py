"""Search for the permutation of the taxels that explains the images best.

A nominal contact at the measured position predicts a taxel's readings over all presses, its trace. All
permutations are searched by assigning measured to predicted traces (Kuhn 1955;
``scipy.optimize.linear_sum_assignment``); those that a cable or a reading order makes are tried by name. Every
order, that of the data among them, gets its own pose, press positions within their slack, and smooth error of
the positions at the cost of its prior. An order is reported only if its score beats that of the data's order by
more than the log number of permutations that it competes with.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import lru_cache
from typing import NamedTuple

import numpy as np
from scipy.optimize import least_squares, linear_sum_assignment
from scipy.special import gammaln

from skincal.fitting.fit_options import SearchBox
from skincal.fitting.lattice import square
from skincal.fitting.presses import solve_small
from skincal.fitting.problem import FitProblem
from skincal.fitting.types import Floats, Ints
from skincal.fitting.wiring_orders import Order, mapping_of, named_orders

MOST_PRESSES = 150
"""Most presses that are used; of more, this many are chosen evenly."""

_MIN_EXPLAINED = 0.5
"""Fraction of the squared difference of the moved taxels that a permutation must explain (stated prior)."""

_WIN_NATS = 10.0
"""Log likelihood by which a permutation must win beyond the log number of rivals: odds of 1 to 20000."""

_MOST_ASSIGNED = 10
"""Number of starting poses from which all permutations are searched."""

_MOST_NAMED = 4
"""Number of named orders that are refined with a pose and press positions of their own."""

_ROUNDS = 3
"""Rounds of alternating fits."""

_LATTICE = square(np.linspace(-1.0, 1.0, 7))
"""Positions (49, 2), over the largest slack, from which a press is fitted again."""

_POSE = 5
"""Number of pose parameters, which come before those of the smooth error of positions."""

_NOMINAL_ERROR = 0.05
"""Error of a nominal contact's images, relative to the signal. Against a sphere on an elastic foundation, plane
and cylinder, it is 3 to 4 %; differences of the taxels' gains add to it."""

_STRETCH_SIGMA, _SHIFT_SIGMA = 0.12, 0.25
"""Prior standard deviations of the smooth error of positions (stated prior): of stretch, shear and bend as a
fraction of the spread of the presses, and of a constant beyond the range of poses as a fraction of the pitch."""

_FIELD_BOUND = 3.0
"""Bound of the smooth error in prior standard deviations; it excludes errors that would mirror or turn the patch."""


@dataclass(frozen=True, eq=False)
class TaxelOrder:
    """An order of the taxels that explains the images where the order of the data does not.

    Attributes:
        order: (J,) index in the data of the taxel that belongs at each position.
        mapping: lines of a mapping file, under ``[taxels]``, that correct the order.
        rms_before: root mean square difference from the nominal images in the order of the data, per lit reading.
        rms_after: the same in the order found.
        log_odds: log likelihood by which it wins, less the log number of rivals.
    """

    order: Ints
    mapping: str
    rms_before: float
    rms_after: float
    log_odds: float

    @property
    def moved(self) -> Ints:
        """Positions whose taxel differs."""
        return np.flatnonzero(self.order != np.arange(len(self.order)))


def find_taxel_order(problem: FitProblem, box: SearchBox) -> TaxelOrder | None:
    """Return the order of taxels that explains the images of a problem; None if that of the data does as well."""
    layout = problem.rig.layout
    if layout.taxels < 2 or len(problem) < 3 or not np.isfinite(problem.rig.position_sigma_m):
        return None  # an unknown position predicts no trace
    if len(problem) > MOST_PRESSES:
        some = np.linspace(0, len(problem) - 1, MOST_PRESSES).astype(np.intp)
        problem = problem.subset(np.isin(np.arange(len(problem)), some), "one of many")
    whole = _Search(problem, box)
    if whole.lit < 2 * _POSE:
        return None  # they determine a pose at most
    names = named_orders(layout.rows, layout.cols)
    nominal, *tried = whole.candidates(names)
    for _ in range(_ROUNDS - 1):
        # From an order that is nearly right, a better pose finds the rest.
        near = min(tried, key=lambda one: one.squares, default=nominal)
        if near.squares > (1 - _MIN_EXPLAINED) * nominal.squares:
            break
        order = near.order
        ordered = replace(problem, values=problem.values[:, order], weight=problem.weight[:, order])
        found = _Search(ordered, box).candidates(names)
        further = [replace(one, order=order[one.order]) for one in found]
        tried += [replace(one, rivals=_log_rivals(one.order, names)) for one in further]
        if min(further, key=lambda one: one.squares).order.tolist() == order.tolist():
            break
    one = nominal
    for other in sorted(tried, key=lambda other: (other.rivals, -whole.score(other))):
        # As the order of the data, one that competes with fewer rivals is kept unless it is clearly beaten; what moves
        # between the two could be any other taxels.
        moved = int((other.order != one.order).sum())
        rivals = float(_log_permutations_of(layout.taxels, moved))
        more = max(min(other.rivals, rivals) - (other.rivals - one.rivals), 0.0)
        least = more + _WIN_NATS
        if whole.score(other) > whole.score(one) + least:
            one, other = whole.refit(one, other, names), whole.refit(other, one, names)
            one = other if whole.score(other) > whole.score(one) + least else one
    if (one.order == nominal.order).all():
        return None
    nominal = whole.refit(nominal, one, names)
    odds = whole.score(one) - whole.score(nominal) - _WIN_NATS
    if odds <= 0 or not whole.explains(nominal, one):
        return None
    lit = max(int((problem.values * (problem.weight > 0) > 0).sum()), 1)
    before, after = (float(np.sqrt(c.squares / lit)) for c in (nominal, one))
    return TaxelOrder(one.order, mapping_of(one.order, layout.rows, layout.cols), before, after, odds)


@dataclass(frozen=True, eq=False)
class _Candidate:
    """An order with its best pose and press positions."""

    order: Ints
    rivals: float  # logarithm of the number of orders that were open to it
    pose: Floats  # (P,) centre across and along, turn, log of the contact's variances, smooth error of positions
    slack_m: Floats  # (K, 2)
    squares: float  # weighted squared differences
    moved: float  # squares of the errors of positions, smooth and of each press, in sigmas


class _NominalImages(NamedTuple):
    """Nominal images, offsets of presses from taxels [m], and variances of the contact at a taxel [m²]; all (K, J)."""

    shares: Floats
    across_m: Floats
    along_m: Floats
    wide_m2: Floats
    long_m2: Floats


class _Search:
    """Search for candidates in one session."""

    def __init__(self, problem: FitProblem, box: SearchBox) -> None:
        self.layout, self.rig = problem.rig.layout, problem.rig
        self.place_m = np.stack([problem.across_m, problem.along_m], axis=1)
        self.force_n, noise = problem.force_n, problem.noise_sigma_counts
        self.sigma_m = max(self.rig.position_sigma_m, 1e-9)
        self.bound_m = min(self.rig.slack_m, 3 * self.sigma_m)
        self.weight = np.clip(problem.weight, 0.0, 1.0) ** 2
        self.observed = np.where(self.weight > 0, problem.values, 0.0)
        lit = self.observed > max(4 * noise, 0.03 * float(self.observed.max(initial=0.0)))
        self.lit = int(lit.sum())
        self.least_variance = max(
            noise**2, _NOMINAL_ERROR**2 * float((self.observed[lit] ** 2).mean()) if self.lit else 0.0
        )
        # Median distance of a taxel from the nearest other [m].
        self.pitch = float(np.median(self.layout.apart_m.min(axis=1)))
        self.basis = _smooth_basis(self.place_m)
        # Prior standard deviation of each function (2 M,) of the smooth error of positions [m].
        stretched = _STRETCH_SIGMA * np.repeat(self.place_m.std(axis=0).max(), self.basis.shape[1])
        stretched[0] = max(_SHIFT_SIGMA * self.pitch, self.rig.position_sigma_m)
        self.field_sigma = np.tile(np.maximum(stretched, 1e-9), 2)
        self.spread = np.sqrt(self.force_n / np.median(self.force_n))
        low, high = np.array([box.across_m, box.y_m, box.alpha_rad]).T
        wide = np.log([(0.1 * self.pitch) ** 2] * 2)
        widest = np.log([(30 * self.pitch) ** 2] * 2)
        field = _FIELD_BOUND * self.field_sigma
        self.low = np.concatenate([low - 1e-6, wide, -field])
        self.high = np.concatenate([high + 1e-6, widest, field])

    def candidates(self, names: list[Order]) -> list[_Candidate]:
        """Return the order of the data, the best named orders, and the best permutations."""
        starts = self._build_starts()
        matrices = [self._trace_products(start) for start in starts]
        orders = np.stack([one.order for one in names])
        costs = np.stack([_order_costs(m, orders) for m in matrices])  # (starts, orders)
        least = costs.min(axis=0)
        tried: list[int] = [0, *(np.argsort(least[1:])[:_MOST_NAMED] + 1).tolist()]
        where: list[int] = costs.argmin(axis=0).tolist()
        found = [self._fit_order(orders[n], starts[where[n]], names) for n in tried]
        bound = [float(_pair_costs(m).min(axis=0).sum()) for m in matrices]
        near: list[int] = [*(where[n] for n in tried), *np.argsort(bound)[:_MOST_ASSIGNED].tolist()]
        assigned = {s: _assign_traces(matrices[s]) for s in dict.fromkeys(near)}
        best = min(assigned, key=lambda s: _order_costs(matrices[s], assigned[s][None])[0])
        likely = max(found[1:], key=self.score, default=found[0])
        seeds = [(assigned[best], starts[best])]
        for one in (found[0], likely):
            # Restart without the position error, which was fitted to another order.
            straight = np.where(np.arange(len(one.pose)) < _POSE, one.pose, 0.0)
            there = self._trace_products(straight)
            assigned_there = _assign_traces(there)
            orders_there = (one.order, assigned_there, self._simplify(assigned_there, there))
            seeds += [(order, straight) for order in orders_there]
        found += [self._search_from(order, pose, names) for order, pose in seeds]
        # Give the order of the data as many chances of finding its best pose as its rivals have.
        own = orders[0]
        first: list[int] = np.argsort(costs[:, 0])[1:_MOST_NAMED].tolist()
        poses = [starts[s] for s in first]
        poses += [one.pose for one in sorted(found, key=self.score)[-2:]]
        again = [self._fit_order(own, pose, names) for pose in poses]
        again += [one for one in found if (one.order == own).all()]
        rivals = [one for one in found if (one.order != own).any()]
        return [max(again, key=self.score), *rivals]

    def score(self, one: _Candidate) -> float:
        """Return the log likelihood of an order with its position priors, less the log number of rivals."""
        variance = max(one.squares / self.lit, self.least_variance)
        fits = -0.5 * self.lit * np.log(variance) - 0.5 * one.squares / variance
        return float(fits - 0.5 * one.moved - one.rivals)

    def refit(self, one: _Candidate, other: _Candidate, names: list[Order]) -> _Candidate:
        """Return an order as it was fitted, or from the best of a lattice of press positions if that is better.

        The lattice is searched about its own fit and about that of another order: none may win by press positions that
        the other has just missed.
        """
        starts = [
            (pose, self._search_slack(one.order, pose, slack))
            for pose, slack in ((one.pose, one.slack_m), (other.pose, other.slack_m))
        ]
        again = [self._fit_order(one.order, pose, names, slack) for pose, slack in starts]
        return max(one, *again, key=self.score)

    def explains(self, nominal: _Candidate, one: _Candidate) -> bool:
        """Return whether an order explains the traces of the taxels that it moves."""
        moved = np.flatnonzero(one.order != nominal.order)
        here, there = (self._nominal_images(c.pose, c.slack_m).shares for c in (nominal, one))
        before = self._differences(here, nominal.order)[:, moved]
        after = self._differences(there, one.order)[:, moved]
        left = float((after**2).sum()) / max(float((before**2).sum()), 1e-300)
        return left < 1 - _MIN_EXPLAINED

    def _search_from(self, order: Ints, pose: Floats, names: list[Order]) -> _Candidate:
        """Return the best of all permutations, searched in turn with pose and press positions."""
        slack = np.zeros((len(self.observed), 2))
        for _ in range(_ROUNDS):
            pose = self._fit_pose(order, pose, slack)
            slack = self._fit_slack(order, pose, slack)
            last, order = order, _assign_traces(self._trace_products(pose, slack))
            if (order == last).all():
                break
        order = self._simplify(order, self._trace_products(pose, slack))
        return self._fit_order(order, pose, names)

    def _simplify(self, order: Ints, matrices: tuple[Floats, Floats]) -> Ints:
        """Return the best order that a few exchanges lead to, without cycles that explain less than they cost."""
        pairs = _pair_costs(matrices)
        columns = np.arange(len(order))
        own = (self.weight * self.observed**2).sum(axis=0)
        square = max(
            float((own[order] + pairs[order, columns]).sum()) / max(self.lit, 1), self.least_variance, 1e-30
        )
        # Taxels that are seldom pressed join any cycle at no cost but the number of rivals.
        nats = pairs / (2 * square)
        order = min(
            (_exchange_taxels(one, nats) for one in (order, columns)),
            key=lambda one: float(nats[one, columns].sum()) + _log_permutations(one),
        )
        kept = columns.copy()
        for cycle in _find_cycles(order):
            before, after = own[cycle] + pairs[cycle, cycle], own[order[cycle]] + pairs[order[cycle], cycle]
            before, after = float(before.sum()), float(after.sum())
            enough = len(cycle) * np.log(len(order)) + _WIN_NATS
            if before - after > 2 * square * enough and after < (1 - _MIN_EXPLAINED) * before:
                kept[cycle] = order[cycle]
        return kept

    def _fit_order(
        self, order: Ints, pose: Floats, names: list[Order], slack: Floats | None = None
    ) -> _Candidate:
        """Fit pose and press positions to an order; return the candidate."""
        slack = np.zeros((len(self.observed), 2)) if slack is None else slack
        for _ in range(_ROUNDS):
            pose = self._fit_pose(order, pose, slack)
            slack = self._fit_slack(order, pose, slack)
        off = self._differences(self._nominal_images(pose, slack).shares, order)
        moved = float((slack**2).sum()) / self.sigma_m**2 + float(
            ((pose[_POSE:] / self.field_sigma) ** 2).sum()
        )
        return _Candidate(order, _log_rivals(order, names), pose, slack, float((off**2).sum()), moved)

    def _build_starts(self) -> list[Floats]:
        """Return a grid of starting poses."""
        span = self.high[:3] - self.low[:3]
        steps = np.array([0.6 * self.pitch, 0.6 * self.pitch, np.radians(25.0)])
        counts = np.clip(np.ceil(span / steps), 1, [6, 6, 15]).astype(np.intp) + 1
        ends = zip(self.low[:3].tolist(), self.high[:3].tolist(), counts.tolist(), strict=True)
        axes: list[Floats] = [np.linspace(low, high, count) for low, high, count in ends]
        poses: Floats = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 3)
        width = np.full((len(poses), 2), np.log((0.45 * self.pitch) ** 2))
        straight = np.zeros((len(poses), 2 * self.basis.shape[1]))
        both: Floats = np.concatenate([poses, width, straight], axis=1)
        return list(both)

    def _nominal_images(self, pose: Floats, slack_m: Floats | None = None) -> _NominalImages:
        """Return nominal images of any scale: a Gaussian of the contact's width, with the force as volume."""
        cos, sin = np.cos(pose[2]), np.sin(pose[2])
        u, v = self.layout.centres_m.T
        place = self.place_m + self.basis @ pose[_POSE:].reshape(2, -1).T
        if slack_m is not None:
            place = place + slack_m
        across = place[:, :1] - pose[0] - (u * cos - v * sin)
        along = place[:, 1:] - pose[1] - (u * sin + v * cos)
        size = self.layout.sizes_m**2 / 12
        wide, long = (np.exp(pose[3 + i]) * self.spread[:, None] + size[:, i] for i in (0, 1))
        area = np.prod(self.layout.sizes_m, axis=1)
        bump = np.exp(-0.5 * (across**2 / wide + along**2 / long)) / np.sqrt(wide * long)
        return _NominalImages(self.force_n[:, None] * area * bump, across, along, wide, long)

    def _apply_order(self, shares: Floats, order: Ints) -> tuple[Floats, Floats, float, float]:
        """Return observed values and weights (K, J) in an order, the best scale, and the power of the images."""
        observed, weight = self.observed[:, order], self.weight[:, order]
        power = max(float((weight * shares**2).sum()), 1e-300)
        return observed, weight, max(float((weight * shares * observed).sum()), 0.0) / power, power

    def _differences(self, shares: Floats, order: Ints) -> Floats:
        """Return weighted differences (K, J) in an order, with the best scale."""
        observed, weight, scale, _ = self._apply_order(shares, order)
        return np.sqrt(weight) * (scale * shares - observed)

    def _difference_slopes(self, images: _NominalImages, pose: Floats, order: Ints) -> Floats:
        """Return slopes (K J, P) of the differences by the pose, including the change of the best scale."""
        shares, across, along, wide, long = images
        u, v = self.layout.centres_m.T
        cos, sin = np.cos(pose[2]), np.sin(pose[2])
        to_across, to_along = across / wide, along / long
        growth = np.exp(pose[3:_POSE, None]) * self.spread
        by = shares[..., None] * np.stack(
            [
                to_across,
                to_along,
                to_along * (u * cos - v * sin) - to_across * (u * sin + v * cos),
                0.5 * growth[0][:, None] * (to_across**2 - 1.0 / wide),
                0.5 * growth[1][:, None] * (to_along**2 - 1.0 / long),
                *(-way * one[:, None] for way in (to_across, to_along) for one in self.basis.T),
            ],
            axis=-1,
        )
        observed, weight, scale, power = self._apply_order(shares, order)
        rise = np.einsum("kj,kja->a", weight * (observed - 2 * scale * shares), by) / power * (scale > 0)
        slopes = np.sqrt(weight)[..., None] * (scale * by + shares[..., None] * rise)
        return slopes.reshape(-1, len(pose))

    def _trace_products(self, pose: Floats, slack_m: Floats | None = None) -> tuple[Floats, Floats]:
        """Return products (J, J) of measured and predicted traces, and weighted squares of the predicted ones."""
        shares = self._nominal_images(pose, slack_m).shares
        shares = shares / max(float(np.sqrt((shares**2).mean())), 1e-300)
        return (self.weight * self.observed).T @ shares, self.weight.T @ shares**2

    def _fit_pose(self, order: Ints, pose: Floats, slack_m: Floats) -> Floats:
        """Fit the pose, with the smooth error of positions, to an order and press positions."""
        scale = np.concatenate([[1e-3, 1e-3, 0.1, 1.0, 1.0], self.field_sigma])
        inside = np.clip(pose, self.low + 1e-9, self.high - 1e-9)

        @lru_cache(maxsize=1)
        def images(x: bytes) -> _NominalImages:  # differences and slopes are evaluated at the same point
            return self._nominal_images(np.frombuffer(x) * scale, slack_m)

        def off(x: Floats) -> Floats:
            return self._differences(images(x.tobytes()).shares, order)

        # Scale the prior of the field by the residual noise, so that both terms have one unit.
        one = np.sqrt(self._variance(off(inside / scale)))
        prior = one * np.eye(len(pose))[_POSE:]
        got = least_squares(
            lambda x: np.concatenate([off(x).ravel(), one * x[_POSE:]]),
            inside / scale,
            lambda x: np.concatenate(
                [self._difference_slopes(images(x.tobytes()), x * scale, order) * scale, prior]
            ),
            bounds=(self.low / scale, self.high / scale),
            max_nfev=12,
        )
        return got.x * scale

    def _variance(self, off: Floats) -> float:
        """Return the variance of differences (K, J) of lit readings, at least that of a nominal contact."""
        return max(float((off**2).mean()), self.least_variance, 1e-30)

    def _fit_slack(self, order: Ints, pose: Floats, slack_m: Floats) -> Floats:
        """Fit the press positions within their slack, by Gauss-Newton."""
        sigma, slack, step = self.sigma_m, slack_m, 0.5 * self.pitch
        noise = self._variance(self._differences(self._nominal_images(pose, slack).shares, order))
        for _ in range(4):
            shares, across, along, wide, long = self._nominal_images(pose, slack)
            observed, weight, scale, _ = self._apply_order(shares, order)
            image = scale * shares
            by = np.stack([-image * across / wide, -image * along / long], axis=-1)
            hessian = np.einsum("kj,kja,kjb->kab", weight, by, by) / noise
            slope = np.einsum("kj,kja->ka", weight * (image - observed), by) / noise + slack / sigma**2
            hessian += np.eye(2) * (1 / sigma**2 + 1e-12)
            slack = np.clip(
                slack + np.clip(-solve_small(hessian, slope), -step, step), -self.bound_m, self.bound_m
            )
        return slack

    def _search_slack(self, order: Ints, pose: Floats, slack_m: Floats) -> Floats:
        """Return the best position of each press on a lattice within its slack, the present ones included."""
        tried = [slack_m, *(np.broadcast_to(at, slack_m.shape) for at in self.bound_m * _LATTICE)]
        _, _, scale, _ = self._apply_order(self._nominal_images(pose, slack_m).shares, order)
        observed, weight = self.observed[:, order], self.weight[:, order]
        squares = [weight * (scale * self._nominal_images(pose, at).shares - observed) ** 2 for at in tried]
        noise = self._variance(np.sqrt(squares[0]))
        losses = [
            off.sum(axis=1) / noise + (at**2).sum(axis=1) / self.sigma_m**2
            for off, at in zip(squares, tried, strict=True)
        ]
        return np.stack(tried)[np.argmin(losses, axis=0), np.arange(len(slack_m))]


def _smooth_basis(place_m: Floats) -> Floats:
    """Return functions (K, 6) of a smooth error of positions: constant, linear, quadratic, each of rms about one."""
    off = place_m - place_m.mean(axis=0)
    x, y = (off / np.maximum(off.std(axis=0), 1e-9)).T
    return np.stack([np.ones_like(x), x, y, (x**2 - 1) / np.sqrt(2), x * y, (y**2 - 1) / np.sqrt(2)], axis=1)


def _pair_costs(matrices: tuple[Floats, Floats]) -> Floats:
    """Return squared differences (J, J) of measured and predicted traces, up to a term that no order changes."""
    product, square = matrices
    best = linear_sum_assignment(product, maximize=True)
    scale = float(product[best].sum()) / max(float(square[best].sum()), 1e-300)
    return scale**2 * square - 2 * scale * product


def _assign_traces(matrices: tuple[Floats, Floats]) -> Ints:
    """Return the best assignment of measured traces to all positions together."""
    # Transposed, the rows are positions, in order.
    return np.asarray(linear_sum_assignment(_pair_costs(matrices).T)[1], dtype=np.intp)


def _order_costs(matrices: tuple[Floats, Floats], orders: Ints) -> Floats:
    """Return squared differences (O,) of orders (O, J) with their best scales, up to an order-independent term."""
    product, square = matrices
    columns: Ints = np.arange(orders.shape[-1], dtype=np.intp)
    found, power = product[orders, columns].sum(axis=1), square[orders, columns].sum(axis=1)
    return -(np.maximum(found, 0.0) ** 2) / np.maximum(power, 1e-300)


def _exchange_taxels(order: Ints, nats: Floats) -> Ints:
    """Return the order after exchanges of two taxels, as long as one lowers its cost.

    Args:
        order: (J,) permutation.
        nats: (J, J) cost of each taxel at each position; the log number of permutations is added.
    """
    order, columns = order.copy(), np.arange(len(order))
    rivals = _log_permutations_of(len(order), np.arange(len(order) + 1))
    while True:
        there, own, moved = nats[order], nats[order, columns], int((order != columns).sum())
        settles = np.zeros((len(order), len(order)), dtype=np.intp)
        settles[columns, order] = 1
        more = np.add.outer(settles.diagonal(), settles.diagonal()) - settles - settles.T
        gain = (
            np.add.outer(own, own)
            - there
            - there.T
            + rivals[moved]
            - rivals[np.clip(moved + more, 0, len(order))]
        )
        a, b = np.unravel_index(np.argmax(np.triu(gain, 1)), gain.shape)
        if gain[a, b] <= 1e-9:
            return order
        order[[a, b]] = order[[b, a]]


def _find_cycles(order: Ints) -> list[Ints]:
    """Return the cycles of a permutation."""
    left, cycles = set(np.flatnonzero(order != np.arange(len(order))).tolist()), list[Ints]()
    while left:
        cycle = [left.pop()]
        while (following := int(order[cycle[-1]])) != cycle[0]:
            cycle.append(following)
            left.discard(following)
        cycles.append(np.array(cycle, dtype=np.intp))
    return cycles


def _log_rivals(order: Ints, names: list[Order]) -> float:
    """Return the log number of orders that compete with an order; a named one only competes with the named ones."""
    named = any((one.order == order).all() for one in names)
    return min(_log_permutations(order), float(np.log(len(names)))) if named else _log_permutations(order)


def _log_permutations(order: Ints) -> float:
    """Return the log number of permutations that move at most as many taxels."""
    return float(_log_permutations_of(len(order), int((order != np.arange(len(order))).sum())))


def _log_permutations_of(taxels: int, moved: Ints | int) -> Floats:
    """Return the log number of ways to move so many of the taxels."""
    return gammaln(taxels + 1) - gammaln(taxels - np.asarray(moved) + 1)
