"""Pinch grasp of a hand: ``pinch.toml`` beside ``hand.toml``."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Annotated

import numpy as np
from numpy.typing import NDArray

from skincal.dataset.dataset import pose_of, surface_of
from skincal.dataset.findings import Findings
from skincal.dataset.keys import Key, Length, Range
from skincal.dataset.kinds import SURFACES, named
from skincal.dataset.schema import Table, load_toml, read_table
from skincal.dataset.schema_errors import Violation, report
from skincal.model import SensorPose, Surface
from skincal.model.arrays import FloatArray
from skincal.robot import DEFAULT_HAND, HandDescription, Kinematics, read_hand
from skincal.robot.urdf import MOVING, Urdf, read_urdf

FILE, FORMAT = "pinch.toml", "skincal-pinch/1"


@dataclass(frozen=True)
class Thumb(Table):
    """The tip that presses the object against the skin: a capsule along +y of its link, from the link's origin.

    Attributes:
        tip_link: the URDF's link.
        radius_m: of cylinder and round ends [m].
        length_m: between the centres of the round ends [m].
        tip_from_m: from here on along +y it counts as the tip [m].
    """

    tip_link: Annotated[str, Key("the name of a link of the URDF")]
    radius_m: Annotated[float, Length("a radius [m]", 1e-3, 0.1)]
    length_m: Annotated[float, Length("a length [m]", 1e-3, 0.5)]
    tip_from_m: Annotated[float, Length("a place along the tip [m]", high=0.5, signed=True)]


@dataclass(frozen=True)
class _Grasp(Table):
    angles_deg: Annotated[tuple[float, ...], Key("a list of angles, one for each joint")]
    gravity_m_per_s2: Annotated[tuple[float, float, float], Key("a list of 3 finite numbers")]
    cylinder_m: Annotated[tuple[float, float], Range("a pair [from, to] along the finger [m]", high=0.5)]
    remove_links: tuple[str, ...] = ()


@dataclass(frozen=True)
class _File(Table):
    pinch: _Grasp
    thumb: Thumb


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

    @cached_property
    def surface(self) -> Surface:
        """The surface of the finger with the skin."""
        return surface_of(self.description.meta.surface, {})

    @cached_property
    def kinematics(self) -> Kinematics:
        """The kinematics of both fingers."""
        return Kinematics(self.description)

    @property
    def pose(self) -> SensorPose:
        """The sensor's nominal pose."""
        return pose_of(self.description.meta.mount)

    @property
    def radius_m(self) -> float:
        """The surface's distance from the finger's axis at the sensor's nominal centre [m]."""
        radius = self.surface.arc_radius_at(self.pose)
        assert radius is not None
        return radius

    @property
    def facing(self) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Return the parts of the tips that face each other.

        They are the skin's outward normal (3,) at the sensor's nominal centre and that centre (1, 3) [m], both in the
        fingertip's frame, and the centre (1, 3) of the thumb's round end, in its tip's frame [m].
        """
        centre, out = self.surface.wrap(self.pose, np.zeros((1, 2)))
        return out[0], centre, np.array([[0.0, self.thumb.length_m, 0.0]])

    def torques_nm(self, q_rad: FloatArray, force_n: float) -> FloatArray:
        """Return torques (n,) with which the tips press on each other along the skin's normal [N m]."""
        out, centre, thumb_end = self.facing
        skin, thumb = self.kinematics.frames(q_rad)
        force = -force_n * (skin.rotations[0] @ out)
        return self.kinematics.torques(skin, thumb, skin.to_root(centre), thumb.to_root(thumb_end), force)

    def joints_of(self, which: slice) -> NDArray[np.int64]:
        """Return columns of some joints of each finger, finger by finger."""
        fingers = (self.description.indenter_finger, self.description.skin_finger)
        # In the order in which the hand names them, so that draws go the same way.
        ordered = sorted(fingers, key=lambda f: self.description.joints.index(f.joints[0]))
        columns = [self.description.joints.index(name) for f in ordered for name in f.joints[which]]
        return np.array(columns, dtype=np.int64)


def read_pinch(hand: str | Path | None = None) -> Pinch:
    """Read a hand and how it pinches.

    Args:
        hand: folder with ``hand.toml`` and ``pinch.toml``, or one of the two files; None: the bundled hand.

    Raises:
        InputError: violations, all of them.
    """
    path = Path(hand) if hand is not None else bundled_folder()
    folder = path if path.is_dir() else path.parent
    description = read_hand(folder)
    findings = Findings()
    values = load_toml(folder / FILE, findings, what="pinch grasp")
    findings.raise_errors()
    assert values is not None
    urdf = read_urdf(description.urdf, findings)
    findings.raise_errors()
    assert urdf is not None
    file = read_table(_File, values, findings, FILE, FORMAT)
    _check_hand(description, findings)
    report(_violations(file, description, urdf), findings, FILE)
    findings.raise_errors()
    finger = replace(description.indenter_finger, tip_link=file.thumb.tip_link)
    return Pinch(
        description=replace(description, indenter_finger=finger),
        thumb=file.thumb,
        angles_rad=np.radians(file.pinch.angles_deg),
        gravity_m_per_s2=np.array(file.pinch.gravity_m_per_s2),
        cylinder_m=file.pinch.cylinder_m,
        remove_links=file.pinch.remove_links,
    )


def bundled_folder() -> Path:
    """Return the folder of the bundled hand."""
    from skincal import robot

    return Path(robot.__file__).parent / "hands" / DEFAULT_HAND


def _violations(file: _File, description: HandDescription, urdf: Urdf) -> Iterator[Violation]:
    """Yield what does not fit the hand."""
    angles, limits, link = np.radians(file.pinch.angles_deg), description.limits, file.thumb.tip_link
    if len(angles) != len(limits.lower_rad):
        expected = f"a list of {len(limits.lower_rad)} finite numbers"
        yield ("pinch", "angles_deg"), expected, file.pinch.angles_deg
    elif np.any((angles < limits.lower_rad) | (angles > limits.upper_rad)):
        yield ("pinch", "angles_deg"), "angles within the limits of hand.toml", file.pinch.angles_deg
    links = ", ".join(urdf.links)
    for one in file.pinch.remove_links:
        if one not in urdf.links:
            yield ("pinch", "remove_links"), f"some of {links}", repr(one)
    driven = description.indenter_finger.joints
    if link not in urdf.links:
        yield ("thumb", "tip_link"), f"one of {links}", repr(link)
    elif tuple(joint.name for joint in urdf.chain(link) if joint.kind in MOVING) != driven:
        yield ("thumb", "tip_link"), f"a link that the joints {', '.join(driven)} move", repr(link)


def _check_hand(description: HandDescription, findings: Findings) -> None:
    """Objects roll round a finger of one radius, and the ranges speak of three joints a finger."""
    kind = description.meta.surface.kind
    if not SURFACES[kind].in_tasks:
        expected = f"{named(SURFACES, 'in_tasks')}, for the tasks"
        findings.error("hand.toml, [surface] kind", expected, f'"{kind}"')
    for finger in (description.indenter_finger, description.skin_finger):
        if len(finger.joints) != 3:
            place, got = f"hand.toml, [fingers.{finger.name}]", str(len(finger.joints))
            findings.error(place, "three joints, for the tasks", got)
