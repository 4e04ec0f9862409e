"""The bundled protocols: ``paper``, static presses, and ``full``, presses that can show every effect."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from typing import Final

import numpy as np

from skincal.collect.plan import Kind, Plan, PlannedPress, Site
from skincal.errors import input_error
from skincal.model import TaxelLayout
from skincal.model.arrays import FloatArray

GRID_M = 1e-3
"""Spacing of the grid from which sites are drawn [m] (paper, section III)."""

ANCHOR_EVERY = 10
"""Interval of the anchor, which is also the first and the last press."""

ROUNDING = 1e-9


@dataclass(frozen=True)
class PaperProtocol:
    """Protocol of the paper (section III): each site of a grid once, with static presses.

    Attributes:
        presses: number of presses.
        forces_n: smallest and largest force [N], drawn evenly between them.
        speed_m_per_s: speed of loading and unloading [m/s].
        hold_s: length of the hold [s].
    """

    presses: int = 60
    forces_n: tuple[float, float] = (1.0, 4.0)
    speed_m_per_s: float = 0.02
    hold_s: float = 1.0


@dataclass(frozen=True)
class FullProtocol:
    """Protocol that can show every effect except that of tangential force, which is regulated to zero.

    See ``docs/collect.md`` for the purpose of each part.

    Attributes:
        regular: presses at new sites.
        repeats: exact copies of regular ones, later in the session.
        revisits: presses at the sites of regular ones, in another way.
        forces_n: smallest and largest force [N].
        speeds_m_per_s: slow and fast loading [m/s].
        holds_s: short and long hold [s].
        poses: names of the hand poses.
        anchor_force_n: force of the anchor [N].
        second_indenter: regular presses with the second indenter, if there is one, at the end.
    """

    regular: int = 50
    repeats: int = 20
    revisits: int = 16
    forces_n: tuple[float, float] = (0.3, 6.0)
    speeds_m_per_s: tuple[float, float] = (0.016, 0.04)
    holds_s: tuple[float, float] = (0.5, 1.0)
    poses: tuple[str, ...] = ("A", "B")
    anchor_force_n: float = 3.0
    second_indenter: int = 20


def paper_plan(
    rng: np.random.Generator,
    layout: TaxelLayout,
    options: PaperProtocol | None = None,
    second_indenter_m: float | None = None,
) -> Plan:
    """Draw a session of the paper's protocol.

    Raises:
        InputError: the patch is too small for this number of sites, or a second indenter is given.
    """
    if second_indenter_m is not None:
        raise input_error("--second-indenter-mm", "the full protocol", "--protocol paper")
    options = options or PaperProtocol()
    places = patch_grid(layout)
    if options.presses > len(places):
        expected = f"at most {len(places)} presses, the sites of the {1e3 * GRID_M:g} mm grid over the patch"
        raise input_error("--protocol paper", expected, options.presses)
    chosen = rng.choice(len(places), options.presses, replace=False)
    forces = rng.uniform(*options.forces_n, options.presses)
    presses = (
        PlannedPress(*site, _force(f), options.speed_m_per_s, options.hold_s)
        for site, f in zip(_sites(places[chosen]), forces, strict=True)
    )
    return Plan("paper", tuple(presses))


def full_plan(
    rng: np.random.Generator,
    layout: TaxelLayout,
    options: FullProtocol | None = None,
    second_indenter_m: float | None = None,
) -> Plan:
    """Draw a session in which no effect is confounded with another.

    Args:
        rng: generator of all randomness.
        layout: the taxels, which set the extent of the sites.
        options: options of the protocol.
        second_indenter_m: radius of a second sphere [m], for presses at the end; None: no change of the cap.
    """
    options = options or FullProtocol()
    anchor = _anchor(layout, options)
    regular = _regular(rng, spread_sites(rng, layout, options.regular, without=anchor.site), options)
    # Blocks of one pose each: the hand changes its pose once per block, and still often over the session.
    repeats = [replace(regular[i], kind="repeat") for i in _chosen(rng, regular, options.repeats)]
    pool = regular + repeats + _revisits(rng, regular, options)
    order = _in_blocks(rng, pool, options)
    presses = _with_anchors(named_by_order(order), anchor)
    if second_indenter_m is not None:
        sites = spread_sites(rng, layout, options.second_indenter, without=anchor.site)
        other = [replace(p, pose=options.poses[0]) for p in _regular(rng, sites, options)]
        presses += [replace(p, indenter_radius_m=second_indenter_m) for p in other]
    return Plan("full", tuple(presses))


PROTOCOLS: Final[Mapping[str, Callable[..., Plan]]] = {"paper": paper_plan, "full": full_plan}
"""Function of each protocol, called with a generator, a layout and ``second_indenter_m``; help is in ``tasks.py``."""


def patch_grid(layout: TaxelLayout) -> FloatArray:
    """Return a 1 mm grid over the taxels, shape (N, 2) [m], symmetric about the patch's centre."""
    axes: list[FloatArray] = []
    for k in range(2):
        low, high = layout.bounds_m[:, k]
        half = int((high - low) / 2 / GRID_M + ROUNDING)
        axes.append((low + high) / 2 + GRID_M * np.arange(-half, half + 1))
    return np.round(np.stack(np.meshgrid(*axes), axis=-1).reshape(-1, 2), 9)


