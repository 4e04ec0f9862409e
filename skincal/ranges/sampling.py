"""Draws of parameters with a given generator."""

from __future__ import annotations

from collections.abc import Mapping
from functools import lru_cache
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from skincal.ranges.distributions import DISTRIBUTIONS
from skincal.ranges.names import EFFECTS_PREFIX, Shape, find
from skincal.ranges.parameter import MODES, Mode, Parameter

if TYPE_CHECKING:
    from skincal.ranges.ranges import JointDraws

FloatArray = NDArray[np.float64]
Draw = float | FloatArray
Sample = dict[str, Any]
"""Nested dictionaries by the tables of the file; the leaves are :data:`Draw`."""


def draw(
    parameters: Mapping[str, Parameter],
    joint: JointDraws | None,
    rng: np.random.Generator,
    mode: Mode,
    *,
    joints: int,
    taxels: int,
    episode: Sample | None,
) -> Sample:
    """Draw every parameter of one mode; see :meth:`skincal.ranges.Ranges.sample`."""
    if mode not in MODES:
        raise ValueError(f"mode must be one of {', '.join(MODES)}; got {mode!r}")
    sample: Sample = {}
    # The joint draws come first and their box is not drawn, so that the draws do not depend on the box.
    together = _draw_row(joint, rng) if joint is not None and mode == "episode" else {}
    covered = set(joint.columns) if joint is not None else set[str]()
    for path, parameter in parameters.items():
        if parameter.mode == mode and path not in covered:
            size = _size(path, parameter.size(), joints=joints, taxels=taxels)
            put(sample, path, _draw_one(path, parameter, rng, size, episode))
    for path, value in together.items():
        put(sample, path, value)
    return sample


def get(sample: Sample, path: str) -> Draw:
    """Return the draw of a parameter by its full name.

    Raises:
        KeyError: the sample does not hold it.
    """
    node: Any = sample
    for key in path.split("."):
        node = node[key]
    return node


def put(sample: Sample, path: str, value: Draw) -> None:
    """Store a draw by its full name."""
    *tables, name = path.split(".")
    for table in tables:
        sample = sample.setdefault(table, {})
    sample[name] = value


def _draw_row(joint: JointDraws, rng: np.random.Generator) -> dict[str, float]:
    row = joint.draws[int(rng.integers(len(joint.draws)))]
    return dict(zip(joint.columns, (float(value) for value in row), strict=True))


def _draw_one(
    path: str, parameter: Parameter, rng: np.random.Generator, size: int | None, episode: Sample | None
) -> Draw:
    values = _values(path, parameter, rng, 1 if size is None else size, episode)
    return float(values[0]) if size is None else values


def _values(
    path: str, parameter: Parameter, rng: np.random.Generator, size: int, episode: Sample | None
) -> FloatArray:
    figures = parameter.arrays()
    if parameter.sigma_from is not None:
        figures["sigma"] = _sigma(path, parameter.sigma_from, episode)
    drawn = DISTRIBUTIONS[parameter.distribution].draw(figures, rng, size)
    name = find(path) if path.startswith(EFFECTS_PREFIX) else None
    # The parameter of an effect has bounds that the skin enforces.
    return drawn if name is None else np.clip(drawn, name.least, name.most)


def _sigma(path: str, sigma_from: str, episode: Sample | None) -> FloatArray:
    if episode is None:
        raise ValueError(
            f"{path} takes its standard deviation from the episode's draw of {sigma_from}; "
            'pass it: sample(rng, "step", episode=ranges.sample(rng, "episode"))'
        )
    return np.asarray(get(episode, sigma_from), dtype=np.float64)


@lru_cache(maxsize=1024)
def _size(path: str, own: int | None, *, joints: int, taxels: int) -> int | None:
    """Return the length of a draw, given the number of figures; None: a plain float."""
    name = find(path)
    shape: Shape = name.shape if name is not None else "scalar"
    if shape in ("joint_12", "joint_3") and joints % 3:
        raise ValueError(f"{path} needs three joints per finger; got joints={joints}")
    sizes: dict[Shape, int | None] = {
        "scalar": None,
        "joint": joints,
        "joint_12": joints // 3 * 2,
        "joint_3": joints // 3,
        "xyz": 3,
        "taxel": taxels,
        "pose": own,
    }
    size = sizes[shape]
    if own is not None and own != size:
        raise ValueError(
            f"{path} holds {own} numbers, but a draw has {size} (joints={joints}, taxels={taxels})"
        )
    return size
