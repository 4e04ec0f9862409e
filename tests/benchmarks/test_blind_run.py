"""The runner of the blind test, with a stand-in for skincal, and with skincal itself."""

import json
import pickle
import sys
from dataclasses import replace

import pytest

from benchmarks.blind import run
from benchmarks.blind.bench import Bench, RunError
from benchmarks.blind.kept import check_study, packed, unpack
from benchmarks.blind.measures import summary
from benchmarks.blind.run import check_diagnose, planned, run_all
from benchmarks.blind.score import main as score_main
from benchmarks.blind.score import opened
from benchmarks.blind.suites import CLASS_OF, SUITES, specs
from benchmarks.blind.truth.catalogue import EFFECTS
from benchmarks.blind.truth.spec import Spec

STAND_IN = """
import json, sys
from pathlib import Path
verb, *rest = sys.argv[1:]
assert (Path(rest[0]) / "presses.csv").exists() or rest == ["--help"]
out = Path(rest[rest.index("--out") + 1]) if "--out" in rest else None
if verb == "fit":
    out.mkdir(parents=True)
    print(json.dumps({"best": {}, "calibration": str(out)}))
elif verb == "diagnose" and out:
    assert (Path(rest[1])).is_dir()
    print("a message", file=sys.stderr)
    print(json.dumps({"verdict": "none", "effects": [], "unexplained": False, "cannot_see": [],
                      "gap": {"closed": None}}))
"""


@pytest.fixture
def bench(tmp_path):
    file = tmp_path / "stand_in.py"
    file.write_text(STAND_IN, encoding="utf-8")
    return Bench(tmp_path / "out", command=(sys.executable, str(file)))


def test_sizes_of_the_suites():
    asked = {"none": 100, "decoy": 60, "one": 12 * len(EFFECTS), "two": 60, "outside": 60, "poor": 60}
    for suite, count in asked.items():
        assert len(specs(suite, 0)) >= count
    assert specs("two", 0) == specs("two", 0) != specs("two", 1)
    names = [spec.name for suite in SUITES for spec in specs(suite, 0)]
    assert len(set(names)) == len(names)


def test_one_effect_has_all_effects_strengths_and_laws():
    one = specs("one", 0)
    assert {spec.effects[0][0] for spec in one} == set(EFFECTS) == set(CLASS_OF)
    assert len({(*spec.effects[0], spec.law) for spec in one}) == len(one) == 12 * len(EFFECTS)
    assert all(spec.law == "layer" for spec in specs("none", 0))


def test_two_effects_are_of_two_classes():
    for spec in specs("two", 0):
        first, second = (CLASS_OF[name] for name, _ in spec.effects)
        assert first != second


def test_at_least_six_kinds_outside_and_four_decoys():
    kinds = {spec.outside[0] for spec in specs("outside", 0) if spec.outside}
    assert len(kinds) >= 6
    assert len({spec.decoy for spec in specs("decoy", 0)}) >= 4


