from __future__ import annotations

import importlib.util
import json
import subprocess
from pathlib import Path

import pytest

from benchmarks import bench
from benchmarks.profile_fit import by_package, package


def test_every_part_is_a_module():
    for name in bench.MODULES:
        assert importlib.util.find_spec(f"benchmarks.{name}") is not None


def test_unknown_part_is_refused(capsys: pytest.CaptureFixture[str]):
    with pytest.raises(SystemExit) as stopped:
        bench.main(["--only", "model_speeds"])
    assert stopped.value.code == 2
    assert "model_speeds" in capsys.readouterr().err


def test_failed_part_leaves_its_old_figures(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    (tmp_path / "scaling.json").write_text("{}")

    def figures(name: str, options: list[str]) -> dict[str, int]:
        if name == "scaling":
            raise subprocess.CalledProcessError(1, "python")
        return {"us": 3}

    monkeypatch.setattr(bench, "module", figures)
    assert bench.main(["--only", "scaling,model_speed", "--results", str(tmp_path)]) == 1
    assert (tmp_path / "scaling.json").read_text() == "{}"
    assert json.loads((tmp_path / "model_speed.json").read_text()) == {"us": 3}
    kept = json.loads((tmp_path / "bench.json").read_text())
    assert kept["failed"] == ["scaling"]
    assert kept["numpy"] != "not installed"


def test_time_counts_for_the_package_that_uses_it():
    assert package("/a/skincal/fitting/refine.py") == "skincal.fitting"
    assert package("/a/skincal/units.py") == "skincal.units"
    assert package("/b/lib/python3.11/site-packages/scipy/optimize/x.py") == "scipy"
    parts = by_package(lambda: sum(i * i for i in range(3_000_000)))
    assert parts["other"] > 0.9
    assert sum(parts.values()) == pytest.approx(1)
