"""The hand's URDF without its cap, with a thumb that collides, and with something to look at."""

from __future__ import annotations

import xml.etree.ElementTree as ElementTree

import numpy as np
from numpy.typing import NDArray

from skincal.envs.pinch import Pinch

FloatArray = NDArray[np.float64]

_BONE_RADIUS_M = 0.008


def pinch_urdf(pinch: Pinch, *, visible: bool) -> str:
    """The URDF as text.

    Args:
        pinch: the hand; its URDF is read.
        visible: whether links get shapes to look at; physics needs none.
    """
    robot = ElementTree.fromstring(pinch.description.urdf.read_text(encoding="utf-8"))
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
    """A collision or visual from an origin and a geometry."""
    material = f'<material name="{colour}"><color rgba="{colour}"/></material>' if colour else ""
    return ElementTree.fromstring(f"<{tag}>{inner[0]}<geometry>{inner[1]}</geometry>{material}</{tag}>")


def _capsule(radius_m: float, length_m: float) -> tuple[str, str]:
    """Along +y from the origin."""
    turn = f'<origin xyz="0 {length_m / 2} 0" rpy="{np.pi / 2} 0 0"/>'
    return turn, f'<capsule radius="{radius_m}" length="{length_m}"/>'


def _add_visuals(robot: ElementTree.Element, pinch: Pinch) -> None:
    """Both tips as they collide, and a bone from each joint to the next one."""
    skin_tip = pinch.description.skin_finger.tip_link
    tip = _link(robot, skin_tip)
    for collision in tip.findall("collision"):
        shape = collision.find("geometry")
        origin = collision.find("origin")
        assert shape is not None
        visual = ElementTree.SubElement(tip, "visual")
        visual.extend([*([origin] if origin is not None else []), shape])
        visual.append(
            ElementTree.fromstring('<material name="skin"><color rgba="0.3 0.45 0.75 1"/></material>')
        )
    grey = "0.75 0.75 0.78 1"
    _link(robot, pinch.thumb.tip_link).append(
        _part("visual", _capsule(pinch.thumb.radius_m, pinch.thumb.length_m), grey)
    )
    for joint in robot.findall("joint"):
        parent, origin = joint.find("parent"), joint.find("origin")
        place = [float(v) for v in (origin.get("xyz", "0 0 0") if origin is not None else "0 0 0").split()]
        length = float(np.linalg.norm(place))
        if parent is None or length < 0.02 or abs(place[1]) < 0.99 * length:
            continue
        bone = _capsule(_BONE_RADIUS_M, length)
        _link(robot, parent.get("link", "")).append(_part("visual", bone, grey))
