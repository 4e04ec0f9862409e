"""Pinch grasp of a hand: ``pinch.toml`` beside ``hand.toml``, and the URDF for it."""

from __future__ import annotations

import xml.etree.ElementTree as ElementTree
from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Annotated

import numpy as np
from numpy.typing import NDArray

from skincal.bounded import parse_xml, read_text
from skincal.dataset.dataset import pose_of, surface_of
from skincal.dataset.findings import Findings
from skincal.dataset.keys import Key, Length, Range
from skincal.dataset.kinds import SURFACES, named
from skincal.dataset.schema import Table, load_toml, read_table
from skincal.dataset.schema_errors import Violation, report
from skincal.model import SensorPose, Surface
from skincal.model.arrays import FloatArray
from skincal.robot import DEFAULT_HAND, HandDescription, Kinematics, read_hand
from skincal.robot.urdf import MOVING, Urdf, read_urdf, rotation_of

FILE, FORMAT = "pinch.toml", "skincal-pinch/1"
_BONE_RADIUS_M = 0.008
_SKIN_COLOUR = "0.3 0.45 0.75 1"
_BONE_COLOUR = "0.75 0.75 0.78 1"


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


def pinch_urdf(pinch: Pinch, *, visible: bool) -> str:
    """Return the URDF as text."""
    robot = parse_xml(read_text(pinch.description.urdf))
    for element in [*robot.findall("joint"), *robot.findall("link")]:
        child = element.find("child")
        name = element.get("name") if child is None else child.get("link")
        if name in pinch.remove_links:
            robot.remove(element)
    thumb = pinch.thumb
    for link in robot.findall("link"):
        for tag in ("visual", "collision") if link.get("name") == thumb.tip_link else ("visual",):
            for old in link.findall(tag):
                link.remove(old)
    capsule = _capsule(thumb.radius_m, thumb.length_m)
    _link(robot, thumb.tip_link).append(_part("collision", capsule))
    if visible:
        _add_visuals(robot, pinch)
    return ElementTree.tostring(robot, encoding="unicode")


def _link(robot: ElementTree.Element, name: str) -> ElementTree.Element:
    return next(link for link in robot.findall("link") if link.get("name") == name)


def _part(tag: str, inner: tuple[str, str], colour: str = "") -> ElementTree.Element:
    """Return a collision or visual from an origin and a geometry."""
    material = f'<material name="{colour}"><color rgba="{colour}"/></material>' if colour else ""
    return ElementTree.fromstring(f"<{tag}>{inner[0]}<geometry>{inner[1]}</geometry>{material}</{tag}>")


def _capsule(radius_m: float, length_m: float) -> tuple[str, str]:
    """Return a capsule along +y from the origin."""
    turn = f'<origin xyz="0 {length_m / 2} 0" rpy="{np.pi / 2} 0 0"/>'
    return turn, f'<capsule radius="{radius_m}" length="{length_m}"/>'


def _add_visuals(robot: ElementTree.Element, pinch: Pinch) -> None:
    """Both tips as they collide, and a bone from each joint to the next one."""
    tip = pinch.description.skin_finger.tip_link
    for name, colour in ((tip, _SKIN_COLOUR), (pinch.thumb.tip_link, _BONE_COLOUR)):
        link = _link(robot, name)
        for collision in link.findall("collision"):
            link.extend(_looks(collision, colour))
    for joint in robot.findall("joint"):
        parent, origin = joint.find("parent"), joint.find("origin")
        place = [float(v) for v in (origin.get("xyz", "0 0 0") if origin is not None else "0 0 0").split()]
        length = float(np.linalg.norm(place))
        if parent is None or length < 0.02 or abs(place[1]) < 0.99 * length:
            continue
        bone = _part("collision", _capsule(_BONE_RADIUS_M, length))
        _link(robot, parent.get("link", "")).extend(_looks(bone, _BONE_COLOUR))


def _looks(collision: ElementTree.Element, colour: str) -> list[ElementTree.Element]:
    """Visuals for a collision shape: of a capsule a cylinder and two balls, as the renderer has pointed capsules."""
    origin, geometry = collision.find("origin"), collision.find("geometry")
    assert geometry is not None
    text = "" if origin is None else ElementTree.tostring(origin, encoding="unicode").strip()
    capsule = geometry.find("capsule")
    if capsule is None:
        shape = "".join(ElementTree.tostring(item, encoding="unicode") for item in geometry)
        return [_part("visual", (text, shape), colour)]
    size = {key: float(capsule.get(key, "0")) for key in ("radius", "length")}
    attributes = {} if origin is None else origin.attrib
    middle = np.array([float(v) for v in attributes.get("xyz", "0 0 0").split()])
    turn = rotation_of(*(float(v) for v in attributes.get("rpy", "0 0 0").split()))
    ends = [middle + sign * size["length"] / 2 * turn[:, 2] for sign in (-1.0, 1.0)]
    ball = f'<sphere radius="{size["radius"]}"/>'
    shapes = [(text, f'<cylinder radius="{size["radius"]}" length="{size["length"]}"/>')]
    shapes += [(f'<origin xyz="{x} {y} {z}"/>', ball) for x, y, z in ends]
    return [_part("visual", shape, colour) for shape in shapes]
