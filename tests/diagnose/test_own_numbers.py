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
from skincal.calibration import Calibration, Finding, ModelParameters
from skincal.dataset import Dataset, read_dataset
from skincal.diagnose.options import DiagnoseOptions
from skincal.diagnose.own_numbers import numbers_differ, scales_differ
from skincal.diagnose.prepare import prepare
from skincal.diagnose.workflow import diagnose
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


def chamber(tmp_path: Path, now: Chamber, *, frames: bool = True) -> tuple[Calibration, Dataset]:
    """A calibration of a chamber's session before, and the session now."""
    before = replace(now, gain=Chamber.plain().gain, rest=np.zeros(16))
    made = calibrate_uniform(read_dataset(before.write(tmp_path / "before", frames=frames))).calibration
    return made, read_dataset(replace(now, seed=1).write(tmp_path / "now", frames=frames))


def said_of_scales(
    tmp_path: Path, factor: np.ndarray | float, *, rest: float = 0.0, frames: bool = True
) -> tuple[Finding, ...]:
    """What is said in a chamber of a calibration if taxels are so many times as sensitive now."""
    plain = Chamber.plain()
    now = replace(plain, gain=plain.gain * factor, rest=plain.rest + rest)
    made, data = chamber(tmp_path, now, frames=frames)
    ready = prepare(data, made, DiagnoseOptions(), np.random.default_rng(0))
    everything = np.ones(len(ready.session), dtype=np.bool_)
    return scales_differ(made, data, ready, ready.reading, everything)


EVERY_OTHER = np.where(np.arange(16) % 2 == 0, 1.0, -1.0)


@pytest.mark.parametrize("frames", [True, False])
@pytest.mark.parametrize(("rest", "dead"), [(0.0, 0), (15.0, 0), (0.0, 4)])
def test_in_a_chamber_the_same_scales_are_nobody_elses(tmp_path: Path, rest: float, dead: int, frames: bool):
    """Neither a level at rest that is not in the model nor taxels that died are scales."""
    assert said_of_scales(tmp_path, np.where(np.arange(16) < dead, 0.0, 1.0), rest=rest, frames=frames) == ()


@pytest.mark.parametrize("rest", [0.0, 15.0])
def test_in_a_chamber_other_scales_are_told_by_how_much_they_are_off(tmp_path: Path, rest: float):
    (one,) = said_of_scales(tmp_path, 1.15**EVERY_OTHER, rest=rest)
    assert (one.code, one.severity) == ("other_calibration", "warning") and "taxels' scales" in one.text
    told = re.search(r"more than (\d+) %", one.text)
    assert told is not None and 12 <= int(told.group(1)) <= 16


@pytest.mark.parametrize("factor", [1.6, 4.0, 1.6**EVERY_OTHER, 0.5])
def test_in_a_chamber_the_scales_of_quite_another_sensor_are_refused(
    tmp_path: Path, factor: np.ndarray | float
):
    """Four times as much is mostly beyond what the converter shows."""
    with pytest.raises(InputError, match=r"of the sensor that was pressed.*scales.*skincal fit"):
        said_of_scales(tmp_path, factor)


def test_what_is_named_does_not_hide_that_scales_are_others(tmp_path: Path):
    """A scale of 1.2 is taken up by what looks like an effect."""
    plain = Chamber.plain(memory=0.1, plateaus=16)
    made, data = chamber(tmp_path, replace(plain, gain=1.2 * plain.gain), frames=False)
    found = diagnose(data, made)
    assert "other_calibration" in {finding.code for finding in found.findings}
    assert found.effects


def test_a_calibration_of_the_session_itself_is_never_another_ones(tmp_path: Path):
    data = read_dataset(Chamber.plain().write(tmp_path / "one"))
    made = calibrate_uniform(data).calibration
    ready = prepare(data, made, DiagnoseOptions(), np.random.default_rng(0))
    everything = np.ones(len(ready.session), dtype=np.bool_)
    changed = replace(ready.reading, counts=3 * ready.reading.counts)
    assert scales_differ(made, data, ready, changed, everything) == ()
