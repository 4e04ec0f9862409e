"""``hand.toml``: its schema, and the description of a hand that is read from it."""

from __future__ import annotations

import hashlib
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Literal, cast

import numpy as np

from skincal.bounded import UnreadableError, read_bytes
from skincal.dataset.findings import Findings
from skincal.dataset.keys import Key, Names
from skincal.dataset.schema import Table, load_toml, read_table
from skincal.dataset.schema_errors import Violation, report
from skincal.dataset.spec import Description
from skincal.errors import input_error
from skincal.files import real
from skincal.robot.description import (
    FingerDescription,
    FloatArray,
    HandDescription,
    ImpedanceGains,
    JointLimits,
)
from skincal.robot.urdf import MOVING, Urdf, read_urdf

FORMAT = "skincal-hand/1"

_ROUNDING_RAD = 1e-3
"""Tolerance by which limits may exceed those of the URDF [rad], for files with rounded numbers."""

_PER_JOINT = "a number, or a list with one for each joint"
_Numbers = float | tuple[float, ...]
_Any = Annotated[_Numbers, Key(_PER_JOINT)]
_Positive = Annotated[_Numbers, Key(f"{_PER_JOINT}, at least 1e-6", 1e-6)]
_NotNegative = Annotated[_Numbers, Key(f"{_PER_JOINT}, at least 0", 0.0)]
_JointNames = Annotated[tuple[str, ...], Names("a list of joint names, every joint once")]


@dataclass(frozen=True)
class _Hand(Table):
    name: str
    urdf: Annotated[str, Key("the URDF's file name")]
    max_force_n: Annotated[float, Key("a force [N] > 0", 1e-3)]


@dataclass(frozen=True)
class _Joints(Table):
    names: _JointNames
    lower_deg: _Any
    upper_deg: _Any
    velocity_deg_per_s: _Positive
    torque_nm: _Positive
    home_deg: _Any


@dataclass(frozen=True)
class _Gains(Table):
    stiffness_nm_per_rad: _Positive
    damping_nms_per_rad: _NotNegative
    low_pass_hz: Annotated[float, Key("a frequency [Hz] > 0", 1e-3)]
    compliance_rad_per_nm: _NotNegative | None = None


@dataclass(frozen=True)
class _Finger(Table):
    carries: Literal["skin", "indenter"]
    joints: _JointNames
    tip_link: Annotated[str, Key("the name of a link of the URDF")]


@dataclass(frozen=True, kw_only=True)
class _File(Description):
    hand: _Hand
    joints: _Joints
    gains: _Gains
    fingers: Mapping[str, _Finger]

    def violations(self) -> Iterator[Violation]:
        yield from super().violations()
        count, tables = len(self.joints.names), {"joints": self.joints, "gains": self.gains}
        values = {(name, key): v for name, table in tables.items() for key, v in vars(table).items()}
        del values["joints", "names"]
        for place, value in values.items():
            if isinstance(value, tuple) and len(cast("tuple[float, ...]", value)) != count:
                yield place, f"a number, or a list of {count} finite numbers", value
        angles = self.joints.lower_deg, self.joints.upper_deg, self.joints.home_deg
        lower, upper, home = map(self.per_joint, angles)
        if np.any(lower >= upper):
            yield ("joints", "upper_deg"), "more than lower_deg", self.joints.upper_deg
        if np.any((home < lower) | (home > upper)):
            yield ("joints", "home_deg"), "angles within the limits", self.joints.home_deg
        yield from self._finger_violations()
        yield from self.hand_violations()
        if self.sensor.positions is not None:
            yield ("sensor", "positions"), "a grid: taxel_size_m and pitch_m", self.sensor.positions

    def _finger_violations(self) -> Iterator[Violation]:
        carried = [finger.carries for finger in self.fingers.values()]
        for what in ("skin", "indenter"):
            if (count := carried.count(what)) != 1:
                yield "[fingers.*]", f'one finger with carries = "{what}"', str(count or "none")
        joints = [set(finger.joints) for finger in self.fingers.values()]
        if len(joints) != 2 or not all(joints):
            return
        if both := joints[0] & joints[1]:
            yield "[fingers.*]", "fingers without a joint in common", ", ".join(sorted(both))
        if idle := set(self.joints.names) - joints[0] - joints[1]:
            named = ", ".join(sorted(idle))
            yield ("joints", "names"), "joints of the two fingers only", named, "Leave them out."

    def per_joint(self, value: _Numbers) -> FloatArray:
        """Return a number, or a list with one for each joint, as an array (n,); NaN for a list of another length."""
        count = len(self.joints.names)
        good = not isinstance(value, tuple) or len(value) == count
        return np.full(count, value if good else np.nan, dtype=np.float64)

    def finger(self, carries: str) -> FingerDescription:
        """Return the finger that carries the skin or the indenter; an empty one if there is none."""
        for name, finger in self.fingers.items():
            if finger.carries == carries:
                return FingerDescription(name, finger.joints, finger.tip_link)
        return FingerDescription("", (), "")


