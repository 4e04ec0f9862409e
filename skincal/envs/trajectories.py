"""Target trajectories in patch coordinates, one target for each step of the policy."""

from __future__ import annotations

import math
from collections.abc import Callable
from pathlib import Path
from typing import Final

import numpy as np
from numpy.typing import ArrayLike

from skincal.bounded import parse_csv, read_text
from skincal.errors import input_error, text_of
from skincal.files import reason
from skincal.model.arrays import FloatArray

POLICY_HZ: Final = 10
"""Steps of policy and skin (the paper's) [Hz]."""
SPEED_M_PER_S: Final = (1e-3, 8e-3)
"""Speeds of the random targets; the evaluated circle runs at 5.2 mm/s [m/s]."""
SMOOTH_STEPS: Final = 5
"""Corners of the random targets are rounded over up to so many steps."""
CIRCLE_RADIUS_M: Final = 5e-3
TO_SIDE_S: Final = 2.0
ROUND_S: Final = 6.0
MOST_M: Final = 0.5
"""Largest distance of a target from the middle of a skin [m]."""
BOLT_AMPLITUDE_M: Final = 6e-3
BOLT_HZ: Final = (0.25, 0.5)
ORIENTATIONS_DEG: Final = (-45.0, 0.0, 45.0, 90.0)
"""Orientations of the bolt (the paper's); the episodes of an evaluation take turns [°]."""


def wander(rng: np.random.Generator, steps: int, half_width_m: float) -> FloatArray:
    """Return targets (steps, 2) [m] that wander in a box, from its centre.

    Straight ways at constant speeds between places drawn in the box, the corners rounded more or less.
    """
    rounding = int(rng.integers(1, SMOOTH_STEPS + 1))
    parts, here, count = [np.zeros((rounding, 2))], np.zeros(2), 0
    while count < steps + rounding:
        there = rng.uniform(-half_width_m, half_width_m, 2)
        speed = rng.uniform(*SPEED_M_PER_S)
        number = max(1, math.ceil(float(np.linalg.norm(there - here)) / speed * POLICY_HZ))
        share = np.arange(1, number + 1)[:, None] / number
        parts.append(here + share * (there - here))
        here, count = there, count + number
    way = np.cumsum(np.concatenate([np.zeros((1, 2)), *parts]), axis=0)
    # The mean over the last steps: starts at the centre, and at rest.
    return (way[rounding:] - way[:-rounding])[:steps] / rounding


def circle(steps: int) -> FloatArray:
    """Return the paper's evaluation (steps, 2) [m]: 2 s from the centre to the side, then rounds of 6 s."""
    time = np.arange(steps) / POLICY_HZ
    out = CIRCLE_RADIUS_M * np.minimum(time / TO_SIDE_S, 1.0)
    angle = 2 * np.pi * np.maximum(time - TO_SIDE_S, 0.0) / ROUND_S
    return np.stack([out * np.cos(angle), out * np.sin(angle)], axis=1)


def sine(steps: int, frequency_hz: float) -> FloatArray:
    """Return the bolt's way along its normal (steps, 1) [m]."""
    phase = 2 * np.pi * frequency_hz * np.arange(steps) / POLICY_HZ
    return BOLT_AMPLITUDE_M * np.sin(phase)[:, None]


FIXED: Final[dict[str, Callable[[int], FloatArray]]] = {
    "circle": circle,
    "still": lambda steps: np.zeros((steps, 2)),
}
"""Trajectories of the marble that are always the same, by name."""


def planned(trajectory: str | ArrayLike, steps: int) -> FloatArray:
    """Return targets (steps, 2) [m]: of a name in :data:`FIXED`, or given ones (N, 2) [m], the last of which stays."""
    if isinstance(trajectory, str):
        return FIXED[trajectory](steps)
    given = np.asarray(trajectory, dtype=np.float64)[:steps]
    return np.concatenate([given, np.repeat(given[-1:], steps - len(given), axis=0)])


def read_targets(path: Path) -> list[list[float]]:
    """Return the trajectory (T, 2) of a CSV file [m].

    Raises:
        InputError: it has no columns u_m and v_m, or a target that lies on no skin.
    """
    try:
        header, *rows = parse_csv(read_text(path)) or [[]]
        u, v = (header.index(name) for name in ("u_m", "v_m"))
        targets = [[float(row[u]), float(row[v])] for row in rows if row]
        if beyond := [x for target in targets for x in target if not abs(x) <= MOST_M]:
            raise ValueError(f"a target at {beyond[0]:g} m; no skin is larger than {MOST_M:g} m")
        if not targets:
            raise ValueError("no rows")
        return targets
    except (OSError, ValueError, IndexError) as error:
        got = reason(error) if isinstance(error, OSError) else text_of(error)
        expected = "circle, random, still, or a CSV file with the columns u_m and v_m [m]"
        raise input_error(f"--trajectory {path}", expected, got) from error
