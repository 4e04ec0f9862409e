"""A calibration that was fitted to another session is told where its own pose, E and S are not those of this one."""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from typing import cast

import numpy as np
import pytest
from report.diagnosis_cases import LOOP, TRUTH, calibration, session

from skincal.calibration import Finding, ModelParameters
from skincal.dataset import Dataset
from skincal.diagnose.options import DiagnoseOptions
from skincal.diagnose.own_numbers import numbers_differ, scales_differ
from skincal.diagnose.prepare import prepare
from skincal.errors import InputError
from skincal.gap.problem import Slopes
from skincal.gap.reading import Reading
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


def said_of_scales(factor: float, dataset: str = "ab" * 32) -> tuple[Finding, ...]:
    """What is said where the scales of half of the taxels are really so many times as large."""
    made = calibration()
    made = replace(made, provenance=replace(made.provenance, dataset_sha256=dataset))
    data = of_loop()
    ready = prepare(data, made, DiagnoseOptions(), np.random.default_rng(0))
    slopes = refit(ready.start, ready.session, ready.reading, replace(ready.options, steps=0)).slopes
    off = np.where(np.arange(16) % 2 == 0, factor - 1.0, 0.0)
    noise = np.random.default_rng(3).normal(size=slopes.residual.shape)
    # The residual is measured minus modelled: values grow in proportion to the scale.
    slopes = replace(slopes, residual=noise + slopes.base[..., -1] * off)
    everything = np.ones(len(ready.session), dtype=np.bool_)
    return scales_differ(made, data, slopes, ready.reading, everything)


def test_in_a_chamber_the_scales_of_taxels_tell_another_sensor():
    assert said_of_scales(1.0) == ()
    (one,) = said_of_scales(1.15)
    assert (one.code, one.severity) == ("other_calibration", "warning") and "taxels' scales" in one.text
    with pytest.raises(InputError, match=r"of the sensor that was pressed.*scales.*skincal fit"):
        said_of_scales(3.0)


def test_a_calibration_of_the_session_itself_is_never_another_ones():
    data = replace(of_loop(), sha256="cd" * 32)
    slopes = cast("Slopes", None)
    made = calibration()
    made = replace(made, provenance=replace(made.provenance, dataset_sha256="cd" * 32))
    assert scales_differ(made, data, slopes, cast("Reading", None), np.ones(1, dtype=np.bool_)) == ()
