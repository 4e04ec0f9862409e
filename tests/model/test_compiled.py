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
import hashlib, sys
import numpy as np
from skincal import progress
progress.on_compile = lambda: print("compiling", file=sys.stderr)
from skincal.model import *
assert "numba" not in sys.modules, "numba imported before the first press"
layout = TaxelLayout.grid(2, 2, taxel_size_m=2e-3, pitch_m=3e-3)
patch = Patch.build(Cylinder(0.0115), layout, SensorPose(0.0, 0.1), 4e-4)
turn = np.linspace(-0.4, 0.4, 60)
normals = np.column_stack([np.sin(turn), np.zeros(60), np.cos(turn)])
contacts = Contacts(0.0115 * normals, normals, np.linspace(0.5, 4.0, 60))
values = Skin(patch, SkinParameters(5e8, 60.0)).values(Sphere(6e-3), contacts)
print(values.max(), hashlib.sha256(values.tobytes()).hexdigest())
"""


def _run(place: Path | None = None, **environment: str) -> subprocess.CompletedProcess[str]:
    done = subprocess.run(
        [sys.executable, "-c", IMAGE],
        capture_output=True,
        text=True,
        check=True,
        cwd=place,
        env={**{k: v for k, v in os.environ.items() if not k.startswith("NUMBA_")}, **environment},
    )
    assert float(done.stdout.split()[0]) > 10
    return done


def test_command_line_and_model_start_without_numba():
    code = "import sys, skincal.cli.main, skincal.model; assert 'numba' not in sys.modules"
    subprocess.run([sys.executable, "-c", code], check=True)


@pytest.mark.slow
def test_compiles_once_and_says_so(tmp_path: Path):
    compiled, cached = _run(NUMBA_CACHE_DIR=str(tmp_path)), _run(NUMBA_CACHE_DIR=str(tmp_path))
    assert compiled.stderr == "compiling\n"
    assert cached.stderr == ""
    # To the last bit: a process that compiles must not have other code than those that come after it.
    assert compiled.stdout == cached.stdout


@pytest.mark.slow
def test_read_only_installation_uses_the_users_cache(tmp_path: Path):
    """A file stands where the cache beside the sources would be, which stops even an administrator."""
    copy = tmp_path / "site" / "skincal"
    shutil.copytree(Path(skincal.__file__).parent, copy, ignore=shutil.ignore_patterns("__pycache__"))
    (copy / "model" / "press" / "__pycache__").write_text("")
    user = {"PYTHONDONTWRITEBYTECODE": "1", "XDG_CACHE_HOME": str(tmp_path / "user")}
    assert _run(copy.parent, **user).stderr == "compiling\n"
    assert _run(copy.parent, **user).stderr == ""
    assert list((tmp_path / "user").rglob("*.nbi"))
    # Nowhere to write at all: it works, and compiles for itself.
    (tmp_path / "file").write_text("")
    assert _run(copy.parent, **{**user, "XDG_CACHE_HOME": str(tmp_path / "file")}).stderr == "compiling\n"
