"""A calibration from a pressure chamber: scales, infinite intervals, and what can be done with it."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from chambers import Chamber

from skincal.calibrate import UniformOutcome, calibrate, calibrate_uniform
from skincal.calibration import read_calibration, write_calibration
from skincal.dataset import Dataset, read_dataset
from skincal.errors import WorkError
from skincal.prediction import predict_dataset
from skincal.ranges import from_calibration
from skincal.report.fit_uniform import write_uniform_report


@pytest.mark.parametrize("frames", [True, False])
def test_scales_of_a_chamber(tmp_path: Path, frames: bool):
    chamber = Chamber.plain(stuck=(5,))
    chamber.gain[9] = 0.0
    data = read_dataset(chamber.write(tmp_path / "chamber", frames=frames))
    outcome = calibrate_uniform(data)
    model = outcome.calibration.model
    assert model.scale_per_taxel_per_n is not None
    own = np.array(model.scale_per_taxel_per_n)
    lit = chamber.gain > 0
    ratio = own[lit] / chamber.gain[lit]
    assert ratio == pytest.approx(np.median(ratio), rel=0.04)
    assert own[9] == 0.0
    # The punch is a circle of 0.1 m, and a taxel bears the pressure times its own area.
    assert np.median(ratio) == pytest.approx(np.pi * 0.1**2 / 0.0025**2, rel=0.02)
    for name in ("y_m", "x_m", "alpha_deg", "elasticity_pa_per_m"):
        assert outcome.calibration.intervals[name] == (-np.inf, np.inf)
        assert not outcome.calibration.identified(name)
    low, high = outcome.calibration.intervals["scale_per_n"]
    assert low < model.scale_per_n < high < 1.2 * low
    codes = [finding.code for finding in outcome.calibration.findings]
    assert codes == ["uniform_pressure", "no_answer"]
    assert "(2, 1)" in outcome.calibration.findings[1].text


@pytest.fixture(scope="module")
def plain(tmp_path_factory: pytest.TempPathFactory) -> tuple[Dataset, UniformOutcome]:
    """A chamber's plateaus without frames, and their calibration."""
    data = read_dataset(Chamber.plain().write(tmp_path_factory.mktemp("plain") / "chamber", frames=False))
    return data, calibrate_uniform(data)


@pytest.mark.parametrize("presses", [3, 12])
def test_few_pressures_without_rest_give_the_same_scales(plain: tuple[Dataset, UniformOutcome], presses: int):
    data, whole = plain
    rows = np.linspace(0, len(data.presses) // 2, presses).astype(int)
    model = calibrate_uniform(replace(data, presses=data.presses.select(rows))).calibration
    assert model.model.scale_per_n == pytest.approx(whole.calibration.model.scale_per_n, rel=0.05)
    assert model.intervals["scale_per_n"][0] > 0.5 * model.model.scale_per_n


def test_the_calibration_predicts_what_it_was_made_of(plain: tuple[Dataset, UniformOutcome], tmp_path: Path):
    data, outcome = plain
    write_calibration(outcome.calibration, tmp_path / "cal")
    again = read_calibration(tmp_path / "cal")
    predicted = predict_dataset(again, data).dataset.presses.counts
    assert np.abs(predicted - data.presses.counts).max() < 2.5


def test_its_ranges_say_what_is_assumed(plain: tuple[Dataset, UniformOutcome]):
    found = from_calibration(plain[1].calibration)
    assert found["skin.scale_per_n"].source == "calibrated"
    assert found["skin.elasticity_pa_per_m"].source == "assumed"


def test_the_common_fit_refuses_and_says_where_to_go(plain: tuple[Dataset, UniformOutcome]):
    with pytest.raises(WorkError, match="calibrate_uniform"):
        calibrate(plain[0])


def test_a_chamber_in_which_nothing_answers(tmp_path: Path):
    chamber = Chamber.plain()
    chamber.gain[:] = 0.0
    data = read_dataset(chamber.write(tmp_path / "chamber"))
    with pytest.raises(WorkError, match="nothing can be calibrated"):
        calibrate_uniform(data)


def test_the_report_holds_everything(tmp_path: Path):
    data = read_dataset(Chamber.plain(group=(0, 1, 2)).write(tmp_path / "chamber"))
    write_uniform_report(calibrate_uniform(data), data, tmp_path)
    page = (tmp_path / "report.html").read_text()
    assert "16 of 16 taxels respond" in page
    assert page.count("data:image/png") == 2
    assert (tmp_path / "scales.png").is_file() and (tmp_path / "answers.png").is_file()


def test_a_punch_little_larger_than_the_patch(tmp_path: Path):
    """A membrane of 12 mm on a raw sensor: the modelled skin is larger than the punch, and nothing is ever at rest."""
    chamber = replace(Chamber.plain(), rest=30.0 + np.arange(16.0) % 5)
    folder = chamber.write(tmp_path / "chamber", frames=False)
    toml = (folder / "dataset.toml").read_text()
    (folder / "dataset.toml").write_text(toml.replace("radius_m = 0.1", "radius_m = 0.012"))
    table = pd.read_csv(folder / "presses.csv")
    table.assign(force_n=table["force_n"] * 0.12**2).to_csv(folder / "presses.csv", index=False)
    data = read_dataset(folder)
    calibration = calibrate_uniform(data).calibration
    assert calibration.model.scale_per_taxel_per_n is not None
    per_area = np.pi * 0.1**2 / 0.0025**2
    assert np.median(calibration.model.scale_per_taxel_per_n / chamber.gain) == pytest.approx(
        per_area, rel=0.02
    )
    assert calibration.loss.mse_counts2 < 2.0
    assert calibration.model.rest_counts == pytest.approx(32.0, abs=1.0)
    assert predict_dataset(calibration, data).presses.rmse_with_rest_counts < 1.5
