"""Draws of parameters with a given generator."""

from __future__ import annotations

from collections.abc import Mapping
from functools import lru_cache
from typing import Any, cast

import numpy as np

from skincal.model.arrays import FloatArray
from skincal.ranges.names import EFFECTS_PREFIX, Shape, find
from skincal.ranges.parameter import DISTRIBUTIONS, Parameter

Draw = float | FloatArray
Draws = Mapping[str, Draw]
"""Draws by the full names of their parameters."""
Sample = dict[str, Any]
"""Nested dictionaries by the tables of the file; the leaves are :data:`Draw`."""


def nested(values: Mapping[str, Any]) -> Sample:
    """Return values by full name as nested dictionaries, by the tables of the file."""
    sample: Sample = {}
    for path, value in values.items():
        *tables, name = path.split(".")
        table = sample
        for key in tables:
            table = table.setdefault(key, {})
        table[name] = value
    return sample


def flat(sample: Sample, prefix: str = "") -> dict[str, Draw]:
    """Return nested draws by full name."""
    found: dict[str, Draw] = {}
    for key, value in sample.items():
        if isinstance(value, dict):
            found |= flat(cast(Sample, value), f"{prefix}{key}.")
        else:
            found[prefix + key] = value
    return found


def draw_one(
    path: str,
    parameter: Parameter,
    rng: np.random.Generator,
    *,
    joints: int,
    taxels: int,
    episode: Draws | None,
) -> Draw:
    """Draw a parameter by its full name; see :meth:`skincal.ranges.Ranges.sample`."""
    size = _size(path, parameter.size, joints=joints, taxels=taxels)
    figures = parameter.arrays
    if parameter.sigma_from is not None:
        if episode is None:
            raise ValueError(
                f"{path} takes its standard deviation from the episode's draw of {parameter.sigma_from}; "
                'pass it: sample(rng, "step", episode=ranges.sample(rng, "episode"))'
            )
        figures = {**figures, "sigma": np.asarray(episode[parameter.sigma_from], dtype=np.float64)}
    drawn = DISTRIBUTIONS[parameter.distribution].draw(figures, rng, 1 if size is None else size)
    if path.startswith(EFFECTS_PREFIX) and (name := find(path)) is not None:
        # The parameter of an effect has bounds that the skin enforces.
        drawn = np.clip(drawn, name.least, name.most)
    return float(drawn[0]) if size is None else drawn


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
