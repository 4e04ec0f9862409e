"""Taxels in another order than the data say: which permutation of them explains the images best.

Where a press was is measured, so a nominal contact says which taxels it loads and how much. A taxel's readings over all
presses, its trace, are therefore predicted up to the sensor's pose, the width of the contact and one scale. Traces are
assigned to places by the squared differences between every measured and every predicted trace: all permutations are
searched by the assignment problem (Kuhn 1955; ``scipy.optimize.linear_sum_assignment``), and those that a cable or
a reading order makes are tried by name. Each is given its own best pose and places of the presses within their slack.
Measured positions may also err in a way that presses share: a constant beyond the range of poses, a stretch, a shear, a
bend. Every order, the one of the data among them, gets the error of this kind that suits it best, at the price of its
prior. So an order is told only if it explains what no such error does: if its score beats that of the data's order by
more than the number of permutations that were open to it.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import lru_cache
from typing import NamedTuple

import numpy as np
from scipy.optimize import least_squares, linear_sum_assignment
from scipy.special import gammaln

from skincal.fitting.fit_options import SearchBox
from skincal.fitting.presses import solve_small
from skincal.fitting.problem import FitProblem
from skincal.fitting.types import Floats, Ints
from skincal.fitting.wiring_orders import Order, mapping_of, named_orders

MOST_PRESSES = 150
"""Of more presses so many are looked at, evenly spread."""

_EXPLAINED = 0.5
"""A permutation must explain so much of what the taxels that it moves differ by (stated prior)."""

_NATS = 10.0
"""Log likelihood by which a permutation must win besides the logarithm of the number of rivals: odds of 1 to 20000."""

_ASSIGNED = 10
"""Starting poses from which all permutations are searched."""

_NAMED = 4
"""So many of the orders that have a reason get a pose and places of their own."""

_ROUNDS = 3

_POSE = 5
"""Numbers of a pose before those of the smooth error of positions."""

_BUMP = 0.05
"""A nominal contact's images differ by so much of the signal from those of a skin: 3 to 4 % from a sphere's on an
elastic foundation, plane and cylinder; of taxels that are not alike by their gains besides."""

_STRETCHED, _SHIFTED = 0.12, 0.25
"""Smooth error of positions, one sigma: stretch, shear and bend as parts of how far presses are spread, and a constant
beyond the range of poses, as a part of the pitch (stated prior)."""

_FARTHEST = 3.0
"""No error of positions is so many times what it is worth: one that mirrors or turns the patch is none."""


@dataclass(frozen=True, eq=False)
class TaxelOrder:
    """An order of the taxels that explains the images where the order of the data does not.

    Attributes:
        order: (J,) index in the data of the taxel that belongs at each place.
        mapping: the line or lines of a mapping file, under ``[taxels]``, that put it right.
        rms_before: root mean square difference from the nominal images in the order of the data, per lit reading.
        rms_after: the same in the order found.
        log_odds: log likelihood by which it wins, less the logarithm of the number of rivals.
    """

    order: Ints
    mapping: str
    rms_before: float
    rms_after: float
    log_odds: float

    @property
    def moved(self) -> Ints:
        """Places whose taxel is another."""
        return np.flatnonzero(self.order != np.arange(len(self.order)))


def order_of_problem(problem: FitProblem, box: SearchBox) -> TaxelOrder | None:
    """The order of taxels that explains the images of a problem; None where the order of the data does as well."""
    layout = problem.rig.layout
    if layout.taxels < 2 or len(problem) < 3 or not np.isfinite(problem.rig.position_sigma_m):
        return None  # a place that is not known predicts no trace
    if len(problem) > MOST_PRESSES:
        some = np.linspace(0, len(problem) - 1, MOST_PRESSES).astype(np.intp)
        problem = problem.subset(np.isin(np.arange(len(problem)), some), "one of many")
    whole = _Search(problem, box)
    if whole.lit < 2 * _POSE:
        return None  # they tell a pose at most
    names = named_orders(layout.rows, layout.cols)
    nominal, *tried = whole.candidates(names)
    for _ in range(_ROUNDS - 1):
        # From an order that is nearly right, the rest is found with a better pose.
        near = min(tried, key=lambda one: one.squares, default=nominal)
        if near.squares > (1 - _EXPLAINED) * nominal.squares:
            break
        order = near.order
        ordered = replace(problem, values=problem.values[:, order], weight=problem.weight[:, order])
        found = _Search(ordered, box).candidates(names)
        further = [replace(one, order=order[one.order]) for one in found]
        tried += [replace(one, rivals=_rivals(one.order, names)) for one in further]
        if min(further, key=lambda one: one.squares).order.tolist() == order.tolist():
            break
    one = max(tried, key=whole.score, default=nominal)
    odds = whole.score(one) - whole.score(nominal) - _NATS
    if odds <= 0 or (one.order == nominal.order).all() or not whole.explains(nominal, one):
        return None
    lit = max(int((problem.values * (problem.weight > 0) > 0).sum()), 1)
    before, after = (float(np.sqrt(c.squares / lit)) for c in (nominal, one))
    return TaxelOrder(one.order, mapping_of(one.order, layout.rows, layout.cols), before, after, odds)


@dataclass(frozen=True, eq=False)
class _Candidate:
    """An order with the pose and places that suit it best."""

    order: Ints
    rivals: float  # logarithm of the number of orders that were open to it
    pose: Floats  # (P,) centre across and along, turn, log of the contact's variances, smooth error of positions
    slack_m: Floats  # (K, 2)
    squares: float  # weighted squared differences
    moved: float  # squares of the errors of positions, smooth and of each press, in sigmas


class _Bumps(NamedTuple):
    """Nominal images, how far presses lie from taxels [m], and variances of what a taxel gets [m²]; all (K, J)."""

    shares: Floats
    across_m: Floats
    along_m: Floats
    wide_m2: Floats
    long_m2: Floats


class _Search:
    """Candidates for one session."""

    def __init__(self, problem: FitProblem, box: SearchBox) -> None:
        self.layout, self.rig = problem.rig.layout, problem.rig
        self.place_m = np.stack([problem.across_m, problem.along_m], axis=1)
        self.force_n, noise = problem.force_n, problem.noise_sigma_counts
        self.weight = np.clip(problem.weight, 0.0, 1.0) ** 2
        self.observed = np.where(self.weight > 0, problem.values, 0.0)
        lit = self.observed > max(4 * noise, 0.03 * float(self.observed.max(initial=0.0)))
        self.lit = int(lit.sum())
        self.least_variance = max(
            noise**2, _BUMP**2 * float((self.observed[lit] ** 2).mean()) if self.lit else 0.0
        )
        # Median distance of a taxel from the nearest other [m].
        self.pitch = float(np.median(self.layout.apart_m.min(axis=1)))
        self.basis = _smooth_basis(self.place_m)
        # What each function (2 M,) of a smooth error of positions is worth, one sigma [m].
        stretched = _STRETCHED * np.repeat(self.place_m.std(axis=0).max(), self.basis.shape[1])
        stretched[0] = max(_SHIFTED * self.pitch, self.rig.position_sigma_m)
        self.field_sigma = np.tile(np.maximum(stretched, 1e-9), 2)
        self.spread = np.sqrt(self.force_n / np.median(self.force_n))
        low, high = np.array([box.across_m, box.y_m, box.alpha_rad]).T
        wide = np.log([(0.1 * self.pitch) ** 2] * 2)
        widest = np.log([(30 * self.pitch) ** 2] * 2)
        field = _FARTHEST * self.field_sigma
        self.low = np.concatenate([low - 1e-6, wide, -field])
        self.high = np.concatenate([high + 1e-6, widest, field])

    def candidates(self, names: list[Order]) -> list[_Candidate]:
        """The order of the data, the best named one, and the best of all."""
        starts = self._starts()
        matrices = [self._matrices(start) for start in starts]
        orders = np.stack([one.order for one in names])
        costs = np.stack([_cost(m, orders) for m in matrices])  # (starts, orders)
        least = costs.min(axis=0)
        tried: list[int] = [0, *(np.argsort(least[1:])[:_NAMED] + 1).tolist()]
        where: list[int] = costs.argmin(axis=0).tolist()
        found = [self._refined(orders[n], starts[where[n]], names) for n in tried]
        bound = [float(_pairs(m).min(axis=0).sum()) for m in matrices]
        near: list[int] = [*(where[n] for n in tried), *np.argsort(bound)[:_ASSIGNED].tolist()]
        assigned = {s: _assigned(matrices[s]) for s in dict.fromkeys(near)}
        best = min(assigned, key=lambda s: _cost(matrices[s], assigned[s][None])[0])
        likely = max(found[1:], key=self.score, default=found[0])
        seeds = [(assigned[best], starts[best])]
        for one in (found[0], likely):
            # Bent positions suit the order that they were bent for.
            straight = np.where(np.arange(len(one.pose)) < _POSE, one.pose, 0.0)
            seeds += [(one.order, straight), (_assigned(self._matrices(straight)), straight)]
        found += [self._free(order, pose, names) for order, pose in seeds]
        # The order of the data has as good a chance of its best pose as its rivals have.
        own = orders[0]
        first: list[int] = np.argsort(costs[:, 0])[1:_NAMED].tolist()
        poses = [starts[s] for s in first]
        poses += [one.pose for one in sorted(found, key=self.score)[-2:]]
        again = [self._refined(own, pose, names) for pose in poses]
        again += [one for one in found if (one.order == own).all()]
        rivals = [one for one in found if (one.order != own).any()]
        return [max(again, key=self.score), *rivals]

    def score(self, one: _Candidate) -> float:
        """Return the log likelihood of an order with the priors of its errors of positions, less its rivals."""
        variance = max(one.squares / self.lit, self.least_variance)
        fits = -0.5 * self.lit * np.log(variance) - 0.5 * one.squares / variance
        return float(fits - 0.5 * one.moved - one.rivals)

    def explains(self, nominal: _Candidate, one: _Candidate) -> bool:
        """Return whether an order accounts for the traces of the taxels that it moves."""
        moved = np.flatnonzero(one.order != nominal.order)
        here, there = (self._bumps(c.pose, c.slack_m).shares for c in (nominal, one))
        before = self._differences(here, nominal.order)[:, moved]
        after = self._differences(there, one.order)[:, moved]
        left = float((after**2).sum()) / max(float((before**2).sum()), 1e-300)
        return left < 1 - _EXPLAINED

    def _free(self, order: Ints, pose: Floats, names: list[Order]) -> _Candidate:
        """The best of all permutations, searched in turn with pose and places."""
        slack = np.zeros((len(self.observed), 2))
        for _ in range(_ROUNDS):
            pose = self._posed(order, pose, slack)
            slack = self._placed(order, pose, slack)
            last, order = order, _assigned(self._matrices(pose, slack))
            if (order == last).all():
                break
        order = self._only_what_matters(order, self._matrices(pose, slack))
        return self._refined(order, pose, names)

    def _only_what_matters(self, order: Ints, matrices: tuple[Floats, Floats]) -> Ints:
        """The order without those exchanges that change the images by less than they cost."""
        pairs = _pairs(matrices)
        columns = np.arange(len(order))
        own = (self.weight * self.observed**2).sum(axis=0)
        square = max(
            float((own[order] + pairs[order, columns]).sum()) / max(self.lit, 1), self.least_variance, 1e-30
        )
        kept = columns.copy()
        for cycle in _cycles(order):
            before, after = own[cycle] + pairs[cycle, cycle], own[order[cycle]] + pairs[order[cycle], cycle]
            before, after = float(before.sum()), float(after.sum())
            enough = len(cycle) * np.log(len(order)) + _NATS
            if before - after > 2 * square * enough and after < (1 - _EXPLAINED) * before:
                kept[cycle] = order[cycle]
        return kept

    def _refined(self, order: Ints, pose: Floats, names: list[Order]) -> _Candidate:
        """Pose, places and score of an order."""
        slack = np.zeros((len(self.observed), 2))
        for _ in range(_ROUNDS):
            pose = self._posed(order, pose, slack)
            slack = self._placed(order, pose, slack)
        off = self._differences(self._bumps(pose, slack).shares, order)
        sigma = max(self.rig.position_sigma_m, 1e-9)
        moved = float((slack**2).sum()) / sigma**2 + float(((pose[_POSE:] / self.field_sigma) ** 2).sum())
        return _Candidate(order, _rivals(order, names), pose, slack, float((off**2).sum()), moved)

    def _starts(self) -> list[Floats]:
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

    def _bumps(self, pose: Floats, slack_m: Floats | None = None) -> _Bumps:
        """Nominal images of any scale: a bump of the contact's width, of the force's volume."""
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
        return _Bumps(self.force_n[:, None] * area * bump, across, along, wide, long)

    def _scaled(self, shares: Floats, order: Ints) -> tuple[Floats, Floats, float, float]:
        """Observed values and weights (K, J) with places in our order, the best scale, and the power of the images."""
        observed, weight = self.observed[:, order], self.weight[:, order]
        power = max(float((weight * shares**2).sum()), 1e-300)
        return observed, weight, max(float((weight * shares * observed).sum()), 0.0) / power, power

    def _differences(self, shares: Floats, order: Ints) -> Floats:
        """Weighted differences (K, J), places in our order, with the best scale."""
        observed, weight, scale, _ = self._scaled(shares, order)
        return np.sqrt(weight) * (scale * shares - observed)

    def _slopes(self, bumps: _Bumps, pose: Floats, order: Ints) -> Floats:
        """Slopes (K J, P) of the differences by the pose, the scale that suits it included."""
        shares, across, along, wide, long = bumps
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
        observed, weight, scale, power = self._scaled(shares, order)
        rise = np.einsum("kj,kja->a", weight * (observed - 2 * scale * shares), by) / power * (scale > 0)
        slopes = np.sqrt(weight)[..., None] * (scale * by + shares[..., None] * rise)
        return slopes.reshape(-1, len(pose))

    def _matrices(self, pose: Floats, slack_m: Floats | None = None) -> tuple[Floats, Floats]:
        """Products (J, J) of measured with predicted traces, and squares of the predicted ones as measured."""
        shares = self._bumps(pose, slack_m).shares
        shares = shares / max(float(np.sqrt((shares**2).mean())), 1e-300)
        return (self.weight * self.observed).T @ shares, self.weight.T @ shares**2

    def _posed(self, order: Ints, pose: Floats, slack_m: Floats) -> Floats:
        """Return the pose, with the smooth error of positions, that suits an order and places best."""
        scale = np.concatenate([[1e-3, 1e-3, 0.1, 1.0, 1.0], self.field_sigma])
        inside = np.clip(pose, self.low + 1e-9, self.high - 1e-9)

        @lru_cache(maxsize=1)
        def bumps(x: bytes) -> _Bumps:  # slopes are asked for where differences were
            return self._bumps(np.frombuffer(x) * scale, slack_m)

        def off(x: Floats) -> Floats:
            return self._differences(bumps(x.tobytes()).shares, order)

        # What a reading differs by weighs against the prior of the field.
        one = np.sqrt(self._variance(off(inside / scale)))
        prior = one * np.eye(len(pose))[_POSE:]
        got = least_squares(
            lambda x: np.concatenate([off(x).ravel(), one * x[_POSE:]]),
            inside / scale,
            lambda x: np.concatenate([self._slopes(bumps(x.tobytes()), x * scale, order) * scale, prior]),
            bounds=(self.low / scale, self.high / scale),
            max_nfev=12,
        )
        return got.x * scale

    def _variance(self, off: Floats) -> float:
        """Return the variance that differences (K, J) of lit readings show, no less than that of a nominal contact."""
        return max(float((off**2).mean()), self.least_variance, 1e-30)

    def _placed(self, order: Ints, pose: Floats, slack_m: Floats) -> Floats:
        """Places of the presses within their slack, by Gauss-Newton."""
        sigma, slack = self.rig.position_sigma_m, slack_m
        bound, step = min(self.rig.slack_m, 3 * sigma), 0.5 * self.pitch
        noise = self._variance(self._differences(self._bumps(pose, slack).shares, order))
        for _ in range(4):
            shares, across, along, wide, long = self._bumps(pose, slack)
            observed, weight, scale, _ = self._scaled(shares, order)
            image = scale * shares
            by = np.stack([-image * across / wide, -image * along / long], axis=-1)
            hessian = np.einsum("kj,kja,kjb->kab", weight, by, by) / noise
            slope = np.einsum("kj,kja->ka", weight * (image - observed), by) / noise + slack / sigma**2
            hessian += np.eye(2) * (1 / sigma**2 + 1e-12)
            slack = np.clip(slack + np.clip(-solve_small(hessian, slope), -step, step), -bound, bound)
        return slack


def _smooth_basis(place_m: Floats) -> Floats:
    """Return functions (K, 6) of a smooth error of positions: constant, linear, quadratic; each of about one, rms."""
    off = place_m - place_m.mean(axis=0)
    x, y = (off / np.maximum(off.std(axis=0), 1e-9)).T
    return np.stack([np.ones_like(x), x, y, (x**2 - 1) / np.sqrt(2), x * y, (y**2 - 1) / np.sqrt(2)], axis=1)


def _scale(matrices: tuple[Floats, Floats]) -> float:
    """Scale that suits the best pairs."""
    product, square = matrices
    order = linear_sum_assignment(product, maximize=True)
    return float(product[order].sum()) / max(float(square[order].sum()), 1e-300)


def _pairs(matrices: tuple[Floats, Floats]) -> Floats:
    """Squared differences (J, J) of measured and predicted traces, less what no order changes."""
    product, square = matrices
    scale = _scale(matrices)
    return scale**2 * square - 2 * scale * product


def _assigned(matrices: tuple[Floats, Floats]) -> Ints:
    """The measured trace that suits each place best, all places together."""
    # Transposed, the rows are places, in order.
    return np.asarray(linear_sum_assignment(_pairs(matrices).T)[1], dtype=np.intp)


def _cost(matrices: tuple[Floats, Floats], orders: Ints) -> Floats:
    """Squared differences (O,) of orders (O, J) with each its best scale, less what no order changes."""
    product, square = matrices
    columns: Ints = np.arange(orders.shape[-1], dtype=np.intp)
    found, power = product[orders, columns].sum(axis=1), square[orders, columns].sum(axis=1)
    return -(np.maximum(found, 0.0) ** 2) / np.maximum(power, 1e-300)


def _cycles(order: Ints) -> list[Ints]:
    """The exchanges that a permutation is made of."""
    left, cycles = set(np.flatnonzero(order != np.arange(len(order))).tolist()), list[Ints]()
    while left:
        cycle = [left.pop()]
        while (following := int(order[cycle[-1]])) != cycle[0]:
            cycle.append(following)
            left.discard(following)
        cycles.append(np.array(cycle, dtype=np.intp))
    return cycles


def _rivals(order: Ints, names: list[Order]) -> float:
    """Logarithm of the number of orders that were open to one; one that has a name costs no more than the names."""
    named = any((one.order == order).all() for one in names)
    return min(_freedom(order), float(np.log(len(names)))) if named else _freedom(order)


def _freedom(order: Ints) -> float:
    """Logarithm of the number of permutations that move as many taxels, and of those that move fewer of them."""
    taxels, moved = len(order), int((order != np.arange(len(order))).sum())
    return float(gammaln(taxels + 1) - gammaln(taxels - moved + 1))
