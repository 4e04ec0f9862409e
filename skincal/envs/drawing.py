"""Values of an episode: drawn from the ranges that its task needs, nominal, or given."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from copy import copy
from pathlib import Path
from typing import Final

import numpy as np
from numpy.typing import ArrayLike

from skincal.effects import EFFECTS
from skincal.envs.pinch import Pinch
from skincal.errors import InputError, Problem, input_error
from skincal.model.arrays import FloatArray
from skincal.ranges import NAMES, PRESETS, Ranges, preset, read_ranges
from skincal.ranges.names import EFFECTS_PREFIX, find
from skincal.ranges.parameter import Mode
from skincal.ranges.ranges import Draw, Draws
from skincal.tasks import ObjectName

Value = Draw
Values = dict[str, Value]
"""Draws by full name: a float, or an array of one value a joint, a taxel or a direction."""

RIG_EFFECTS: Final = tuple(name for name, effect in EFFECTS.items() if effect.of_rig)
"""Effects of the rig that measured, not of the skin: where the true contact is known they have no place."""
_ALTERNATIVES: Final = {"skin.y_offset_m": ("skin.y_m",), "skin.x_offset_m": ("skin.beta_deg",)}
"""Alternatives to a preset's parameter: a calibrated centre for an offset from the nominal one."""
_EACH_STEP: Final = ("joint_noise_rad", "random_force_n", "taxel_noise_counts")
"""Parameters that may be drawn in each step."""


class Drawer:
    """Draws the values of episodes and steps for one task.

    All parameters of the ranges are drawn in the same order whatever is made of them, so that one seed gives one marble
    for every policy.

    Attributes:
        nominal: values with nothing randomized: the middle of each range, no noise.
        names: of all parameters of the task.
    """

    def __init__(self, ranges: Ranges, kind: ObjectName, pinch: Pinch, taxels: int) -> None:
        self.ranges = ranges
        self._joints, self._taxels = pinch.joints, taxels
        self._defaults = _defaults(kind, pinch, taxels)
        rng = np.random.default_rng(0)
        try:
            # Lists of the ranges have a number for each joint and taxel, or a draw fails.
            self._draw(rng, "step", self._draw(rng, "episode"))
        except ValueError as error:
            raise input_error("ranges", "one number, or one for each", error) from error
        self.nominal = self._defaults | self._middles()
        self.names = tuple(self.nominal)

    def _draw(self, rng: np.random.Generator, mode: Mode, episode: Draws | None = None) -> Draws:
        return self.ranges.draw(rng, mode, joints=self._joints, taxels=self._taxels, episode=episode)

    @property
    def ignored(self) -> tuple[str, ...]:
        """Parameters of the ranges that the task does not use: effects of a rig, not of the skin."""
        return tuple(
            path for path in self.ranges if path.startswith(EFFECTS_PREFIX) and not self._concerns(path)
        )

    def episode(
        self,
        rng: np.random.Generator,
        randomize: Sequence[str] | None = None,
        given: Mapping[str, ArrayLike] | None = None,
    ) -> tuple[Values, Draws]:
        """Return values of an episode.

        Args:
            rng: advanced by the draws.
            randomize: names, or tables, that are drawn, the rest being nominal; None: all.
            given: values that take the place of draws.

        Returns:
            All values, those drawn per step being nominal ones; and the draws themselves, which the steps need.
        """
        sample = self._draw(rng, "episode")
        drawn = {path: v for path, v in sample.items() if path in self.nominal and is_chosen(path, randomize)}
        chosen = {path: self._shaped(path, value) for path, value in (given or {}).items()}
        values = self.nominal | drawn | chosen
        return {path: copy(value) for path, value in values.items()}, sample

    def step(
        self,
        rng: np.random.Generator,
        episode: Draws,
        randomize: Sequence[str] | None = None,
        given: Mapping[str, ArrayLike] | None = None,
    ) -> Values:
        """Return the draws of a step, noise and forces; nominal values where nothing is randomized."""
        drawn = self._draw(rng, "step", episode)
        return {
            path: v if is_chosen(path, randomize) and path not in (given or ()) else copy(self.nominal[path])
            for path, v in drawn.items()
            if path in self.nominal
        }

    def check(self, randomize: Sequence[str], given: Mapping[str, ArrayLike]) -> None:
        """Check names of parameters or tables to be randomized, and values that take the place of draws.

        Raises:
            InputError: names that the task does not have, values that are not finite or beyond what makes sense.
        """
        found: list[Problem] = []
        for path, value in given.items():
            name = find(path)
            if name is None or path not in self.names:
                found.append(Problem("options values", f"one of {', '.join(self.names)}", repr(path)))
                continue
            array = np.asarray(value, dtype=np.float64)
            if not (np.isfinite(array).all() and (array >= name.least).all() and (array <= name.most).all()):
                expected = f"{name.least:g} to {name.most:g} {name.unit}"
                found.append(Problem(f"options values {path}", expected, str(value)))
        if found:
            raise InputError(found)
        for chosen in randomize:
            if not any(_matches(path, chosen) for path in self.names):
                tables = sorted({path.rpartition(".")[0] for path in self.names})
                expected = f"tables ({', '.join(tables)}) or parameters ({', '.join(self.names)})"
                raise input_error("options randomize", expected, repr(chosen))

    def _shaped(self, path: str, value: ArrayLike) -> Value:
        nominal = self.nominal[path]
        array = np.asarray(value, dtype=np.float64)
        try:
            return _like(nominal, array)
        except (TypeError, ValueError) as error:
            expected = "one number" if isinstance(nominal, float | int) else f"one number, or {nominal.size}"
            raise input_error(f"options values {path}", expected, f"shape {array.shape}") from error

    def _middles(self) -> Values:
        middles = {path: p.middle() for path, p in self.ranges.items() if self._concerns(path)}
        # Parameters of effects have no default: they are drawn as their figures are.
        found = {
            path: _like(self._defaults.get(path, m if m.ndim else 0.0), m) for path, m in middles.items()
        }
        if (joint := self.ranges.joint) is not None:
            found |= dict(zip(joint.columns, joint.draws.mean(axis=0).tolist(), strict=True))
        return found

    def _concerns(self, path: str) -> bool:
        if path.startswith(EFFECTS_PREFIX):
            return path.split(".")[2] not in RIG_EFFECTS
        return path in self._defaults


