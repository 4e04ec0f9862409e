"""A calibration with effects added: where it goes, what its intervals are, and that it is one like any other."""

from __future__ import annotations

from dataclasses import replace
from math import degrees
from pathlib import Path
from typing import Any, cast

import numpy as np
import pytest
from calibrations import make_calibration
from diagnose.diagnose_data import moving

from skincal.calibration import Calibration, Effect, read_calibration, write_calibration
from skincal.diagnose.base import calibrated_model
from skincal.diagnose.newcal import new_calibration
from skincal.effects import EFFECTS
from skincal.gap.free import coordinates, parameters_at
from skincal.gap.hypothesis import Hypothesis
from skincal.gap.refit import Refit
from skincal.model import SensorPose
from skincal.predict import predict_dataset

SIZES = {"scalar": 1, "per-taxel": 16, "per-pose": 2}
COORDS = coordinates(EFFECTS["hysteresis"], SIZES)
X = np.array([0.8 if c.is_strength else 0.1 for c in COORDS])
SPREAD = 0.05


def ended(old: Calibration, scale: Any = 80.0) -> Hypothesis:
    """Another sensor than the calibrated one, as a refit may end."""
    model = replace(
        calibrated_model(old, moving()),
        pose=SensorPose(0.0236, 0.03, 0.01),
        elasticity_pa_per_m=6e8,
        scale_per_n=scale,
    )
    return Hypothesis(model, np.zeros((16, 3)), parameters_at(COORDS, X))


def added(old: Calibration, mean_square: float = 1.0, scale: Any = 80.0) -> Calibration:
    covariance = np.diag(np.concatenate([np.ones(5), np.full(len(X), SPREAD**2)]))
    found = Refit(ended(old, scale), X, cast("Any", None), 0.0, covariance)
    return new_calibration(old, found, COORDS, {}, mean_square, moving(), ("A", "B"))


def strength(new: Calibration) -> tuple[float, tuple[float, float]]:
    """The height of a hysteresis, and its interval."""
    one = next(e for e in new.effects if e.name == "hysteresis")
    low, high = one.intervals["height"]
    return float(cast("float", one.parameters["height"])), (
        float(cast("float", low)),
        float(cast("float", high)),
    )


def test_the_best_parameters_are_those_that_were_found():
    model = added(make_calibration()).model
    assert model.y_m == 0.0236 and model.elasticity_pa_per_m == 6e8 and model.scale_per_n == 80.0
    assert model.alpha_deg == pytest.approx(degrees(0.03)) and model.beta_deg == pytest.approx(degrees(0.01))


def test_it_says_which_dataset_it_is_fitted_to_and_which_one_before():
    old = make_calibration()
    covariance = np.eye(5 + len(X))
    found = Refit(ended(old), X, cast("Any", None), 0.0, covariance)
    named = replace(moving(), sha256="cd" * 32)
    new = new_calibration(old, found, COORDS, {}, 1.0, named, ("A", "B")).provenance
    assert new.dataset_sha256 == "cd" * 32
    assert new.extra["calibrated_on_sha256"] == old.provenance.dataset_sha256 != new.dataset_sha256
    assert new.extra["calibrated_on"] == old.provenance.dataset


def test_intervals_and_draws_of_the_sensor_keep_their_width_and_move():
    old = make_calibration()
    new = added(old)
    before, after = old.model.best(), new.model.best()
    assert old.draws is not None and new.draws is not None
    for name in ("y_m", "alpha_deg", "beta_deg"):
        moved = after[name] - before[name]
        assert new.intervals[name] == pytest.approx([end + moved for end in old.intervals[name]])
        assert new.draws[name] == pytest.approx(old.draws[name] + moved)
    for name in ("elasticity_pa_per_m", "scale_per_n"):
        ratio = after[name] / before[name]
        assert new.intervals[name] == pytest.approx([end * ratio for end in old.intervals[name]])
        assert new.draws[name] == pytest.approx(old.draws[name] * ratio)


def test_intervals_of_effects_are_those_of_the_fit_and_wider_where_it_fits_worse():
    value, (low, high) = strength(added(make_calibration()))
    coordinate = next(c for c in COORDS if c.parameter.name == "height")
    assert value == pytest.approx(coordinate.value(0.8))
    assert (low, high) == pytest.approx(
        (coordinate.value(0.8 - 1.96 * SPREAD), coordinate.value(0.8 + 1.96 * SPREAD))
    )
    better = strength(added(make_calibration(), mean_square=0.5))[1]
    assert better == pytest.approx((low, high))
    worse = strength(added(make_calibration(), mean_square=4.0))[1]
    assert worse[1] - worse[0] == pytest.approx(2 * (high - low), rel=1e-6)


def test_an_effect_that_was_there_stays_and_one_that_is_found_again_is_replaced():
    cross, loop = Effect("crosstalk", {"leak": 0.02}), Effect("hysteresis", {"height": 0.01})
    new = added(make_calibration(effects=(cross, loop)))
    assert [e.name for e in new.effects] == ["crosstalk", "hysteresis"]
    assert new.effects[0] == cross
    assert strength(new)[0] > 0.01


def test_a_scale_of_each_taxel_stays_one_of_each_taxel():
    each = tuple(70.0 + k for k in range(16))
    old = make_calibration()
    old = replace(old, model=replace(old.model, scale_per_taxel_per_n=each))
    new = added(old, scale=1.1 * np.array(each))
    assert new.model.scale_per_taxel_per_n == pytest.approx([1.1 * s for s in each])
    assert new.model.scale_per_n == pytest.approx(1.1 * old.model.scale_per_n)
    # One that does not answer has none.
    deaf = (0.0, *each[1:])
    old = replace(old, model=replace(old.model, scale_per_taxel_per_n=deaf))
    new = added(old, scale=1.1 * np.array(deaf))
    assert new.model.scale_per_n == pytest.approx(1.1 * old.model.scale_per_n)


def test_it_forgets_the_grid_and_says_where_it_comes_from():
    old = make_calibration()
    new = added(old)
    assert old.grid is not None and new.grid is None and new.folder is None
    assert "diagnosed" in new.provenance.extra and new.provenance.seed == old.provenance.seed


def test_written_and_read_again_it_predicts_the_same_and_what_it_comes_from_is_untouched(tmp_path: Path):
    write_calibration(make_calibration(), tmp_path / "cal")
    before = {p.name: p.read_bytes() for p in (tmp_path / "cal").iterdir()}
    new = added(read_calibration(tmp_path / "cal"))
    write_calibration(new, tmp_path / "new")
    again = read_calibration(tmp_path / "new")
    assert again.effects == new.effects and again.model == new.model
    said = [predict_dataset(one, moving()).dataset.frames for one in (new, again)]
    assert said[0] is not None and said[1] is not None
    np.testing.assert_array_equal(said[0].counts, said[1].counts)
    assert {p.name: p.read_bytes() for p in (tmp_path / "cal").iterdir()} == before
