"""``[contact_law]``: optional, checked, read back exactly."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from calibrations import make_calibration

from skincal.calibration import FittedLaw, read_calibration, write_calibration
from skincal.errors import InputError
from skincal.model import ContactLaw
from skincal.ranges.from_calibration import from_calibration

LAW = FittedLaw(
    ContactLaw(1.13, -4e-9, 1.03),
    {"exponent": (1.05, 1.2), "spread_m2": (-9e-9, 1e-9), "radius_scale": (1.0, 1.06)},
)


def test_it_comes_back(tmp_path: Path):
    write_calibration(make_calibration(contact_law=LAW), tmp_path / "cal")
    again = read_calibration(tmp_path / "cal")
    assert again.contact_law == LAW and not again.warnings
    assert again.base_skin(1e-3).contact == LAW.law


def test_files_without_it_are_as_before(tmp_path: Path):
    write_calibration(make_calibration(), tmp_path / "cal")
    assert "contact_law" not in (tmp_path / "cal" / "calibration.toml").read_text(encoding="utf-8")
    again = read_calibration(tmp_path / "cal")
    assert again.contact_law is None and again.base_skin(1e-3).contact is None


@pytest.mark.parametrize(
    "text, place",
    [
        ("contact_law = 3\n", "contact_law"),
        ("[contact_law]\nexponent = 30\n", "exponent"),
        ("[contact_law]\nspread_m2 = 'wide'\n", "spread_m2"),
        (
            "[contact_law]\nexponent = 1.1\n[contact_law.intervals]\nexponent = [1.2, 1.0]\n",
            "intervals.exponent",
        ),
        ("[contact_law]\n[contact_law.intervals]\nheight = [1.0, 1.2]\n", "intervals.height"),
        ("[contact_law]\nintervals = 4\n", "intervals"),
    ],
)
def test_what_makes_no_sense_is_refused(tmp_path: Path, text: str, place: str):
    write_calibration(make_calibration(), tmp_path / "cal")
    file = tmp_path / "cal" / "calibration.toml"
    before = file.read_text(encoding="utf-8")
    file.write_text(
        text + before if text.startswith("contact_law") else before + "\n" + text, encoding="utf-8"
    )
    with pytest.raises(InputError, match=place):
        read_calibration(tmp_path / "cal")


def test_ranges_draw_it():
    ranges = from_calibration(make_calibration(contact_law=LAW))
    exponent = ranges["skin.contact_law.exponent"]
    assert (exponent.low, exponent.high, exponent.source) == (1.05, 1.2, "calibrated")
    assert not any("contact_law" in name for name in from_calibration(make_calibration()))


def test_a_number_without_an_interval_is_constant():
    law = FittedLaw(ContactLaw(1.2), {"exponent": (1.1, np.inf)})
    ranges = from_calibration(make_calibration(contact_law=law))
    assert ranges["skin.contact_law.exponent"].value == 1.2
    assert ranges["skin.contact_law.radius_scale"].value == 1.0