def read_hand(path: str | Path) -> HandDescription:
    """Read the description of a hand.

    Args:
        path: ``hand.toml``, or the folder that holds it.

    Raises:
        InputError: the file has violations; all are reported.
    """
    path = Path(path)
    path = real(path / "hand.toml" if path.is_dir() else path)
    findings = Findings()
    values = load_toml(path, findings, what="hand")
    findings.raise_errors()
    assert values is not None
    file = read_table(_File, values, findings, path.name, FORMAT)
    urdf_path = path.parent / file.hand.urdf
    urdf = read_urdf(urdf_path, findings, path.parent) if file.hand.urdf else None
    if urdf is not None:
        report(_urdf_violations(file, urdf), findings, path.name)
    findings.raise_errors()
    joints, gains = file.joints, file.gains
    compliance = gains.compliance_rad_per_nm
    return HandDescription(
        name=file.hand.name,
        urdf=urdf_path,
        joints=joints.names,
        limits=_limits(file),
        gains=ImpedanceGains(
            file.per_joint(gains.stiffness_nm_per_rad),
            file.per_joint(gains.damping_nms_per_rad),
            gains.low_pass_hz,
        ),
        skin_finger=file.finger("skin"),
        indenter_finger=file.finger("indenter"),
        home_rad=np.radians(file.per_joint(joints.home_deg)),
        max_force_n=file.hand.max_force_n,
        meta=file.meta(),
        digest=_digest(path, urdf_path),
        compliance_rad_per_nm=None if compliance is None else file.per_joint(compliance),
    )


def _limits(file: _File) -> JointLimits:
    joints = file.joints
    return JointLimits(
        lower_rad=np.radians(file.per_joint(joints.lower_deg)),
        upper_rad=np.radians(file.per_joint(joints.upper_deg)),
        velocity_rad_per_s=np.radians(file.per_joint(joints.velocity_deg_per_s)),
        torque_nm=file.per_joint(joints.torque_nm),
    )


def _urdf_violations(file: _File, urdf: Urdf) -> Iterator[Violation]:
    """Yield what does not fit the URDF: links, the joints between them, and limits."""
    names = file.joints.names
    for name, finger in file.fingers.items():
        table = ("fingers", name)
        if finger.tip_link and finger.tip_link not in urdf.links:
            yield (*table, "tip_link"), f"one of {', '.join(urdf.links)}", f'"{finger.tip_link}"'
        elif finger.tip_link:
            driven = tuple(joint.name for joint in urdf.chain(finger.tip_link) if joint.kind in MOVING)
            if driven != finger.joints:
                expected = f"the joints between root and {finger.tip_link}: {', '.join(driven)}"
                yield (*table, "joints"), expected, ", ".join(finger.joints)
            for joint in set(finger.joints) - set(names):
                yield (*table, "joints"), f"joints of [joints] names ({', '.join(names)})", joint
    limits = _limits(file)
    named = {joint.name: joint for joint in urdf.joints.values()}
    for name, lower, upper in zip(names, limits.lower_rad, limits.upper_rad, strict=True):
        if (joint := named.get(name)) is None:
            driven = ", ".join(n for n, j in named.items() if j.kind in MOVING)
            yield ("joints", "names"), f"driven joints of the URDF ({driven})", f'"{name}"'
        elif lower < joint.lower_rad - _ROUNDING_RAD or upper > joint.upper_rad + _ROUNDING_RAD:
            low, high, *got = np.degrees([joint.lower_rad, joint.upper_rad, lower, upper])
            expected = f"{name} within the URDF's {low:.1f} to {high:.1f}"
            yield ("joints", "lower_deg, upper_deg"), expected, f"{got[0]:.1f} to {got[1]:.1f}"


def _digest(*paths: Path) -> str:
    """Return the SHA-256 of the files that can be read."""
    digest = hashlib.sha256()
    for path in paths:
        try:
            content = read_bytes(path)
        except (OSError, UnreadableError):  # already reported
            content = b""
        digest.update(len(content).to_bytes(8, "big") + content)
    return digest.hexdigest()


DEFAULT_HAND = "dlr_hand_2"
"""Thumb and forefinger after the DLR-Hand II."""


def bundled_hand(name: str = DEFAULT_HAND) -> HandDescription:
    """Return the description of a bundled hand.

    Raises:
        InputError: there is no bundled hand of that name.
    """
    folder = Path(__file__).parent / "hands"
    known = sorted(path.parent.name for path in folder.glob("*/hand.toml"))
    if name not in known:
        raise input_error("hand", f"one of {', '.join(known)}", f'"{name}"')
    return read_hand(folder / name)


def hand_named(hand: str | Path = DEFAULT_HAND) -> HandDescription:
    """Return the description of a hand: a bundled one by name, or a ``hand.toml``, or its folder.

    Raises:
        InputError: there is no hand of that name, or the file is invalid.
    """
    path = Path(hand).expanduser()
    return read_hand(path) if path.exists() or path.suffix or len(path.parts) > 1 else bundled_hand(str(hand))