def _like(pattern: Value, value: FloatArray) -> Value:
    """Return a value in the form of another one: as one number, or as an array of its shape."""
    if isinstance(pattern, float | int):
        return float(value)
    return np.broadcast_to(value, pattern.shape).copy()


def effects_of(values: Values) -> dict[str, dict[str, Value]]:
    """Return parameters of effects by effect."""
    found: dict[str, dict[str, Value]] = {}
    for path, value in values.items():
        if path.startswith(EFFECTS_PREFIX):
            _, _, effect, parameter = path.split(".")
            found.setdefault(effect, {})[parameter] = value
    return found


def _defaults(kind: ObjectName, pinch: Pinch, taxels: int) -> Values:
    """Return defaults of parameters without ranges: the hand's own values, the middle of the paper's ranges, or 0."""
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


def ranges_for(kind: ObjectName, ranges: Ranges | str | Path | None) -> Ranges:
    """Ranges as given, from a file, of a preset by its name, or (None) the preset ``iros24``; checked for a task.

    Raises:
        InputError: the file cannot be read, or anything in it is wrong or missing.
    """
    if ranges is None or (isinstance(ranges, str) and ranges in PRESETS):
        ranges = preset(ranges or "iros24")
    if isinstance(ranges, Ranges):
        check_ranges(ranges, kind)
        return ranges
    found = read_ranges(ranges)
    check_ranges(found, kind, Path(ranges).name)
    return found


def check_ranges(ranges: Ranges, kind: ObjectName, place: str = "ranges") -> None:
    """Check that ranges hold all parameters of a task, and that they are drawn when the task can use them.

    They must hold all that the preset they started from randomizes of the task.

    Raises:
        InputError: naming every one that is missing, and what it is, and all that is drawn at the wrong time.
    """
    there = {*ranges, *(ranges.joint.columns if ranges.joint else ())}
    if "skin.x_m" in there:
        raise InputError([_flat(place, kind)])
    base = PRESETS.get(ranges.provenance.get("preset", ""), PRESETS["iros24"])
    found = [
        _missing(path, place)
        for path in base
        if path.startswith((f"object.{kind}.", "finger.", "skin."))
        and path not in there
        and not there.intersection(_ALTERNATIVES.get(path, ()))
    ]
    found += [
        Problem(f"{place}, [{path}] mode", "episode: the task does not draw it anew in each step", "step")
        for path, parameter in ranges.items()
        if parameter.mode == "step" and not path.endswith(_EACH_STEP)
    ]
    if found:
        raise InputError(found)


def _flat(place: str, kind: ObjectName) -> Problem:
    got = "those of a flat pad (skin.x_m instead of skin.beta_deg)"
    fix = (
        "The task has no flat fingertip: pose and E of a pad on a bench do not carry over to one that is bent. "
        "Calibrate the sensor on the finger (collect on the hand, or a stage with the fingertip), or take over "
        "skin.scale_per_n alone by hand."
    )
    return Problem(place, f"ranges of a skin on a round fingertip, as the {kind} task has", got, fix)


def _missing(path: str, place: str) -> Problem:
    name = NAMES[path]
    expected = f"{name.meaning} [{name.unit}]: distribution, mode, source, and figures"
    fix = f'Add the table; for a fixed value: distribution = "constant", value = … in {name.unit}.'
    return Problem(f"{place}, [{path}]", expected, "no such table", fix)
