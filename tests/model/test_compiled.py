"""The compiled routine: imported late, cached, said once, and no place to cache in is no error."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

import skincal

IMAGE = """
import sys
from skincal import compiling
compiling.on_compile = lambda: print("compiling", file=sys.stderr)
from skincal.model import *
assert "numba" not in sys.modules, "numba imported before the first press"
patch = Patch.build(Plane(), TaxelLayout.grid(2, 2, taxel_size_m=2e-3, pitch_m=3e-3), SensorPose(0.0, 0.0), 1e-3)
contact = Contacts([[0.0, 0.0, 0.0]], [[0.0, 0.0, 1.0]], [1.0])
print(Skin(patch, SkinParameters(5e8, 60.0)).image(Sphere(6e-3), contact).sum())
"""


def _run(place: Path | None = None, **environment: str) -> subprocess.CompletedProcess[str]:
    done = subprocess.run(
        [sys.executable, "-c", IMAGE],
        capture_output=True,
        text=True,
        check=True,
        cwd=place,
        env={**os.environ, **environment},
    )
    assert float(done.stdout) > 10
    return done


def test_command_line_and_model_start_without_numba():
    code = "import sys, skincal.cli.main, skincal.model; assert 'numba' not in sys.modules"
    subprocess.run([sys.executable, "-c", code], check=True)


@pytest.mark.slow
def test_compiles_once_and_says_so(tmp_path: Path):
    assert _run(NUMBA_CACHE_DIR=str(tmp_path)).stderr == "compiling\n"
    assert _run(NUMBA_CACHE_DIR=str(tmp_path)).stderr == ""


@pytest.mark.slow
def test_read_only_installation_uses_the_users_cache(tmp_path: Path):
    """A file stands where the cache beside the sources would be, which stops even an administrator."""
    copy = tmp_path / "site" / "skincal"
    shutil.copytree(Path(skincal.__file__).parent, copy, ignore=shutil.ignore_patterns("__pycache__"))
    (copy / "model" / "press" / "__pycache__").write_text("")
    user = {
        "PYTHONDONTWRITEBYTECODE": "1",
        "XDG_CACHE_HOME": str(tmp_path / "user"),
    }
    assert _run(copy.parent, **user).stderr == "compiling\n"
    assert _run(copy.parent, **user).stderr == ""
    assert list((tmp_path / "user").rglob("*.nbi"))
    # Nowhere to write at all: it works, and compiles for itself.
    (tmp_path / "file").write_text("")
    assert _run(copy.parent, **{**user, "XDG_CACHE_HOME": str(tmp_path / "file")}).stderr == "compiling\n"
