"""A calibration that was fitted to another session is told where its own pose, E and S are not those of this one."""

from __future__ import annotations

import re
from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from chambers import Chamber
from report.diagnosis_cases import LOOP, TRUTH, calibration, session

from skincal.calibrate import calibrate_uniform
from skincal.calibration import Finding, ModelParameters
from skincal.dataset import Dataset, read_dataset
from skincal.diagnose.options import DiagnoseOptions
from skincal.diagnose.own_numbers import numbers_differ, scales_differ
from skincal.diagnose.prepare import prepare
from skincal.errors import InputError
from skincal.gap.refit import refit
from skincal.gap.relocate import at_best


@cache
def of_loop() -> Dataset:
    return session(LOOP)


def told(data: Dataset, model: ModelParameters, dataset: str = "ab" * 32) -> tuple[Finding, ...]:
    """What is said of a calibration with such numbers, the session's own being fitted beside its loop."""
    made = calibration()
    made = replace(made, model=model, provenance=replace(made.provenance, dataset_sha256=dataset))
    ready = prepare(data, made, DiagnoseOptions(), np.random.default_rng(0))
    true = {name: {key: np.asarray(v) for key, v in own.items()} for name, own in LOOP.items()}
    found = refit(ready.start, ready.session, ready.reading, ready.options, fixed=true).hypothesis
    found = at_best(found, ready.session, ready.reading, ready.options)
    everything = np.ones(len(ready.session), dtype=np.bool_)
    return numbers_differ(made, data, ready, found, ready.reading, everything)


def test_the_numbers_of_the_same_sensor_are_those_of_another_session_too():
    assert told(of_loop(), TRUTH) == ()


@pytest.mark.parametrize(
    ("change", "word"),
    [
        ({"elasticity_pa_per_m": 2.4e8, "scale_per_n": 78.0}, "E +"),
        ({"scale_per_n": 100.0}, "S -"),
    ],
)
def test_those_of_another_sensor_are_not(change: dict[str, float], word: str):
    (one,) = told(of_loop(), replace(TRUTH, **change))
    assert (one.code, one.severity) == ("other_calibration", "warning") and "skincal fit" in one.advice
    assert word in one.text and "nan" not in one.text


def test_those_of_quite_another_sensor_are_refused():
    other = replace(TRUTH, elasticity_pa_per_m=5e7, scale_per_n=400.0)
    with pytest.raises(InputError, match=r"of the sensor that was pressed.*S -.*skincal fit"):
        told(of_loop(), other)


def test_of_the_session_that_it_was_fitted_to_a_calibration_says_what_it_says():
    data = replace(of_loop(), sha256="cd" * 32)
    other = replace(TRUTH, elasticity_pa_per_m=2.4e8, scale_per_n=78.0)
    assert told(data, other, "cd" * 32) == ()
    assert len(told(data, other)) == 1


def said_of_scales(
    tmp_path: Path,
    factor: float,
    *,
    rest: float = 0.0,
    dead: int | None = None,
    frames: bool = True,
    refuse: bool = True,
) -> tuple[Finding, ...]:
    """What is said in a chamber of a calibration if half of the taxels are so many times as sensitive now."""
    before = Chamber.plain()
    gain = before.gain * np.where(np.arange(16) % 2 == 0, factor, 1 / factor)
    if dead is not None:
        gain[dead] = 0.0
    now = replace(before, gain=gain, rest=before.rest + rest, seed=1)
    made = calibrate_uniform(read_dataset(before.write(tmp_path / "before", frames=frames))).calibration
    data = read_dataset(now.write(tmp_path / "now", frames=frames))
    ready = prepare(data, made, DiagnoseOptions(), np.random.default_rng(0))
    everything = np.ones(len(ready.session), dtype=np.bool_)
    gone = () if dead is None else (dead,)
    return scales_differ(made, data, ready, {}, ready.reading, everything, gone, refuse=refuse)


@pytest.mark.parametrize("frames", [True, False])
@pytest.mark.parametrize(("rest", "dead"), [(0.0, None), (15.0, None), (0.0, 3)])
def test_in_a_chamber_the_same_scales_are_nobody_elses(
    tmp_path: Path, rest: float, dead: int | None, frames: bool
):
    """Neither a level at rest that is not in the model nor a taxel that died is a scale."""
    assert said_of_scales(tmp_path, 1.0, rest=rest, dead=dead, frames=frames) == ()


@pytest.mark.parametrize("rest", [0.0, 15.0])
def test_in_a_chamber_other_scales_are_told_by_how_much_they_are_off(tmp_path: Path, rest: float):
    (one,) = said_of_scales(tmp_path, 1.15, rest=rest)
    assert (one.code, one.severity) == ("other_calibration", "warning") and "taxels' scales" in one.text
    told = re.search(r"more than (\d+) %", one.text)
    assert told is not None and 12 <= int(told.group(1)) <= 16


def test_in_a_chamber_the_scales_of_quite_another_sensor_are_refused(tmp_path: Path):
    with pytest.raises(InputError, match=r"of the sensor that was pressed.*scales.*skincal fit"):
        said_of_scales(tmp_path / "known", 1.6)
    (one,) = said_of_scales(tmp_path / "unknown", 1.6, refuse=False)
    assert one.severity == "warning"


def test_a_calibration_of_the_session_itself_is_never_another_ones(tmp_path: Path):
    data = read_dataset(Chamber.plain().write(tmp_path / "one"))
    made = calibrate_uniform(data).calibration
    ready = prepare(data, made, DiagnoseOptions(), np.random.default_rng(0))
    everything = np.ones(len(ready.session), dtype=np.bool_)
    changed = replace(ready.reading, counts=3 * ready.reading.counts)
    assert scales_differ(made, data, ready, {}, changed, everything) == ()
