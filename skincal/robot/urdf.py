"""The kinematic part of a URDF: joints, fixed ones included, from the root to a link."""

from __future__ import annotations

import math
import xml.etree.ElementTree as ElementTree
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from skincal.bounded import UnreadableError, parse_xml, read_text
from skincal.dataset.findings import Findings, did_you_mean
from skincal.files import check_input, reason
from skincal.model.arrays import FloatArray

MOST_PARTS = 2000
"""Largest number of links and joints: a hand with the arm that carries it."""

LARGEST = 1e4
"""Largest length [m] or angle [rad] of a hand."""
BESIDE = "Copy it into the folder of hand.toml."

MOVING = ("revolute", "continuous", "prismatic")
"""Kinds of joints that can be driven."""


@dataclass(frozen=True, eq=False)
class UrdfJoint:
    """A joint of a URDF.

    Attributes:
        kind: revolute, continuous, prismatic or fixed.
        rotation: (3, 3) from the joint's frame to the parent's, at angle 0.
        origin_m: (3,) its origin in the parent's frame [m].
        axis: (3,) unit axis in its own frame.
        lower_rad: smallest angle [rad]; -inf without a limit.
        upper_rad: largest angle [rad]; inf without a limit.
    """

    name: str
    kind: str
    parent: str
    child: str
    rotation: FloatArray
    origin_m: FloatArray
    axis: FloatArray
    lower_rad: float
    upper_rad: float


@dataclass(frozen=True)
class Urdf:
    """The tree of a URDF.

    Attributes:
        root: the link without a parent, whose frame all positions use.
        joints: the joint above each link but the root, by the link's name.
    """

    root: str
    links: tuple[str, ...]
    joints: dict[str, UrdfJoint]

    def chain(self, link: str) -> tuple[UrdfJoint, ...]:
        """Return the joints from the root to a link, fixed joints included."""
        joints: list[UrdfJoint] = []
        while link != self.root:
            joints.insert(0, self.joints[link])
            link = joints[0].parent
        return tuple(joints)


def read_urdf(path: Path, findings: Findings, within: Path | None = None) -> Urdf | None:
    """Read the tree of a URDF; return None, with errors added, where it is invalid."""
    try:
        robot = parse_xml(read_text(path, within=within))
    except FileNotFoundError:
        findings.error(str(path), "the URDF that the hand's description names", "no such file")
        return None
    except OSError as error:
        findings.error(str(path), "the URDF that the hand's description names", reason(error), BESIDE)
        return None
    except UnreadableError as error:
        findings.error(path.name, "a URDF (XML)", str(error))
        return None
    before = len(findings.errors)
    if within is not None:
        _check_named_files(robot, path, within, findings)
    links = tuple(link.get("name", "") for link in robot.findall("link"))
    if len(robot.findall("joint")) + len(links) > MOST_PARTS:
        findings.error(path.name, f"at most {MOST_PARTS} links and joints", "more")
        return None
    joints: dict[str, UrdfJoint] = {}
    for element in robot.findall("joint"):
        joint = _joint(element, path.name, findings)
        if joint is None:
            continue
        if joint.child in joints:
            findings.error(f"{path.name}, link {joint.child}", "one joint above it", "two")
        joints[joint.child] = joint
    root = _root(path.name, links, joints, findings)
    return Urdf(root, links, joints) if len(findings.errors) == before else None


def _check_named_files(robot: ElementTree.Element, path: Path, within: Path, findings: Findings) -> None:
    """Add an error for a mesh or texture outside the folder; the simulation does without a missing one."""
    for name in sorted({element.get("filename") or "?" for element in robot.iter()}):
        try:
            check_input(path.parent / name.rpartition("://")[2], within)
        except FileNotFoundError:
            continue
        except OSError as error:
            findings.error(f"{path.name}, filename {name}", f"a file in {within}", reason(error), BESIDE)


def urdf_with_sphere(path: Path, link: str, radius_m: float) -> bytes:
    """Return a URDF in which a link collides as a sphere about its origin; it may be written to any folder.

    Args:
        path: a URDF that has been read before.
        link: the link.
        radius_m: radius of the sphere [m].
    """
    robot = parse_xml(read_text(path))
    for element in robot.findall("link"):
        if element.get("name") == link:
            for shape in element.findall("collision"):
                element.remove(shape)
            geometry = ElementTree.SubElement(ElementTree.SubElement(element, "collision"), "geometry")
            ElementTree.SubElement(geometry, "sphere", radius=repr(radius_m))
    for mesh in robot.iter("mesh"):
        name = mesh.get("filename", "")
        if "://" not in name:
            mesh.set("filename", str(path.parent / name))
    return ElementTree.tostring(robot, encoding="utf-8")


