"""``hand.toml``: what is read, and that everything wrong is said at once."""

from __future__ import annotations

import xml.etree.ElementTree as ElementTree
from pathlib import Path

import numpy as np
import pytest
from hands import other_hand

from skincal.errors import InputError
from skincal.robot import bundled_hand, read_hand, urdf_with_sphere


def test_the_bundled_hand() -> None:
    hand = bundled_hand()
    assert hand.joints == ("thumb_1", "thumb_2", "thumb_3", "forefinger_1", "forefinger_2", "forefinger_3")
    assert hand.skin_finger.name == "forefinger"
    assert hand.indenter_finger.name == "thumb"
    assert hand.meta.surface.radius_m == 0.0115
    assert hand.meta.indenter.radius_m == 0.006
    assert hand.meta.sensor.taxels == 16
    assert hand.urdf.is_absolute()
    np.testing.assert_array_equal(hand.gains.stiffness_nm_per_rad, 5.0)
    assert hand.compliance_rad_per_nm is not None


def test_a_urdf_with_another_sphere_works_in_any_folder(tmp_path: Path) -> None:
    path = other_hand(tmp_path / "hand").parent / "other.urdf"
    mesh = '<visual><geometry><mesh filename="ball.stl"/></geometry></visual>'
    path.write_text(path.read_text().replace('<link name="ball">', f'<link name="ball">{mesh}'))
    robot = ElementTree.fromstring(urdf_with_sphere(path, "ball", 0.0025))
    (ball,) = (link for link in robot.findall("link") if link.get("name") == "ball")
    assert [sphere.get("radius") for sphere in ball.findall("collision/geometry/sphere")] == ["0.0025"]
    assert [m.get("filename") for m in robot.iter("mesh")] == [str(path.parent / "ball.stl")]
    assert len(robot.findall("link/collision")) == 2


def test_an_unknown_bundled_hand_lists_those_there_are() -> None:
    with pytest.raises(InputError, match="dlr_hand_2"):
        bundled_hand("dlr_hand_3")


def test_another_hand(tmp_path: Path) -> None:
    hand = read_hand(other_hand(tmp_path / "hand"))
    assert len(hand.joints) == 7
    assert hand.skin_finger.joints == ("a0", "a1", "a2", "a3")
    assert hand.meta.sensor.rows == 3
    assert hand.compliance_rad_per_nm is None
    np.testing.assert_allclose(np.degrees(hand.limits.velocity_rad_per_s), [100, 90, 80, 70, 60, 50, 40])
    plane = read_hand(other_hand(tmp_path / "plane", plane=True))
    assert plane.meta.surface.kind == "plane"


def test_a_folder_stands_for_its_hand(tmp_path: Path) -> None:
    path = other_hand(tmp_path / "hand")
    assert read_hand(tmp_path / "hand").digest == read_hand(path).digest


def test_the_digest_changes_with_either_file(tmp_path: Path) -> None:
    path = other_hand(tmp_path / "hand")
    before = read_hand(path).digest
    urdf = path.parent / "other.urdf"
    urdf.write_text(urdf.read_text().replace('value="0.05"', 'value="0.06"'))
    middle = read_hand(path).digest
    path.write_text(path.read_text().replace("max_force_n = 6.0", "max_force_n = 5.0"))
    assert len({before, middle, read_hand(path).digest}) == 3


def test_all_violations_at_once(tmp_path: Path) -> None:
    path = other_hand(tmp_path / "hand")
    text = path.read_text()
    for old, new in [
        ("lower_deg = -90", "lower_deg = -95"),
        ("torque_nm = 2.0", "torque_nm = [1, 2]"),
        ("max_force_n = 6.0", ""),
        ('tip_link = "pad"', 'tip_link = "pat"'),
        ("radius_m = 0.004", "radius_m = 4.0"),
        ("stiffness_nm_per_rad = 8.0", "stifness_nm_per_rad = 8.0"),
    ]:
        assert old in text
        text = text.replace(old, new)
    path.write_text(text)
    with pytest.raises(InputError) as caught:
        read_hand(path)
    message = str(caught.value)
    for word in (
        "within the URDF's -91.7",
        "torque_nm",
        "max_force_n",
        '"pat"',
        "millimetres",
        "stifness_nm_per_rad",
    ):
        assert word in message


@pytest.mark.parametrize(
    ("old", "new", "word"),
    [
        ('carries = "skin"', 'carries = "indenter"', 'carries = "skin"'),
        ('joints = ["b0", "b1", "b2"]', 'joints = ["b1", "b0", "b2"]', "b0, b1, b2"),
        ('names = ["b2",', 'names = ["b2", "a1",', "every joint once"),
        ('kind = "sphere"', 'kind = "flat"', '"sphere"'),
        ('format = "skincal-hand/1"', 'format = "skincal-hand/2"', "skincal-hand/1"),
        ('urdf = "other.urdf"', 'urdf = "nothing.urdf"', "no such file"),
        ("velocity_deg_per_s = [100,", "velocity_deg_per_s = [-100,", "velocity_deg_per_s"),
    ],
)
def test_a_violation(tmp_path: Path, old: str, new: str, word: str) -> None:
    path = other_hand(tmp_path / "hand")
    text = path.read_text()
    assert old in text
    path.write_text(text.replace(old, new))
    with pytest.raises(InputError) as caught:
        read_hand(path)
    assert word in str(caught.value)


@pytest.mark.parametrize(
    ("old", "new", "word"),
    [
        ('<link name="l1">', '<link name="l9">', "links of the file"),
        ("</robot>", "", "XML"),
        ('<axis xyz="2 0 0"/>', '<axis xyz="2 0"/>', "three numbers"),
        ('<axis xyz="2 0 0"/>', '<axis xyz="1 0 0"/><mimic joint="b1"/>', "coupled"),
        ('type="revolute"', 'type="planar"', "revolute, continuous"),
    ],
)
def test_a_violation_in_the_urdf(tmp_path: Path, old: str, new: str, word: str) -> None:
    path = other_hand(tmp_path / "hand")
    urdf = path.parent / "other.urdf"
    text = urdf.read_text()
    assert old in text
    urdf.write_text(text.replace(old, new, 1))
    with pytest.raises(InputError) as caught:
        read_hand(path)
    assert word in str(caught.value)


def test_no_such_file(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="no such file"):
        read_hand(tmp_path / "hand.toml")
