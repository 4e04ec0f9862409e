"""Strict reader of ``hand.toml``; it reports all violations at once."""

from __future__ import annotations

import hashlib
from pathlib import Path

import numpy as np

from skincal.bounded import UnreadableError, read_bytes
from skincal.dataset import DatasetMeta
from skincal.dataset.findings import Findings
from skincal.dataset.meta_tables import TABLES, check_format, load_toml, meta_from, tables_of
from skincal.dataset.toml_table import TomlTable
from skincal.robot.description import (
    FingerDescription,
    FloatArray,
    HandDescription,
    ImpedanceGains,
    JointLimits,
)
from skincal.robot.urdf import MOVING, Urdf, read_urdf

FORMAT = "skincal-hand/1"

_TOP = ("format", "hand", "joints", "gains", "fingers", *TABLES)
_HAND = ("name", "urdf", "max_force_n")
_JOINTS = ("names", "lower_deg", "upper_deg", "velocity_deg_per_s", "torque_nm", "home_deg")
_GAINS = ("stiffness_nm_per_rad", "damping_nms_per_rad", "low_pass_hz", "compliance_rad_per_nm")
_FINGER = ("carries", "joints", "tip_link")
_NAMES = "a list of joint names, every joint once"
_ROUNDING_RAD = 1e-3
"""Tolerance by which limits may exceed those of the URDF [rad], for files with rounded numbers."""


def read_hand(path: str | Path) -> HandDescription:
    """Read the description of a hand.

    Args:
        path: ``hand.toml``, or the folder that holds it.

    Raises:
        InputError: the file has violations; all are reported.
    """
    path = Path(path)
    path = (path / "hand.toml" if path.is_dir() else path).resolve()
    findings = Findings()
    values = load_toml(path, findings, what="hand")
    findings.raise_errors()
    assert values is not None
    top = TomlTable(findings, path.name, "", values, _TOP)
    check_format(top, FORMAT)
    reader = _Reader(path, findings, top)
    description = reader.description()
    findings.raise_errors()
    return description