def _root(file: str, links: tuple[str, ...], joints: dict[str, UrdfJoint], findings: Findings) -> str:
    """Return the link without a parent; check that all other links descend from it."""
    for joint in joints.values():
        for link in (joint.parent, joint.child):
            if link not in links:
                close = did_you_mean(link, links)
                fix = f'Did you mean "{close}"?' if close else ""
                findings.error(f"{file}, joint {joint.name}", "links of the file", f'"{link}"', fix)
    roots = [link for link in links if link not in joints]
    if len(roots) != 1:
        findings.error(file, "one link without a parent", ", ".join(roots) or "none")
        return ""
    _check_tree(file, roots[0], joints, findings)
    return roots[0]


def _check_tree(file: str, root: str, joints: dict[str, UrdfJoint], findings: Findings) -> None:
    """Check that every link leads to the root; report a loop of links."""
    for link in joints:
        way = [link]
        while way[-1] in joints and joints[way[-1]].parent not in way:
            way.append(joints[way[-1]].parent)
        if way[-1] in joints:
            loop = way[way.index(joints[way[-1]].parent) :]
            names = " on ".join([*loop[:8], *(["..."] if len(loop) > 8 else []), loop[0]])
            findings.error(
                file, f"links that all hang on {root}", f"a loop: {names}", "Correct a joint's parent."
            )
            return


def _joint(element: ElementTree.Element, file: str, findings: Findings) -> UrdfJoint | None:
    name, kind = element.get("name", ""), element.get("type", "")
    place = f"{file}, joint {name}"
    if kind not in (*MOVING, "fixed"):
        findings.error(place, f"one of {', '.join((*MOVING, 'fixed'))}", kind or "nothing")
        return None
    if element.find("mimic") is not None:
        findings.error(place, "independent joints", "<mimic>", "Describe a coupled pair as one joint.")
        return None
    origin, axis, limit = element.find("origin"), element.find("axis"), element.find("limit")
    parent, child = element.find("parent"), element.find("child")
    try:
        xyz = _numbers(origin, "xyz", (0.0, 0.0, 0.0))
        rpy = _numbers(origin, "rpy", (0.0, 0.0, 0.0))
        direction = _numbers(axis, "xyz", (1.0, 0.0, 0.0))
        lower = _limit(limit, "lower", -math.inf, kind)
        upper = _limit(limit, "upper", math.inf, kind)
    except ValueError as error:
        findings.error(place, "three numbers in xyz and rpy, one in a limit", str(error))
        return None
    length = float(np.linalg.norm(direction))
    if parent is None or child is None or (kind != "fixed" and not length > 0):
        findings.error(place, "a parent, a child and an axis", "one of them is missing or zero")
        return None
    return UrdfJoint(
        name=name,
        kind=kind,
        parent=parent.get("link", ""),
        child=child.get("link", ""),
        rotation=rotation_of(*rpy),
        origin_m=np.array(xyz),
        axis=np.array(direction) / (length or 1.0),
        lower_rad=lower,
        upper_rad=upper,
    )


def _limit(limit: ElementTree.Element | None, key: str, missing: float, kind: str) -> float:
    if limit is None or kind == "continuous" or limit.get(key) is None:
        return missing
    value = float(limit.get(key, ""))
    if math.isnan(value):
        raise ValueError(f'{key}="nan"')
    return value


def _numbers(
    element: ElementTree.Element | None, key: str, default: tuple[float, float, float]
) -> tuple[float, ...]:
    text = None if element is None else element.get(key)
    if text is None:
        return default
    values = tuple(float(word) for word in text.split())
    if len(values) != 3 or not all(abs(v) <= LARGEST for v in values):
        raise ValueError(f'{key}="{text}"')
    return values


def rotation_of(roll: float, pitch: float, yaw: float) -> FloatArray:
    """Return the rotation matrix (3, 3) of a URDF's rpy [rad]: about x, then y, then z of the parent's frame."""
    (cr, sr), (cp, sp), (cy, sy) = ((math.cos(a), math.sin(a)) for a in (roll, pitch, yaw))
    return np.array(
        [
            [cy * cp, cy * sp * sr - sy * cr, cy * sp * cr + sy * sr],
            [sy * cp, sy * sp * sr + cy * cr, sy * sp * cr - cy * sr],
            [-sp, cp * sr, cp * cr],
        ]
    )
