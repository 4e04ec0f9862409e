"""The hand's URDF without its cap, with a thumb that collides, and with something to look at."""

from __future__ import annotations

import xml.etree.ElementTree as ElementTree

import numpy as np

from skincal.bounded import parse_xml, read_text
from skincal.envs.pinch import Pinch
from skincal.robot.urdf import rotation_of

_BONE_RADIUS_M = 0.008
_SKIN_COLOUR = "0.3 0.45 0.75 1"
_BONE_COLOUR = "0.75 0.75 0.78 1"


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