def test_part_of_a_run_is_part_of_each_suite():
    whole = planned(list(SUITES), 0, None)
    half = whole[: len(whole) // 2]
    counts = {suite: sum(spec.suite == suite for spec in half) for suite in SUITES}
    assert all(abs(counts[suite] - len(specs(suite, 0)) / 2) <= 1 for suite in SUITES)


def test_goes_to_workers_elsewhere(bench):
    copy = pickle.loads(pickle.dumps(bench))
    assert replace(copy, stop=bench.stop) == replace(bench, out=bench.out.resolve())


def test_runs_keeps_and_goes_on(bench, capsys):
    check_diagnose(bench)
    some = [Spec("none", 0, 3, "foundation"), Spec("poor", 1, 3, "foundation", "static")]
    told = []
    assert run_all(bench, some, 1, told.append) == 0
    assert len(told) == 2 and "diagnose" in told[0]
    record = json.loads(bench.result_file(some[0]).read_text(encoding="utf-8"))
    assert record["diagnose"]["json"]["verdict"] == "none"
    assert record["fit"]["cpu_s"] > 0
    assert b"expected" not in bench.label_file(some[0]).read_bytes()
    assert not list((bench.out / "sessions").iterdir())
    assert run._has_result(bench.result_file(some[0]), retry=True)
    outcomes, failed = opened(bench.out)
    assert not failed and len(outcomes) == 2
    assert summary(outcomes, failed)["none"]["false_alarms"]["share"] == 0
    check_study(bench.out, {"seed": 3})
    assert score_main([str(bench.out)]) == 2
    assert "none 99" in capsys.readouterr().err
    assert score_main([str(bench.out), "--partial"]) == 0
    assert "| 0 % (0 of 1) |" in capsys.readouterr().out


def test_tests_of_several_seeds_are_scored_together(bench, tmp_path, capsys):
    folders = [tmp_path / "three", tmp_path / "four"]
    for seed, folder in zip((3, 4), folders, strict=True):
        own = replace(bench, out=folder)
        own.run(Spec("none", 0, seed, "foundation"))
        check_study(folder, {"seed": seed})
    given = [str(folder) for folder in folders]
    assert score_main([*given, "--partial", "--out", str(tmp_path / "both.json")]) == 0
    assert "| 0 % (0 of 2) |" in capsys.readouterr().out
    both = json.loads((tmp_path / "both.json").read_text(encoding="utf-8"))
    assert [run["seed"] for run in both["study"]["runs"]] == [3, 4]
    assert [line["seed"] for line in both["sessions"]] == [3, 4]
    assert score_main([given[0], given[0], "--partial"]) == 2
    assert "twice" in capsys.readouterr().err


def test_a_label_that_was_changed_is_refused(bench, capsys):
    spec = Spec("none", 0, 3, "foundation")
    bench.run(spec)
    other = Spec("none", 1, 3, "foundation")
    bench.run(other)
    check_study(bench.out, {"seed": 3})
    bench.label_file(spec).write_bytes(bench.label_file(other).read_bytes())
    assert score_main([str(bench.out), "--partial"]) == 2
    assert "SHA-256" in capsys.readouterr().err


def test_what_fails_is_kept_as_failed(bench, tmp_path):
    broken = tmp_path / "broken.py"
    broken.write_text(
        STAND_IN.replace('print("a message", file=sys.stderr)', 'sys.exit("no way")'), encoding="utf-8"
    )
    failing = Bench(tmp_path / "out", command=(sys.executable, str(broken)))
    spec = Spec("decoy", 0, 3, "foundation", decoy="glitches")
    assert run_all(failing, [spec], 1, lambda text: None) == 1
    record = json.loads(failing.result_file(spec).read_text(encoding="utf-8"))
    assert "no way" in record["diagnose"]["messages"]
    assert not run._has_result(failing.result_file(spec), retry=True)
    outcomes, failed = opened(failing.out)
    alarms = summary(outcomes, failed)["decoy"]["false_alarms"]
    assert (alarms["hits"], alarms["of"], alarms["reached"]) == (1, 1, False)


def test_a_command_that_does_not_end_is_stopped(tmp_path):
    file = tmp_path / "endless.py"
    file.write_text("import time; time.sleep(60)", encoding="utf-8")
    done = Bench(tmp_path, timeout_s=0.2, command=(sys.executable, str(file))).skincal("fit")
    assert done.status != 0 and done.wall_s < 10


def test_without_diagnose_it_does_not_begin(tmp_path):
    file = tmp_path / "old.py"
    file.write_text("import sys; sys.exit(2)", encoding="utf-8")
    with pytest.raises(RunError, match="diagnose"):
        check_diagnose(Bench(tmp_path, command=(sys.executable, str(file))))


def test_another_test_is_refused(tmp_path):
    check_study(tmp_path / "out", {"seed": 1})
    check_study(tmp_path / "out", {"seed": 1})
    with pytest.raises(RunError, match="another --out"):
        check_study(tmp_path / "out", {"seed": 2})


def test_unknown_suite(tmp_path, capsys):
    with pytest.raises(SystemExit):
        run.main(["--out", str(tmp_path), "--suite", "every"])
    assert "outside" in capsys.readouterr().err


def test_a_run_goes_on_elsewhere(bench, tmp_path):
    check_study(bench.out, {"seed": 3, "code": "abc"})
    spec = Spec("poor", 1, 3, "foundation", "static")
    bench.run(spec)
    file = tmp_path / "sessions.jsonl.gz"
    file.write_bytes(packed(bench.out))
    assert unpack(file, tmp_path / "there") == 1
    assert packed(tmp_path / "there") == file.read_bytes()
    for at in ("study.json", "labels/poor-001.sealed"):
        assert (tmp_path / "there" / at).read_bytes() == (bench.out / at).read_bytes()
    before, after = (
        json.loads((out / "results/poor-001.json").read_text(encoding="utf-8"))
        for out in (bench.out, tmp_path / "there")
    )
    # All but where it was written.
    assert before["fit"]["json"].pop("calibration") and before == after
    check_study(tmp_path / "other", {"seed": 3, "code": "abd"})
    with pytest.raises(RunError, match="another --out"):
        unpack(file, tmp_path / "other")
    with pytest.raises(RunError, match=r"poor\.sealed"):
        unpack(bench.out / "poor.sealed", tmp_path / "there")


def test_a_fit_that_asks_for_fewer_taxels_gets_them(tmp_path):
    file = tmp_path / "asks.py"
    refuses = 'if verb == "fit" and "--min-active" not in rest: sys.exit("or lower --min-active")\n'
    file.write_text(STAND_IN.replace('if verb == "fit":', refuses + 'if verb == "fit":'), encoding="utf-8")
    record = Bench(tmp_path / "out", command=(sys.executable, str(file))).run(
        Spec("none", 0, 3, "foundation")
    )
    assert record["fit"]["status"] == record["diagnose"]["status"] == 0


STATIC = Spec("one", 0, 7, "foundation", "static", effects=(("crosstalk", 4.0),))
WHOLE = Spec("one", 0, 7, effects=(("crosstalk", 1.2),))


@pytest.mark.slow
@pytest.mark.parametrize(
    "some", [(STATIC,), (Spec("none", 0, 7), WHOLE)], ids=["static presses", "whole sessions"]
)
def test_a_slice_with_skincal_itself(tmp_path, some):
    bench = Bench(tmp_path / "out", extra=("--no-cache", "--no-report", "--workers", "1"))
    check_diagnose(bench)
    assert run_all(bench, some, 1, print) == 0
    outcomes, failed = opened(bench.out)
    assert not failed
    by_suite = {outcome.label["suite"]: outcome for outcome in outcomes}
    assert "none" not in by_suite or by_suite["none"].verdict == "none"
    assert by_suite["one"].right_class()
    assert by_suite["one"].found("crosstalk")
