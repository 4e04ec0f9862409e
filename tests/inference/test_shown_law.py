"""The contact law: shown where it is there, not where it is not; the same in the fit and in the skin."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from diagnosis.diagnose_data import moving, reading
from inference.made import made
from report.diagnosis_cases import calibration

from skincal.calibration import FittedLaw
from skincal.dataset import Dataset
from skincal.diagnosis.diagnosis import Diagnosis, summary
from skincal.diagnosis.observed import observe
from skincal.diagnosis.workflow import diagnose
from skincal.inference.contact_law import law_parameters
from skincal.inference.fit import Fitter
from skincal.model import ContactLaw
from skincal.prediction import predict_dataset

LAW = ContactLaw(exponent=0.75, radius_scale=1.1)
"""About that of a layer of some millimetres."""


def with_law(presses: int = 24) -> Dataset:
    """A session of a skin with a contact law of its own; nothing clips, so that small values show."""
    given = moving(presses)
    said = predict_dataset(replace(calibration(), contact_law=FittedLaw(LAW)), given).dataset
    assert said.frames is not None
    rng = np.random.default_rng(3)
    counts = np.rint(
        40 + 2 * np.nan_to_num(said.frames.counts) + rng.standard_normal(said.frames.counts.shape)
    )
    return reading(given, counts, value_max=1023)


@cache
def found() -> Diagnosis:
    """The diagnosis of such a session, from a calibration that does not know of the law."""
    data, cal = with_law(), calibration()
    cal = replace(
        cal, sensor=data.meta.sensor, model=replace(cal.model, scale_per_n=2 * cal.model.scale_per_n)
    )
    return diagnose(data, cal, seed=1)


@cache
def fitter() -> Fitter:
    """Of a few presses, with a start."""
    data = made(presses=6)
    cal = replace(calibration(), sensor=data.meta.sensor)
    return observe(data, cal, np.random.default_rng(0), keep=False).fitter


def test_numbers_of_a_state_and_a_law_are_the_same():
    numbers = np.array([0.12, -0.3, 0.04, 0.0])
    assert law_parameters(fitter().forward.contact_law(numbers)) == pytest.approx(numbers)
    assert law_parameters(ContactLaw()).tolist() == [0, 0, 0, 0]
    assert fitter().forward.contact_law(np.zeros(4)).reference_radius_m == calibration().indenter.radius_m


@pytest.mark.parametrize(
    "law",
    [
        (0.1, 0, 0),
        (0, 0.3, 0),
        (0, -0.3, 0),
        (0, 0, 0.04),
        (0.1, -0.2, 0.03),
        (-0.48, 0.1, 0.05),
        (0.3, 0, 0.1),
    ],
)
def test_a_skin_has_the_law_that_is_fitted(law: tuple[float, float, float]):
    forward, state = fitter().forward, fitter().priors.start
    fitted = forward.predict(replace(state, law=np.array([*law, 0.0]))).values - forward.predict(state).values
    skin = forward.skin(state)
    other = replace(skin, skin=replace(skin.skin, contact=forward.contact_law(np.array([*law, 0.0]))))
    change = other.values(forward.samples) - skin.values(forward.samples)
    # Tables take means over cells, the skin sums points.
    assert np.sqrt(np.mean((change - fitted) ** 2)) < 0.04 + 0.05 * np.sqrt(np.mean(fitted**2))


def test_it_is_added_where_the_data_show_it():
    d = found()
    assert d.verdict == "none" and not d.effects
    law = d.calibration.contact_law
    assert law is not None
    low, high = law.intervals["exponent"]
    assert low < law.law.exponent < high < 1.0
    assert low < LAW.exponent < high
    said = summary(d)["contact_law"]
    assert said["exponent"] == law.law.exponent and said["intervals"]["exponent"] == (low, high)
    assert "contact_law" in {f.code for f in d.findings}
    assert d.gap.after < d.gap.before


def test_predictions_have_it():
    d, data = found(), with_law()
    assert data.frames is not None

    def error(cal: object) -> float:
        said = predict_dataset(cal, data).dataset  # type: ignore[arg-type]
        assert said.frames is not None and data.frames is not None
        on = data.frames.force_n > 0.2
        return float(np.sqrt(np.mean((said.frames.counts + 40 - data.frames.counts)[on] ** 2)))

    assert error(d.calibration) < error(replace(d.calibration, contact_law=None))


def test_nothing_is_added_to_a_foundation():
    data = made(presses=24)
    cal = replace(calibration(), sensor=data.meta.sensor)
    d = diagnose(data, cal, seed=1)
    assert d.calibration.contact_law is None and d.calibration is cal
    assert summary(d)["contact_law"] is None
