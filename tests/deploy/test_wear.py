"""One factor for lost sensitivity: what it finds, and when it says that one is not enough."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from calibrations import make_calibration
from commands import run

from skincal.calibration import read_calibration, write_calibration
from skincal.deploy.wear import Sensitivity, estimate_wear, measure_sensitivity
from skincal.errors import InputError, WorkError

TAXELS = 16


def rolled(
    rng: np.random.Generator, *, factor: float = 1.0, lost: int | None = None, exponent: float = 1.0
) -> Sensitivity:
    """A hand of its own sensitivity and pose, rolled on: images over a wandering force."""
    force = rng.uniform(0.6, 2.5, 300)
    weight = rng.dirichlet(np.full(TAXELS, 60.0))
    own = factor * 40 * rng.lognormal(0.0, 0.08)
    gain = np.ones(TAXELS)
    if lost is not None:
        gain[lost] = 0.05
    exponent += rng.normal(0.0, 0.05)
    images = own * (force**exponent)[:, None] * weight * gain + rng.normal(0.0, 0.3, (300, TAXELS))
    return measure_sensitivity(images, force)


def compare(rng: np.random.Generator, hands: int = 19, **now: object) -> object:
    return estimate_wear(rolled(rng, **now), [rolled(rng) for _ in range(hands)])  # type: ignore[arg-type]


def test_wear_factor_and_coverage_of_its_interval() -> None:
    rng = np.random.default_rng(0)
    found = [estimate_wear(rolled(rng, factor=0.7), [rolled(rng) for _ in range(19)]) for _ in range(200)]
    assert np.median([one.factor for one in found]) == pytest.approx(0.7, rel=0.03)
    assert found[0].level == pytest.approx(0.9)
    inside = np.mean([one.interval[0] <= 0.7 <= one.interval[1] for one in found])
    assert inside == pytest.approx(0.9, abs=0.065)


def test_one_factor_is_seldom_doubted_where_it_is_enough() -> None:
    rng = np.random.default_rng(1)
    doubted = [
        not estimate_wear(rolled(rng, factor=0.7), [rolled(rng) for _ in range(19)]).is_one_factor_enough
        for _ in range(200)
    ]
    assert np.mean(doubted) < 0.16


@pytest.mark.parametrize("now", [{"lost": 5}, {"exponent": 0.6}])
def test_wear_that_no_factor_explains(now: dict[str, object]) -> None:
    rng = np.random.default_rng(2)
    found = [compare(rng, **now) for _ in range(30)]
    assert np.mean([not one.is_one_factor_enough for one in found]) > 0.9  # type: ignore[attr-defined]
    if "lost" in now:
        assert {one.worst_taxel for one in found} == {5}  # type: ignore[attr-defined]


def test_too_little_to_tell() -> None:
    with pytest.raises(WorkError, match=r"20 images or more under 0\.5 N"):
        measure_sensitivity(np.ones((100, TAXELS)), np.full(100, 0.1))
    rng = np.random.default_rng(0)
    with pytest.raises(WorkError, match="got 2"):
        estimate_wear(rolled(rng), [rolled(rng), rolled(rng)])


@pytest.mark.usefixtures("no_picture")
def test_the_verb_scales_the_calibration(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    cal, now, out = tmp_path / "cal", tmp_path / "rolled", tmp_path / "rescaled"
    write_calibration(make_calibration(), cal)
    assert (
        run(
            "deploy", "marble", "marble-tactile-1", "--trajectory", "still", "--duration-s", 0.5, "--out", now
        )
        == 0
    )
    capsys.readouterr()
    assert run("rescale", cal, now, "--hands", 3, "--out", out, "--json") == 0
    told = json.loads(capsys.readouterr().out)
    before, after = read_calibration(cal), read_calibration(out)
    assert told["interval"][0] <= told["factor"] <= told["interval"][1] and told["hands"] == 3
    assert after.model.scale_per_n == pytest.approx(told["factor"] * before.model.scale_per_n)
    assert before.draws is not None and after.draws is not None
    np.testing.assert_allclose(after.draws["scale_per_n"], told["factor"] * before.draws["scale_per_n"])
    toml = now / "session" / "dataset.toml"
    ours = toml.read_text(encoding="utf-8")
    toml.write_text(ours.replace("value_max = 255", "value_max = 4095"), encoding="utf-8")
    assert run("rescale", cal, now, "--hands", 3) == 2
    assert "255 counts, as calibrated; got 4095" in capsys.readouterr().err
    toml.write_text(ours, encoding="utf-8")
    assert run("rescale", cal, tmp_path / "nowhere") == 2
    assert "expected the output of `skincal deploy`" in capsys.readouterr().err
    assert run("rescale", cal, now, "--out", out) == 2
    assert "--force" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("old", "new"),
    [
        ('"steps": 80', '"steps": 1e300'), ('"circle"', '"/etc/passwd"'), ('"circle"', "7"),
        ('"frequency_hz": 0.25', '"frequency_hz": "x"'), ('"duration_s": null', '"duration_s": 1e9'),
        ('"rest_counts": [0.0', '"rest_counts": ["x"'), ('"task": "marble"', '"task": "chess"'),
    ],
)  # fmt: skip
def test_a_run_that_deploy_cannot_have_made_is_refused(tmp_path: Path, old: str, new: str) -> None:
    from benchmarks.fuzz_readers import DEPLOYED
    from skincal.deploy.record import read_run_file

    text = json.dumps(DEPLOYED)
    (tmp_path / "deploy.json").write_text(text)
    assert read_run_file(tmp_path).steps == 80
    assert old in text
    (tmp_path / "deploy.json").write_text(text.replace(old, new, 1))
    with pytest.raises(InputError, match=r"deploy\.json"):
        read_run_file(tmp_path)
