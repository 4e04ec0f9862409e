"""The pinch file, and the postures of a pinch."""

from __future__ import annotations

import shutil
from pathlib import Path

import numpy as np
import pytest

from skincal.envs.pinch import bundled_folder, read_pinch
from skincal.envs.postures import Postures
from skincal.errors import InputError


def test_the_tips_face_each_other_at_every_width() -> None:
    pinch = read_pinch()
    postures = Postures.of(pinch)
    for width in (-0.01, 0.0, 0.008, 0.0131, 0.03):
        skin, thumb = pinch.kinematics.frames(postures.at(width))
        foot = skin.to_root(np.array([[0.0, 0.0235, 0.0115]]))[0]
        end = thumb.to_root(np.array([[0.0, pinch.thumb.length_m, 0.0]]))[0]
        out = skin.rotations[0][:, 2]
        face = end - pinch.thumb.radius_m * out
        assert (face - foot) @ out == pytest.approx(width, abs=5e-5)
        assert np.linalg.norm(face - foot - width * out) < 5e-5
        assert (face + foot) / 2 == pytest.approx(postures.middle_m, abs=5e-5)


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ('format = "skincal-pinch/1"', 'format = "skincal-pinch/9"', 'format: expected "skincal-pinch/1"'),
        ("[0.0, 27.2,", "[27.2,", r"\[pinch\] angles_deg: expected a list of 6 finite numbers"),
        ("[0.0, 27.2,", "[0.0, 127.2,", r"\[pinch\] angles_deg: expected angles within the limits"),
        ('["indenter"]', '["nail"]', r"\[pinch\] remove_links: expected some of palm"),
        ('tip_link = "thumb_distal"', 'tip_link = "nail"', r"\[thumb\] tip_link: expected one of palm"),
        ('tip_link = "thumb_distal"', 'tip_link = "fingertip"', r"\[thumb\] tip_link: expected a link that"),
        ("radius_m = 0.0115", "radius_m = 11.5", r"\[thumb\] radius_m: .*millimetres"),
        ("cylinder_m = [0.0, 0.040]", "cylinder_m = [0.04, 0.0]", r"\[pinch\] cylinder_m: .*ascending"),
        ("[thumb]", "[finger]", r"\[thumb\]: expected a table"),
    ],
)
def test_a_file_that_is_wrong_is_refused_in_words(tmp_path: Path, old: str, new: str, message: str) -> None:
    folder = tmp_path / "hand"
    shutil.copytree(bundled_folder(), folder)
    file = folder / "pinch.toml"
    text = file.read_text(encoding="utf-8")
    assert old in text
    file.write_text(text.replace(old, new, 1), encoding="utf-8")
    with pytest.raises(InputError, match=message):
        read_pinch(folder)


def test_a_hand_without_the_file_is_reported(tmp_path: Path) -> None:
    folder = tmp_path / "hand"
    shutil.copytree(bundled_folder(), folder, ignore=shutil.ignore_patterns("pinch.toml"))
    with pytest.raises(InputError, match=r"pinch\.toml: expected the description of the pinch grasp"):
        read_pinch(folder)


def test_a_copy_of_the_hand_is_the_hand(tmp_path: Path) -> None:
    folder = tmp_path / "hand"
    shutil.copytree(bundled_folder(), folder)
    ours, theirs = read_pinch(folder / "hand.toml"), read_pinch()
    assert np.array_equal(ours.angles_rad, theirs.angles_rad) and ours.thumb == theirs.thumb
