"""Values of an episode: drawn from ranges, nominal, or given."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Final

import numpy as np
from numpy.typing import ArrayLike

from skincal.effects import EFFECTS
from skincal.envs.needed import ObjectName
from skincal.envs.pinch import Pinch
from skincal.errors import InputError, Problem, input_error
from skincal.model.arrays import FloatArray
from skincal.ranges import NAMES, PRESETS, Ranges
from skincal.ranges.names import EFFECTS_PREFIX, find
from skincal.ranges.sampling import Draw, Draws

Value = Draw
Values = dict[str, Value]
"""Draws by full name: a float, or an array of one value a joint, a taxel or a direction."""

RIG_EFFECTS: Final = tuple(name for name, effect in EFFECTS.items() if effect.of_rig)
"""Effects of the rig that measured, not of the skin: where the true contact is known they have no place."""


class Drawer:
    """Draws the values of episodes and steps for one task.

    All parameters of the ranges are drawn in the same order whatever is made of them, so that one seed gives one marble
    for every policy.
    """

    def __init__(self, ranges: Ranges, kind: ObjectName, pinch: Pinch, taxels: int) -> None:
        self.ranges = ranges
        self._kind: ObjectName = kind
        self._joints, self._taxels = pinch.joints, taxels
        self._defaults = _defaults(kind, pinch, taxels)
        self._check_sizes()
        self._nominal = self._defaults | self._middles()
        self.names = tuple(self._nominal)

    def _check_sizes(self) -> None:
        """Lists of the ranges have a number for each joint and taxel, or a draw fails."""
        rng = np.random.default_rng(0)
        try:
            self._step_draws(rng, self._episode_draws(rng))
        except ValueError as error:
            raise input_error("ranges", "one number, or one for each", error) from error

    def _episode_draws(self, rng: np.random.Generator) -> Draws:
        return self.ranges.draw(rng, "episode", joints=self._joints, taxels=self._taxels)

    def _step_draws(self, rng: np.random.Generator, episode: Draws) -> Draws:
        return self.ranges.draw(rng, "step", joints=self._joints, taxels=self._taxels, episode=episode)

    @property
    def ignored(self) -> tuple[str, ...]:
        """Parameters of the ranges that the task does not use: effects of a rig, not of the skin."""
        return tuple(
            path for path in self.ranges if path.startswith(EFFECTS_PREFIX) and not self._concerns(path)
        )

    @property
    def nominal(self) -> Values:
        """Values with nothing randomized: the middle of each range, no noise."""
        return dict(self._nominal)

    def episode(
        self, rng: np.random.Generator, randomize: Sequence[str] | None, given: Mapping[str, ArrayLike]
    ) -> tuple[Values, Draws]:
        """Return values of an episode.

        Args:
            rng: advanced by the draws.
            randomize: names, or tables, that are drawn, the rest being nominal; None: all.
            given: values that take the place of draws.

        Returns:
            All values, those drawn per step being nominal ones; and the draws themselves, which the steps need.
        """
        sample = self._episode_draws(rng)
        drawn = {path: value for path, value in sample.items() if path in self._nominal}
        values = self._nominal | {path: v for path, v in drawn.items() if is_chosen(path, randomize)}
        for path, value in given.items():
            values[path] = self._shaped(path, value)
        return {path: _copy(value) for path, value in values.items()}, sample

    def step(
        self,
        rng: np.random.Generator,
        episode: Draws,
        randomize: Sequence[str] | None,
        given: Mapping[str, ArrayLike],
    ) -> Values:
        """Return what is drawn anew in a step: noise and forces; of what is not randomized, the nominal value."""
        drawn = self._step_draws(rng, episode)
        return {
            path: value if is_chosen(path, randomize) and path not in given else _copy(self._nominal[path])
            for path, value in drawn.items()
            if path in self._nominal
        }

    def check_names(self, names: Sequence[str], place: str) -> None:
        """Check names of parameters or tables.

        Raises:
            InputError: one that the task does not have.
        """
        for name in names:
            if not any(_matches(path, name) for path in self.names):
                tables = sorted({path.rpartition(".")[0] for path in self.names})
                expected = f"tables ({', '.join(tables)}) or parameters ({', '.join(self.names)})"
                raise input_error(place, expected, repr(name))

    def _shaped(self, path: str, value: ArrayLike) -> Value:
        nominal = self._nominal[path]
        array = np.asarray(value, dtype=np.float64)
        try:
            return (
                float(array)
                if isinstance(nominal, float | int)
                else np.broadcast_to(array, np.shape(nominal)).copy()
            )
        except (TypeError, ValueError) as error:
            expected = "one number" if isinstance(nominal, float | int) else f"one number, or {nominal.size}"
            raise input_error(f"options values {path}", expected, f"shape {array.shape}") from error

    def _middles(self) -> Values:
        found: Values = {}
        joint = self.ranges.joint
        for path, parameter in self.ranges.items():
            if self._concerns(path):
                found[path] = self._broadcast(path, parameter.middle())
        if joint is not None:
            middle = joint.draws.mean(axis=0)
            found |= {path: float(v) for path, v in zip(joint.columns, middle, strict=True)}
        return found

    def _broadcast(self, path: str, middle: FloatArray) -> Value:
        """Return the middle in the shape of a draw."""
        default = self._defaults.get(path)
        if default is None:
            return float(middle) if middle.ndim == 0 else middle
        return (
            float(middle)
            if isinstance(default, float | int)
            else np.broadcast_to(middle, default.shape).copy()
        )

    def _concerns(self, path: str) -> bool:
        if path.startswith(EFFECTS_PREFIX):
            return path.split(".")[2] not in RIG_EFFECTS
        return path in self._defaults


def effects_of(values: Values) -> dict[str, dict[str, Value]]:
    """Return parameters of effects by effect."""
    found: dict[str, dict[str, Value]] = {}
    for path, value in values.items():
        if path.startswith(EFFECTS_PREFIX):
            _, _, effect, parameter = path.split(".")
            found.setdefault(effect, {})[parameter] = value
    return found


def _defaults(kind: ObjectName, pinch: Pinch, taxels: int) -> Values:
    """Return defaults for what ranges leave out: the hand's own values, the middle of the paper's ranges, or 0."""
    description, mount = pinch.description, pinch.description.meta.mount
    n = pinch.joints
    give = description.compliance_rad_per_nm
    own: Values = {
        "finger.k_p_nm_per_rad": description.gains.stiffness_nm_per_rad,
        "finger.k_d_nms_per_rad": description.gains.damping_nms_per_rad,
        "finger.parasitic_stiffness_nm_per_rad": np.full(n, 25.0) if give is None else 1 / give,
        "finger.lateral_friction": 1.0,
        "skin.y_m": mount.y_m,
        "skin.beta_deg": mount.beta_deg or 0.0,
        "skin.alpha_deg": mount.alpha_deg,
        "skin.contact_law.exponent": 1.0,
        "skin.contact_law.radius_scale": 1.0,
    }
    shapes: dict[str, int | None] = {
        "scalar": None, "joint": n, "joint_12": n // 3 * 2, "joint_3": n // 3, "xyz": 3, "taxel": taxels,
    }  # fmt: skip
    published = PRESETS["iros24"]
    values: Values = {}
    for path, name in NAMES.items():
        if path == "skin.x_m" or (path.startswith("object.") and not path.startswith(f"object.{kind}.")):
            continue
        size = shapes[name.shape]
        middle = own.get(path, published[path].middle() if path in published else 0.0)
        values[path] = float(middle) if size is None else np.broadcast_to(middle, (size,)).astype(np.float64)
    return values


def _matches(path: str, name: str) -> bool:
    return path == name or path.startswith(name + ".")


def is_chosen(path: str, randomize: Sequence[str] | None) -> bool:
    """Return whether a parameter is among those that are randomized; None: all are."""
    return randomize is None or any(_matches(path, name) for name in randomize)


def _copy(value: Value) -> Value:
    return value if isinstance(value, float) else np.array(value)


def check_given(given: Mapping[str, ArrayLike], drawer: Drawer) -> None:
    """Check values that take the place of draws.

    Raises:
        InputError: unknown names, values that are not finite or beyond what makes sense.
    """
    found: list[Problem] = []
    for path, value in given.items():
        name = find(path)
        if name is None or path not in drawer.names:
            found.append(Problem("options values", f"one of {', '.join(drawer.names)}", repr(path)))
            continue
        array = np.asarray(value, dtype=np.float64)
        if not (np.isfinite(array).all() and (array >= name.least).all() and (array <= name.most).all()):
            expected = f"{name.least:g} to {name.most:g} {name.unit}"
            found.append(Problem(f"options values {path}", expected, str(value)))
    if found:
        raise InputError(found)


def number(values: Values, path: str) -> float:
    """Return a draw that is one number."""
    value = values[path]
    assert isinstance(value, float)
    return value


def array(values: Values, path: str) -> FloatArray:
    """Return a draw of one number each joint, taxel or direction."""
    value = values[path]
    assert not isinstance(value, float | int)
    return value


def turn_rad(values: Values, name: str) -> float:
    """Return an angle of the draws [rad]."""
    return math.radians(number(values, name))
