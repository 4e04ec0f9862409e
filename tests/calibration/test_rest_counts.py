"""The level at rest in a calibration's file."""

from dataclasses import replace

from calibrations import make_calibration

from skincal.calibration import read_calibration, write_calibration


def test_the_level_at_rest_goes_through_the_file(tmp_path):
    plain = make_calibration()
    with_rest = replace(
        plain,
        model=replace(plain.model, rest_counts=25.0),
        intervals={**plain.intervals, "rest_counts": (24.9, 25.1)},
    )
    write_calibration(with_rest, tmp_path / "cal")
    back = read_calibration(tmp_path / "cal")
    assert back.model.rest_counts == 25.0
    assert back.intervals["rest_counts"] == (24.9, 25.1)
    assert not back.warnings
    assert "rest_counts" not in back.model.best()


def test_a_file_without_a_level_at_rest_is_read(tmp_path):
    write_calibration(make_calibration(), tmp_path / "cal")
    assert read_calibration(tmp_path / "cal").model.rest_counts is None