class _Reader:
    """Reader of the tables of one file; a wrong value adds an error and reads as a placeholder."""

    def __init__(self, path: Path, findings: Findings, top: TomlTable) -> None:
        self._path = path
        self._findings = findings
        self._top = top
        self._joints = top.inner("joints", _JOINTS)
        self._gains = top.inner("gains", _GAINS)
        self._hand = top.inner("hand", _HAND)

    def description(self) -> HandDescription:
        joints = self._joints.names("names", _NAMES)
        limits = self._limits(len(joints))
        urdf_path = self._path.parent / (self._hand.text("urdf", "the URDF's file name") or "?")
        skin, indenter = self._fingers()
        urdf = read_urdf(urdf_path, self._findings, self._path.parent) if self._hand.has("urdf") else None
        if urdf is not None:
            for finger in (skin, indenter):
                self._check_finger(finger, urdf, joints)
            self._check_limits(urdf, joints, limits)
        self._check_shared(skin, indenter, joints)
        return HandDescription(
            name=self._hand.text("name", "the hand's name"),
            urdf=urdf_path,
            joints=joints,
            limits=limits,
            gains=ImpedanceGains(
                self._gains.array("stiffness_nm_per_rad", len(joints), low=1e-6),
                self._gains.array("damping_nms_per_rad", len(joints), low=0.0),
                self._gains.number("low_pass_hz", "a frequency [Hz] > 0", low=1e-3),
            ),
            skin_finger=skin,
            indenter_finger=indenter,
            home_rad=self._home(len(joints), limits),
            max_force_n=self._hand.number("max_force_n", "a force [N] > 0", low=1e-3),
            meta=self._meta(),
            digest=_digest(self._path, urdf_path),
            compliance_rad_per_nm=self._gains.array("compliance_rad_per_nm", len(joints), low=0.0)
            if self._gains.has("compliance_rad_per_nm")
            else None,
        )

    def _limits(self, count: int) -> JointLimits:
        limits = JointLimits(
            lower_rad=np.radians(self._joints.array("lower_deg", count)),
            upper_rad=np.radians(self._joints.array("upper_deg", count)),
            velocity_rad_per_s=np.radians(self._joints.array("velocity_deg_per_s", count, low=1e-6)),
            torque_nm=self._joints.array("torque_nm", count, low=1e-6),
        )
        if np.any(limits.lower_rad >= limits.upper_rad):
            self._joints.error("upper_deg", "more than lower_deg", self._joints.raw("upper_deg"))
        return limits

    def _home(self, count: int, limits: JointLimits) -> FloatArray:
        home = np.radians(self._joints.array("home_deg", count))
        if np.any((home < limits.lower_rad) | (home > limits.upper_rad)):
            self._joints.error("home_deg", "angles within the limits", self._joints.raw("home_deg"))
        return home

    def _fingers(self) -> tuple[FingerDescription, FingerDescription]:
        """Return the finger with the skin and the one with the indenter; a missing one is empty, with an error."""
        found: dict[str, FingerDescription] = {}
        fingers = self._top.inner("fingers", (), optional=True, open_keys=True)
        for name in fingers.extra:
            reader = fingers.inner(name, _FINGER)
            carries = reader.choice("carries", ("skin", "indenter"))
            finger = FingerDescription(
                name,
                reader.names("joints", _NAMES),
                reader.text("tip_link", "the name of a link of the URDF"),
            )
            if carries in found:
                reader.error("carries", f"one finger with the {carries}", "two")
            found[carries] = finger
        for what in ("skin", "indenter"):
            if what not in found:
                self._top.error("[fingers.*]", f'a finger with carries = "{what}"', "none")
        nothing = FingerDescription("", (), "")
        return found.get("skin", nothing), found.get("indenter", nothing)

    def _check_finger(self, finger: FingerDescription, urdf: Urdf, joints: tuple[str, ...]) -> None:
        if not finger.tip_link:
            return
        place = f"{self._path.name}, [fingers.{finger.name}]"
        if finger.tip_link not in urdf.links:
            self._findings.error(
                f"{place} tip_link", f"one of {', '.join(urdf.links)}", f'"{finger.tip_link}"'
            )
            return
        driven = tuple(joint.name for joint in urdf.chain(finger.tip_link) if joint.kind in MOVING)
        if driven != finger.joints:
            self._findings.error(
                f"{place} joints",
                f"the joints between root and {finger.tip_link}: {', '.join(driven)}",
                ", ".join(finger.joints),
            )
        for name in finger.joints:
            if name not in joints:
                self._findings.error(
                    f"{place} joints", f"joints of [joints] names ({', '.join(joints)})", name
                )

    def _check_shared(
        self, skin: FingerDescription, indenter: FingerDescription, joints: tuple[str, ...]
    ) -> None:
        if not (skin.joints and indenter.joints):
            return
        both = set(skin.joints) & set(indenter.joints)
        if both:
            self._top.error("[fingers.*]", "fingers without a joint in common", ", ".join(sorted(both)))
        idle = set(joints) - set(skin.joints) - set(indenter.joints)
        if idle:
            self._joints.error(
                "names", "joints of the two fingers only", ", ".join(sorted(idle)), "Leave them out."
            )

    def _check_limits(self, urdf: Urdf, joints: tuple[str, ...], limits: JointLimits) -> None:
        named = {joint.name: joint for joint in urdf.joints.values()}
        for i, name in enumerate(joints):
            joint = named.get(name)
            if joint is None:
                driven = ", ".join(n for n, j in named.items() if j.kind in MOVING)
                self._joints.error("names", f"driven joints of the URDF ({driven})", f'"{name}"')
            elif (
                limits.lower_rad[i] < joint.lower_rad - _ROUNDING_RAD
                or limits.upper_rad[i] > joint.upper_rad + _ROUNDING_RAD
            ):
                low, high = np.degrees([joint.lower_rad, joint.upper_rad])
                got = np.degrees([limits.lower_rad[i], limits.upper_rad[i]])
                self._joints.error(
                    "lower_deg, upper_deg",
                    f"{name} within the URDF's {low:.1f} to {high:.1f}",
                    f"{got[0]:.1f} to {got[1]:.1f}",
                )

    def _meta(self) -> DatasetMeta:
        tables = tables_of(self._top)
        meta = meta_from(self._top, tables)
        if meta.surface.kind == "mesh":
            tables["surface"].error(
                "kind", '"cylinder" or "plane": contacts are found in closed form', '"mesh"'
            )
        if meta.indenter.kind not in ("sphere", ""):
            tables["indenter"].error(
                "kind", 'a "sphere": contacts are found from its centre', f'"{meta.indenter.kind}"'
            )
        if meta.sensor.positions is not None:
            tables["sensor"].error("positions", "a grid: taxel_size_m and pitch_m", meta.sensor.positions)
        return meta


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