def spread_sites(
    rng: np.random.Generator, layout: TaxelLayout, count: int, *, without: Site | None = None
) -> list[Site]:
    """Return sites on the grid that cover the patch evenly: the farthest of some random candidates from earlier sites.

    Args:
        rng: generator of all randomness.
        layout: the taxels.
        count: number of sites; beyond the size of the grid they repeat.
        without: a site that is not drawn [m].

    Returns:
        Sites [m], in random order.
    """
    places = patch_grid(layout)
    if without is not None:
        places = places[np.any(places != np.asarray(without), axis=1)]
    chosen: list[int] = []
    while len(chosen) < count:
        some = rng.choice(len(places), min(8, len(places)), replace=False)
        # Distances count only within one cover of the grid; a second cover starts over.
        cover = chosen[len(places) * (len(chosen) // len(places)) :]
        apart = np.linalg.norm(places[some][:, None] - places[cover], axis=2)
        away = apart.min(axis=1, initial=np.inf)
        if away.max() > 0:
            chosen.append(int(some[np.argmax(away)]))
    return _sites(places[rng.permutation(np.array(chosen, dtype=np.int64))])


def _regular(rng: np.random.Generator, sites: list[Site], options: FullProtocol) -> list[PlannedPress]:
    """Return one press per site, with forces, paces and poses evenly distributed and independent of each other."""
    count = len(sites)
    forces = _even_forces(rng, count, options.forces_n)
    speed = _balanced(rng, count, len(options.speeds_m_per_s))
    hold = _balanced(rng, count, len(options.holds_s))
    pose = _balanced(rng, count, len(options.poses))
    paces = [
        (options.speeds_m_per_s[i], options.holds_s[j], options.poses[k])
        for i, j, k in zip(speed, hold, pose, strict=True)
    ]
    return [
        PlannedPress(*site, _force(force), *pace)
        for site, force, pace in zip(sites, forces, paces, strict=True)
    ]


def _even_forces(rng: np.random.Generator, count: int, range_n: tuple[float, float]) -> FloatArray:
    """Return one force from each of ``count`` parts of the range, equal in the root: low forces are more frequent."""
    low, high = np.sqrt(range_n)
    share = (rng.permutation(count) + rng.uniform(0, 1, count)) / max(count, 1)
    return (low + (high - low) * share) ** 2


def _balanced(rng: np.random.Generator, count: int, choices: int) -> list[int]:
    """Return choices (count,) in random order, each equally often."""
    return rng.permutation(np.arange(count) % choices).tolist()


def _chosen(rng: np.random.Generator, regular: list[PlannedPress], count: int) -> list[int]:
    return rng.choice(len(regular), min(count, len(regular)), replace=False).tolist()


def _revisits(
    rng: np.random.Generator, regular: list[PlannedPress], options: FullProtocol
) -> list[PlannedPress]:
    """Return the sites of regular presses with another force, pace and pose."""
    sites = [regular[i].site for i in _chosen(rng, regular, options.revisits)]
    return [replace(press, kind="revisit") for press in _regular(rng, sites, options)]


def _in_blocks(
    rng: np.random.Generator, pool: list[PlannedPress], options: FullProtocol
) -> list[PlannedPress]:
    """Return the presses in random order, in blocks of one pose between two anchors, with alternating poses."""
    length = ANCHOR_EVERY - 1
    blocks: list[list[list[PlannedPress]]] = []
    for pose in options.poses:
        order: list[int] = rng.permutation(len(pool)).tolist()
        of_pose = [pool[i] for i in order if pool[i].pose == pose]
        blocks.append([of_pose[i : i + length] for i in range(0, len(of_pose), length)])
    first: list[int] = rng.permutation(len(blocks)).tolist()
    turns = max((len(b) for b in blocks), default=0)
    return [press for t in range(turns) for i in first if t < len(blocks[i]) for press in blocks[i][t]]


def named_by_order(order: list[PlannedPress]) -> list[PlannedPress]:
    """Return the presses with their kinds by the order.

    The first press of a site is regular; a later one is a repeat if it equals an earlier one, else a revisit.
    """
    named: list[PlannedPress] = []
    for press in order:
        before = [p for p in named if p.site == press.site]
        later: Kind = "repeat" if any(p.same_press(press) for p in before) else "revisit"
        named.append(replace(press, kind=later if before else "regular"))
    return named


def _anchor(layout: TaxelLayout, options: FullProtocol) -> PlannedPress:
    """Return the anchor: a slow press at the middle of the patch, with a medium force."""
    middle = _sites(layout.bounds_m.mean(axis=0, keepdims=True).round(9))[0]
    pace = (options.speeds_m_per_s[-1], options.holds_s[0])
    return PlannedPress(*middle, options.anchor_force_n, *pace, options.poses[0], "anchor")


def _with_anchors(order: list[PlannedPress], anchor: PlannedPress) -> list[PlannedPress]:
    """Return the order with anchors first, after every nine presses, and last; others at its site keep their kind."""
    presses: list[PlannedPress] = []
    for press in order:
        if len(presses) % ANCHOR_EVERY == 0:
            presses.append(anchor)
        presses.append(press)
    return [*presses, anchor]


def _sites(places: FloatArray) -> list[Site]:
    return [(u_m, v_m) for u_m, v_m in places.tolist()]


def _force(force_n: float) -> float:
    """Return the force rounded to millinewtons, so that plans read as they are executed."""
    return round(float(force_n), 3)
