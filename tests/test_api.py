"""The functions that a notebook uses: the main job on a small session, figures, errors."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

import skincal
from benchmarks.sessions import make_session
from skincal import api
from skincal.calibrate import Outcome
from skincal.dataset import Dataset
from skincal.errors import InputError
from skincal.ranges import read_ranges
from tests.fitting.conftest import ROUGH


@pytest.fixture(scope="module")
def session() -> Dataset:
    return make_session(np.random.default_rng(5), presses=40)[0]


@pytest.fixture(scope="module")
def fitted(session: Dataset) -> Outcome:
    fitted = api.fit(session, options=ROUGH, workers=1)
    assert isinstance(fitted, Outcome)
    return fitted


def test_fit_predict_and_ranges(session: Dataset, fitted: Outcome, tmp_path: Path) -> None:
    predicted = api.predict(fitted.calibration, session, slack=True)
    assert predicted.presses.rmse_counts < 2.0
    ranges = api.export_ranges(fitted.calibration, tmp_path / "ranges.toml", joint=True)
    assert read_ranges(tmp_path / "ranges.toml") == ranges
    with pytest.raises(InputError, match="does not exist yet"):
        api.export_ranges(fitted.calibration, tmp_path / "ranges.toml")


def test_figures_of_a_fit(session: Dataset, fitted: Outcome) -> None:
    assert api.plot(session).axes
    assert api.plot(fitted, dataset=session).axes
    assert api.plot(fitted, "images", dataset=session).axes
    with pytest.raises(InputError, match="one of the figures valley"):
        api.plot(fitted, "vally", dataset=session)
    with pytest.raises(InputError, match="give dataset="):
        api.plot(fitted)


def test_the_package_gives_every_name() -> None:
    assert all(getattr(skincal, name) is getattr(api, name) for name in api.__all__)
    assert set(api.__all__) < set(dir(skincal))
    with pytest.raises(AttributeError, match="no attribute 'fitt'"):
        skincal.fitt  # noqa: B018
