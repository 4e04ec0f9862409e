"""Pinch grasp of a hand: ``pinch.toml`` beside ``hand.toml``."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, cast

import numpy as np
from numpy.typing import NDArray

from skincal.dataset.findings import Findings
from skincal.dataset.meta_tables import check_format, load_toml
from skincal.dataset.toml_table import TomlTable
from skincal.errors import InputError, Problem
from skincal.robot import DEFAULT_HAND, FingerDescription, HandDescription, read_hand
from skincal.robot.urdf import MOVING, Urdf, read_urdf

FloatArray = NDArray[np.float64]

FORMAT = "skincal-pinch/1"


@dataclass(frozen=True)
class Thumb:
    """The tip that presses the object against the skin: a capsule along +y of its link, from the link's origin.

    Attributes:
        tip_link: the URDF's link.
        radius_m: of cylinder and round ends [m].
        length_m: between the centres of the round ends [m].
        tip_from_m: from here on along +y it counts as the tip [m].
    """

    tip_link: str
    radius_m: float
    length_m: float
    tip_from_m: float


@dataclass(frozen=True, eq=False)
class Pinch:
    """A hand in a pinch grasp.

    Attributes:
        description: the hand; its second finger ends in the bare tip, not in an indenter.
        thumb: the shape of that tip.
        angles_rad: (n,) angles of the links at which the two surfaces face each other [rad].
        gravity_m_per_s2: (3,) acts on the object, frame of the URDF's root [m/s²].
        cylinder_m: from where to where along +y the finger with the skin is cylindrical [m].
        remove_links: links of the URDF that are taken off, with the joints above them.
    """

    description: HandDescription
    thumb: Thumb
    angles_rad: FloatArray
    gravity_m_per_s2: FloatArray
    cylinder_m: tuple[float, float]
    remove_links: tuple[str, ...]

    @property
    def joints(self) -> int:
        """Number of joints n."""
        return len(self.description.joints)

    def joints_of(self, which: slice) -> NDArray[np.int64]:
        """Columns of some joints of each finger, finger by finger."""
        fingers = (self.description.indenter_finger, self.description.skin_finger)
        # In the order in which the hand names them, so that draws go the same way.
        ordered = sorted(fingers, key=lambda f: self.description.joints.index(f.joints[0]))
        columns = [self.description.joints.index(name) for f in ordered for name in f.joints[which]]
        return np.array(columns, dtype=np.int64)


def read_pinch(hand: str | Path | None = None) -> Pinch:
    """Reads a hand and how it pinches.

    Args:
        hand: folder with ``hand.toml`` and ``pinch.toml``, or one of the two files; None: the bundled hand.

    Raises:
        InputError: violations, all of them.
    """
    path = Path(hand) if hand is not None else bundled_folder()
    folder = path if path.is_dir() else path.parent
    description = read_hand(folder)
    findings = Findings()
    values = load_toml(folder / "pinch.toml", findings, what="pinch grasp")
    findings.raise_errors()
    assert values is not None
    urdf = read_urdf(description.urdf, findings)
    findings.raise_errors()
    assert urdf is not None
    pinch = _read(values, description, urdf, findings)
    findings.raise_errors()
    return pinch


def bundled_folder() -> Path:
    """The folder of the bundled hand."""
    from skincal import robot

    return Path(robot.__file__).parent / "hands" / DEFAULT_HAND


def _read(values: Any, description: HandDescription, urdf: Urdf, findings: Findings) -> Pinch:
    file = "pinch.toml"
    top = TomlTable(findings, file, "", values, ("format", "pinch", "thumb"))
    check_format(top, FORMAT)
    known = ("angles_deg", "gravity_m_per_s2", "cylinder_m", "remove_links")
    pinch = top.inner("pinch", known)
    thumb = _thumb(top.inner("thumb", ("tip_link", "radius_m", "length_m", "tip_from_m")))
    _check_fingers(description, findings)
    angles = np.radians(pinch.array("angles_deg", len(description.joints), single=False))
    _check_angles(pinch, angles, description)
    removed = _links(pinch, urdf)
    finger = _finger(description, urdf, thumb, findings)
    return Pinch(
        description=replace(description, indenter_finger=finger),
        thumb=thumb,
        angles_rad=angles,
        gravity_m_per_s2=pinch.array("gravity_m_per_s2", 3, single=False),
        cylinder_m=pinch.range("cylinder_m", "a pair [from, to] along the finger [m]", limit=0.5),
        remove_links=removed,
    )


def _thumb(table: TomlTable) -> Thumb:
    return Thumb(
        tip_link=table.text("tip_link", "the name of a link of the URDF"),
        radius_m=table.length_m("radius_m", "a radius [m]", low=1e-3, high=0.1),
        length_m=table.length_m("length_m", "a length [m]", low=1e-3, high=0.5),
        tip_from_m=table.length_m("tip_from_m", "a place along the tip [m]", low=0, high=0.5, positive=False),
    )


def _links(table: TomlTable, urdf: Urdf) -> tuple[str, ...]:
    value = table.raw("remove_links")
    links = cast("list[Any]", value) if isinstance(value, list) else []
    for link in links:
        if link not in urdf.links:
            table.error("remove_links", f"some of {', '.join(urdf.links)}", repr(link))
    return tuple(str(link) for link in links)


def _check_fingers(description: HandDescription, findings: Findings) -> None:
    """The ranges speak of three joints a finger."""
    for finger in (description.indenter_finger, description.skin_finger):
        if len(finger.joints) != 3:
            findings.error(
                f"hand.toml, [fingers.{finger.name}]", "three joints, for the tasks", str(len(finger.joints))
            )


def _check_angles(table: TomlTable, angles: FloatArray, description: HandDescription) -> None:
    limits = description.limits
    if len(angles) == len(limits.lower_rad) and np.any(
        (angles < limits.lower_rad) | (angles > limits.upper_rad)
    ):
        table.error("angles_deg", "angles within the limits of hand.toml", np.degrees(angles).tolist())


def _finger(description: HandDescription, urdf: Urdf, thumb: Thumb, findings: Findings) -> FingerDescription:
    """The finger of the thumb, ending in the tip's link."""
    finger = description.indenter_finger
    if thumb.tip_link not in urdf.links:
        links = ", ".join(urdf.links)
        findings.error("pinch.toml, [thumb] tip_link", f"one of {links}", repr(thumb.tip_link))
        return finger
    driven = tuple(joint.name for joint in urdf.chain(thumb.tip_link) if joint.kind in MOVING)
    if driven != finger.joints:
        expected = f"a link that the joints {', '.join(finger.joints)} move"
        findings.error("pinch.toml, [thumb] tip_link", expected, repr(thumb.tip_link))
    return replace(finger, tip_link=thumb.tip_link)


def require_cylinder(pinch: Pinch) -> float:
    """Radius of the finger with the skin [m].

    Raises:
        InputError: the surface is no cylinder.
    """
    surface = pinch.description.meta.surface
    if surface.kind != "cylinder" or surface.radius_m is None:
        raise InputError([Problem("hand.toml, [surface] kind", '"cylinder", for the tasks', surface.kind)])
    return surface.radius_m
