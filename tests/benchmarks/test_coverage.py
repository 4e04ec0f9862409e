"""The coverage study counts right, resumes, and tells one study from another."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from benchmarks import interval_coverage as coverage
from benchmarks.coverage_few import counted
from benchmarks.coverage_kept import as_shipped, read_kept, write_kept
from benchmarks.coverage_store import Store
from benchmarks.coverage_tables import SCALES, as_text, summary, wilson
from benchmarks.interval_coverage import LEVELS, QUANTILES, Job, main, run_job, strict_json, told_values
from benchmarks.sessions import Law, Truth
from skincal.fitting.conclude import interval
from skincal.fitting.fit_options import FitOptions, GridSteps, SearchBox
from skincal.fitting.result import PARAMETERS

TRUTH = Truth("layer", 0.024, 3.0, -9.0, 4e8, 70.0, 0.8e-3, 0.3e-3, -0.2e-3, 1.5e-3, 0.4)
BOX = {
    "across_m": [-2e-3, 2e-3],
    "y_m": [0.02, 0.028],
    "alpha_rad": [-0.3, 0.3],
    "elasticity_pa_per_m": [1e8, 2e9],
}


def record(index: int, *, law: Law = "foundation", error: float = 0.0, half: float = 0.1) -> dict[str, Any]:
    """A session whose best point is off by ``error`` (relative), with an interval of ``half`` to each side."""
    told = told_values(TRUTH)
    best = {name: value * (1 + error) for name, value in told.items()}
    intervals = {name: sorted([best[name] * (1 - half), best[name] * (1 + half)]) for name in PARAMETERS}
    return {
        "law": law,
        "index": index,
        "truth": TRUTH.plain(),
        "told": told,
        "best": best,
        "intervals": intervals,
        "levels": {str(level): intervals for level in LEVELS},
        "box": BOX,
        "mse_counts2": 0.02,
        "valley_mse_counts2": 0.03,
        "seconds": 10.0 + index,
        "effective_draws": 500.0,
        "presses_used": 24 + index,
        "findings": ["glitches"] if index == 0 else [],
        "no_interval": False,
    }


def test_wilson_against_published_numbers() -> None:
    # Newcombe 1998, table I: 81 of 263, 15 of 148, 0 of 20, 1 of 29.
    for hits, count, low, high in (
        (81, 263, 0.2553, 0.3662),
        (15, 148, 0.0624, 0.1605),
        (0, 20, 0, 0.1611),
        (1, 29, 0.0061, 0.1718),
    ):
        assert wilson(hits, count) == pytest.approx((low, high), abs=1e-4)
    assert wilson(0, 0) == (0.0, 1.0)


def test_truth_is_reported_as_the_positions_do() -> None:
    told = told_values(TRUTH)
    assert told["across_m"] == pytest.approx(np.radians(3.0) * 0.0115 + 0.3e-3)
    assert told["y_m"] == pytest.approx(0.0238)
    assert told["alpha_rad"] == pytest.approx(np.radians(-9.0))
    assert (told["elasticity_pa_per_m"], told["scale_per_n"]) == (4e8, 70.0)


def test_summary_counts_misses_widths_and_errors() -> None:
    good = [record(i, error=0.05) for i in range(7)]
    too_high, too_low = record(7, error=0.3), record(8, error=-0.3)
    found = summary([*good, too_high, too_low, {"law": "foundation", "index": 9, "failed": "no press"}], 0.98)
    group = found["foundation"]
    assert list(found) == ["foundation"]
    assert (group["sessions"], group["failed"]) == (10, 1)
    y = group["parameters"]["y_m"]
    assert y["coverage"] == pytest.approx(7 / 9)
    assert (y["truth_below"], y["truth_above"], y["unbounded"]) == (1, 1, 0)
    assert y["median_width"] == pytest.approx(0.2 * 1.05 * 23.8)
    assert y["rms_error"] == pytest.approx(23.8 * np.sqrt((7 * 0.05**2 + 2 * 0.3**2) / 9))
    assert y["mean_width_of_range"] == pytest.approx(y["mean_width"] / 8.0)
    elasticity = group["parameters"]["elasticity_pa_per_m"]
    assert elasticity["median_width"] == pytest.approx(100 * np.log(1.1 / 0.9))
    assert elasticity["mean_width_of_range"] == pytest.approx(np.log(1.1 / 0.9) / np.log(20))
    assert np.isnan(group["parameters"]["scale_per_n"]["mean_width_of_range"])
    assert group["findings"] == {"glitches": 1}
    assert group["max_seconds"] == 18.0


def test_an_unbounded_interval_counts_as_holding_the_truth() -> None:
    wide = record(0)
    for intervals in (wide["intervals"], *wide["levels"].values()):
        intervals.update({name: [-np.inf, np.inf] for name in SCALES})
    [group] = summary([wide, record(1, error=0.01)], 0.98).values()
    for name in SCALES:
        parameter = group["parameters"][name]
        assert parameter["coverage"] == 1.0
        assert parameter["unbounded"] == 1
        assert np.isfinite(parameter["mean_width"])


def test_layers_are_reported_against_their_stiffness() -> None:
    layers = [record(i, law="layer", error=-0.2) for i in range(4)]
    found = summary([*layers, record(4)], 0.98)
    assert list(found) == ["layer", "foundation", "all"]
    everything, thin = found["layer"]["equivalent_elasticity"]
    assert everything["ratio_quantiles"]["0.5"] == pytest.approx(0.8)
    assert everything["held"] == 0
    assert (thin["layers"], thin["sessions"]) == ("h < 1.75 mm, nu > 0.375", 4)
    text = as_text(found)
    assert text.count("\n| elasticity_pa_per_m |") == 3
    assert "## layer: 4 sessions, 0 failed, level 0.98" in text


def test_results_hold_no_number_that_json_lacks() -> None:
    assert strict_json({"a": [np.inf, 1.0], "b": (float("nan"), "x")}) == {"a": [None, 1.0], "b": [None, "x"]}


def test_store_resumes_after_a_line_that_was_cut_off(tmp_path: Path) -> None:
    path = tmp_path / "study.jsonl"
    store = Store(path, {"seed": 0, "levels": (0.9, 0.95)})
    store.add(record(2))
    store.add(record(0))
    whole = path.read_text()
    path.write_text(whole[:-20])
    again = Store(path, {"seed": 0, "levels": (0.9, 0.95)})
    assert again.done == {("foundation", 2)}
    again.add(record(0))
    again.add(record(1))
    keys = [("foundation", i) for i in range(3)]
    assert [r["index"] for r in Store(path, {"seed": 0, "levels": (0.9, 0.95)}).of(keys)] == [0, 1, 2]


def test_another_study_is_refused(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(coverage, "run_job", lambda job: record(job.index, law=job.law))
    command = ["--sessions", "2", "--workers", "1", "--out", str(tmp_path / "study.json")]
    assert main(command) == 0
    assert "2 sessions, 0 failed" in capsys.readouterr().out
    assert main([*command, "--seed", "1"]) == 2
    assert "another study" in capsys.readouterr().err


def test_a_study_can_grow(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    ran: list[tuple[str, int]] = []

    def fake(job: Job) -> dict[str, Any]:
        ran.append((job.law, job.index))
        return record(job.index, law=job.law)

    monkeypatch.setattr(coverage, "run_job", fake)
    for sessions in ("1", "3"):
        main(["--sessions", sessions, "--workers", "1", "--out", str(tmp_path / "study.json")])
    capsys.readouterr()
    assert ran == [(law, i) for i in range(3) for law in ("foundation", "layer")]
    written = json.loads((tmp_path / "study.json").read_text())
    assert written["laws"]["all"]["sessions"] == 6


def _kept(draws: dict[str, list[np.ndarray]], widening: float, **more: Any) -> dict[str, Any]:
    """A session as it is kept, from its draws by contact law."""
    kept = {key: value for key, value in record(3).items() if key not in ("intervals", "levels")}
    quantiles = {n: [np.quantile(law, QUANTILES).tolist() for law in laws] for n, laws in draws.items()}
    return kept | {"quantiles": quantiles, "scale_widening": widening} | more


@pytest.fixture
def draws() -> dict[str, list[np.ndarray]]:
    rng = np.random.default_rng(3)
    best = record(3)["best"]
    return {n: [best[n] * np.exp(0.03 * rng.normal(size=999) + s) for s in (0, 0.05)] for n in PARAMETERS}


def test_kept_sessions_get_the_intervals_of_their_draws(draws: dict[str, list[np.ndarray]]) -> None:
    box = SearchBox(**{name: tuple(ends) for name, ends in BOX.items()})
    found = as_shipped(_kept(draws, 1.0), QUANTILES, LEVELS, 0.98)
    for name, laws in draws.items():
        for level in LEVELS:
            expected = interval(name, laws, found["best"][name], box, level)
            assert found["levels"][str(level)][name] == pytest.approx(expected), (name, level)
    assert found["intervals"] == found["levels"]["0.98"]
    assert as_shipped(found, QUANTILES, LEVELS, 0.98) is found


def test_stored_draws_that_were_widened_are_narrowed(draws: dict[str, list[np.ndarray]]) -> None:
    plain = as_shipped(_kept(draws, 1.0), QUANTILES, LEVELS, 0.98)["intervals"]
    narrower = as_shipped(_kept(draws, 2.0), QUANTILES, LEVELS, 0.98)["intervals"]
    middle = np.median(draws["scale_per_n"][0])
    below = np.log(middle / np.array([plain["scale_per_n"][0], narrower["scale_per_n"][0]]))
    assert below[1] == pytest.approx(0.5 * below[0])
    assert {n: v for n, v in narrower.items() if n != "scale_per_n"} == {
        n: v for n, v in plain.items() if n != "scale_per_n"
    }


def test_a_kept_session_without_intervals_stays_without(draws: dict[str, list[np.ndarray]]) -> None:
    found = as_shipped(_kept(draws, 1.0, no_interval=True), QUANTILES, LEVELS, 0.98)
    assert all(v == [-np.inf, np.inf] for v in found["intervals"].values())


def test_a_study_that_was_kept_is_counted_again_without_a_fit(
    tmp_path: Path,
    draws: dict[str, list[np.ndarray]],
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.setattr(coverage, "run_job", lambda job: _kept(draws, 1.0, index=job.index, law=job.law))
    kept, out = tmp_path / "kept.jsonl.gz", tmp_path / "study.json"
    command = ["--law", "foundation", "--sessions", "1", "--workers", "1", "--out", str(out)]
    assert main([*command, "--keep", str(kept)]) == 0
    first = out.read_bytes()
    monkeypatch.setattr(coverage, "run_job", lambda _: pytest.fail("nothing shall be fitted"))
    assert main(["--kept", str(kept), "--out", str(tmp_path / "again.json")]) == 0
    again = json.loads((tmp_path / "again.json").read_text())
    assert again["study"] == json.loads(first)["study"]
    width = again["laws"]["foundation"]["parameters"]["y_m"]["mean_width"]
    assert width == pytest.approx(json.loads(first)["laws"]["foundation"]["parameters"]["y_m"]["mean_width"])
    write_kept(kept, *read_kept(kept))
    capsys.readouterr()
    assert main(["--kept", str(tmp_path / "none.gz"), "--out", str(out)]) == 2
    assert "none.gz" in capsys.readouterr().err


def test_documented_table_is_that_of_the_stored_sessions(tmp_path: Path) -> None:
    results = Path(coverage.__file__).parent / "results"
    assert (
        main(["--kept", str(results / "coverage_sessions.jsonl.gz"), "--out", str(tmp_path / "c.json")]) == 0
    )
    again, shown = (json.loads(path.read_text()) for path in (tmp_path / "c.json", results / "coverage.json"))
    assert again["study"] == shown["study"]
    for level in ("parameters", "levels"):
        assert _flat(again["laws"]["foundation"][level]) == pytest.approx(
            _flat(shown["laws"]["foundation"][level])
        )


def test_missing_intervals_of_few_presses_are_counted(draws: dict[str, list[np.ndarray]]) -> None:
    def session(spare: int, shift: float) -> dict[str, Any]:
        told = {name: laws[0].mean() * (1 + shift) for name, laws in draws.items()}
        more = {"told": told, "presses_used": 5, "readings_to_spare": spare}
        return _kept(draws, 1.0, no_interval=spare <= 0, **more)

    rows = counted([session(0, 0.0), session(-2, 9.0), session(3, 0.01), {"failed": "no peak"}], 0.98)
    held = "intervals of 98 % that hold the truth"
    assert [(row["readings beyond the unknowns"], row["sessions"], row[held]) for row in rows] == [
        ("none", 2, "5 of 10"),
        ("some", 1, "5 of 5"),
    ]


def _flat(value: Any, at: str = "") -> dict[str, float]:
    """The numbers of nested tables, by their path."""
    if isinstance(value, dict | list):
        items = value.items() if isinstance(value, dict) else enumerate(value)
        return {k: v for key, item in items for k, v in _flat(item, f"{at}/{key}").items()}
    return {at: value} if isinstance(value, int | float) else {}


@pytest.mark.slow
def test_a_session_from_end_to_end() -> None:
    options = FitOptions(steps=GridSteps(2e-3, 1e-3, np.radians(5), 10), law_spreads_m=(0.0,), draws=300)
    found = run_job(Job(0, "foundation", 1, options))
    again = json.loads(json.dumps(found))
    [group] = summary([again], options.level).values()
    assert group["failed"] == 0
    for name in SCALES:
        low, high = found["intervals"][name]
        assert low < found["best"][name] < high
        assert found["levels"]["0.9"][name][0] >= low
        assert found["best"][name] == pytest.approx(
            found["told"][name], rel=0.2, abs=2e-3 if name == "across_m" else 0.1
        )
