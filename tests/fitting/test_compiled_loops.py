"""The compiled loops of the fit: said once, cached, the same bytes from processes that compile and that do not."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

FIT = """
import hashlib, sys
import numpy as np
from skincal import progress
progress.on_compile = lambda: print("compiling", file=sys.stderr)
from skincal.fitting.grid import evaluate_slab
from skincal.fitting.problem import build_problem
from skincal.fitting.solve import micro_settings, plan_grid
from skincal.fitting.tasks import Neighbourhood
from tests.fitting.conftest import BOX, QUICK, Truth, make_session, rig
problem = build_problem(rig(), make_session(presses=12)[0])
slab = evaluate_slab(problem, plan_grid(problem, BOX, QUICK), 1, micro_settings(problem))
count = 4 * len(problem)
macro, press = np.tile(Truth().macro, (count, 1)), np.arange(count) % len(problem)
model = Neighbourhood.around(macro[0]).model(problem)
state = model.fit_nuisance(macro, np.full((count, 6), 0.05), press, np.zeros((count, 3)))
arrays = [slab.mse_counts2, slab.slack_rms_m, *state]
print(hashlib.sha256(b"".join(np.ascontiguousarray(a).tobytes() for a in arrays)).hexdigest())
"""


@pytest.mark.slow
def test_compiles_once_and_gives_the_same_bytes(tmp_path: Path) -> None:
    environment = os.environ | {"NUMBA_CACHE_DIR": str(tmp_path), "PYTHONPATH": os.pathsep.join(sys.path)}
    compiled, read = (
        subprocess.run(
            [sys.executable, "-c", FIT], env=environment, capture_output=True, text=True, check=True
        )
        for _ in range(2)
    )
    assert compiled.stderr == "compiling\n"
    assert read.stderr == ""
    assert compiled.stdout == read.stdout
