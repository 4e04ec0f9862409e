"""A set of randomized parameters by full name, the joint draws of a calibration, and drawing from both."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property, lru_cache
from typing import Any, cast

import numpy as np
from numpy.typing import ArrayLike

from skincal.errors import InputError, Problem
from skincal.model.arrays import FloatArray
from skincal.ranges.names import (
    EFFECTS_PREFIX,
    NAMES,
    Shape,
    collection_problems,
    find,
    joint_problems,
    sort_key,
)
from skincal.ranges.parameter import DISTRIBUTIONS, MODES, Mode, Parameter, Source

Draw = float | FloatArray
Draws = Mapping[str, Draw]
"""Draws by the full names of their parameters."""
Sample = dict[str, Any]
"""Nested dictionaries by the tables of the file; the leaves are :data:`Draw`."""


@dataclass(frozen=True, eq=False)
class JointDraws:
    """Joint draws: parameters of the skin that are drawn together, one row per episode.

    The parameters of a calibration depend on each other (a stiffer skin goes with another place of the
    patch). A box of intervals loses this dependence; the joint draws keep it.

    Attributes:
        columns: full names: ``("skin.y_m", "skin.beta_deg", ...)``.
        draws: one row per draw, shape (N, columns), read-only.
        source: where the draws come from.
    """

    columns: tuple[str, ...]
    draws: FloatArray
    source: Source = "calibrated"

    def __init__(self, columns: Iterable[str], draws: ArrayLike, source: Source = "calibrated") -> None:
        object.__setattr__(self, "columns", tuple(columns))
        array = np.array(draws, dtype=np.float64)
        array.setflags(write=False)
        object.__setattr__(self, "draws", array)
        object.__setattr__(self, "source", source)
        if found := joint_problems(self.columns, self.draws, source, "[skin.joint]"):
            raise InputError(found)

    def __len__(self) -> int:
        return len(self.draws)

    def __eq__(self, other: object) -> bool:
        if not isinstance(other, JointDraws):
            return NotImplemented
        same_names = self.columns == other.columns and self.source == other.source
        return same_names and np.array_equal(self.draws, other.draws)


@dataclass(frozen=True, eq=False, repr=False)
class Ranges(Mapping[str, Parameter]):
    """An immutable mapping from full names (``skin.y_m``) to randomized parameters.

    A parameter that is not in it is not randomized. Joint draws take precedence over the ranges of the same
    names, which stay as the box around them.

    Attributes:
        parameters: by full name, in the order of ``NAMES``.
        joint: parameters that are drawn together, or None.
        provenance: where the ranges come from: preset, dataset, version.
        warnings: warnings from their making; not written to files.

    Raises:
        InputError: unknown names, figures out of bounds, a dangling ``sigma_from``; all are reported.
    """

    parameters: Mapping[str, Parameter]
    joint: JointDraws | None = None
    provenance: Mapping[str, str] = field(default_factory=dict[str, str])
    warnings: Sequence[Problem] = ()

    def __post_init__(self) -> None:
        if found := collection_problems(self.parameters):
            raise InputError(found)
        ordered = {path: self.parameters[path] for path in sorted(self.parameters, key=sort_key)}
        object.__setattr__(self, "parameters", ordered)
        object.__setattr__(self, "provenance", dict(self.provenance))
        object.__setattr__(self, "warnings", tuple(self.warnings))

    @cached_property
    def _drawn(self) -> dict[str, dict[str, Parameter]]:
        """Parameters that are drawn by themselves, by mode."""
        together = () if self.joint is None else self.joint.columns
        return {
            mode: {path: p for path, p in self.items() if p.mode == mode and path not in together}
            for mode in MODES
        }

    def __getitem__(self, path: str) -> Parameter:
        return self.parameters[path]

    def __iter__(self) -> Iterator[str]:
        return iter(self.parameters)

    def __len__(self) -> int:
        return len(self.parameters)

    def __eq__(self, other: object) -> bool:
        if not isinstance(other, Ranges):
            return NotImplemented
        same_rest = self.joint == other.joint and self.provenance == other.provenance
        return self.parameters == other.parameters and same_rest

    __hash__ = None  # type: ignore[assignment]

    def __repr__(self) -> str:
        joint = f", joint cloud of {len(self.joint)}" if self.joint else ""
        return f"Ranges({len(self)} parameters, {len(self.calibrated())} calibrated{joint})"

    def table(self, prefix: str) -> dict[str, Parameter]:
        """Return the parameters of one table (``skin``, ``object.marble``) by their short names."""
        start = prefix + "."
        return {path.removeprefix(start): p for path, p in self.items() if path.startswith(start)}

    def calibrated(self) -> tuple[str, ...]:
        """Return the full names of the parameters that a fit to data gave."""
        return tuple(path for path, parameter in self.items() if parameter.source == "calibrated")

    def require(self, paths: Iterable[str]) -> None:
        """Check that the parameters which a task needs are present.

        Raises:
            InputError: some are missing; the message names all of them.
        """
        if missing := [path for path in paths if path not in self]:
            named = {path: f"{one.meaning} [{one.unit}]" for path, one in NAMES.items()}
            wanted = [(path, named.get(path, "a range")) for path in missing]
            fix = "Add the table."
            raise InputError([Problem(f"ranges, [{p}]", what, "nothing", fix) for p, what in wanted])

    def replace(self, parameters: Mapping[str, Parameter]) -> Ranges:
        """Return a copy with some parameters added or replaced."""
        return Ranges({**self, **parameters}, self.joint, self.provenance, self.warnings)

    def sample(
        self,
        rng: np.random.Generator,
        mode: Mode = "episode",
        *,
        joints: int = 6,
        taxels: int = 16,
        episode: Sample | None = None,
    ) -> Sample:
        """Draw every parameter of one mode.

        Draws do not depend on the order in which a file lists the parameters.

        Args:
            rng: the generator, advanced by the draws.
            mode: ``episode``: parameters of a whole episode; ``step``: parameters drawn at each step.
            joints: number of joints, finger by finger, three per finger.
            taxels: number of taxels J.
            episode: the episode's draws, needed for a step whose noise level is drawn per episode.

        Returns:
            Draws in nested dictionaries by the tables of the file, ``sample["skin"]["y_m"]``, in the unit of
            the name: a float, or an array of shape (joints,), per taxel (J,), for vectors (3,).

        Raises:
            ValueError: the mode is unknown, the sizes do not fit, or ``episode`` is needed and not given.
        """
        draws = None if episode is None else flat(episode)
        return nested(self.draw(rng, mode, joints=joints, taxels=taxels, episode=draws))

    def draw(
        self,
        rng: np.random.Generator,
        mode: Mode = "episode",
        *,
        joints: int = 6,
        taxels: int = 16,
        episode: Draws | None = None,
    ) -> dict[str, Draw]:
        """Draw as :meth:`sample` does, by full names instead of tables; so is ``episode``."""
        if mode not in MODES:
            raise ValueError(f"mode must be one of {', '.join(MODES)}; got {mode!r}")
        together: dict[str, Draw] = {}
        if mode == "episode" and self.joint is not None:
            # They come first, so that the others do not depend on how many there are.
            row = self.joint.draws[int(rng.integers(len(self.joint)))]
            together = dict(zip(self.joint.columns, row.tolist(), strict=True))
        drawn = {
            path: draw_one(path, parameter, rng, joints=joints, taxels=taxels, episode=episode)
            for path, parameter in self._drawn[mode].items()
        }
        return drawn | together


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
