"""What tables of images say at single places."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np

from skincal.fitting import lookup
from skincal.fitting.general_table import SkinTable
from skincal.fitting.lookup import NO_IMAGES, KernelTable, Tables, allocate_lookup, compiled, look_up
from skincal.fitting.presses import to_patch
from skincal.fitting.problem import FitProblem


@compiled
def _look_up(
    tables: Any, kind: Any, row: Any, macro: Any, uv: Any, log_ratio: Any, room: Any, near: Any, out: Any
) -> None:
    for i in range(len(uv)):
        look_up(tables, kind[i], row[i], macro[i], uv[i, 0], uv[i, 1], log_ratio[i], room, near, out[i])


def looked_up(
    tables: Tables,
    kind: np.ndarray,
    row: np.ndarray,
    macro: np.ndarray,
    uv: np.ndarray,
    log_ratio: np.ndarray,
) -> np.ndarray:
    out = np.zeros((len(uv), 7, tables.images.plane.shape[1] + len(tables.kernels.centres_m)))
    room, near = allocate_lookup(tables), np.empty(out.shape[2], dtype=np.int64)
    _look_up(tables, kind, row, macro, uv, log_ratio, room, near, out)
    return out


@compiled
def look_up_level(
    planes: Any, size_of: Any, centres: Any, lattice: Any, u: float, v: float, press: int, near: Any, out: Any
) -> None:
    lookup.look_up_level(planes, size_of, centres, lattice, u, v, press, near, out)


def shares(
    images: KernelTable,
    uv: np.ndarray,
    alpha: np.ndarray,
    log_ratio: np.ndarray,
    kind: np.ndarray,
    row: Any = None,
) -> SimpleNamespace:
    """Load shares (n, J) and their slopes by u, v, turn and log(F/E)."""
    macro = np.zeros((len(uv), 5))
    macro[:, 2] = alpha
    rows = np.zeros(len(uv), dtype=np.intp) if row is None else row
    got = looked_up(Tables(images, NO_IMAGES), kind, rows, macro, uv, np.array(log_ratio, dtype=np.float64))
    return SimpleNamespace(
        value=got[:, 0], by_u=got[:, 1], by_v=got[:, 2], by_alpha=got[:, 3], by_log_ratio=got[:, 4]
    )


def see(
    images: Tables | SkinTable,
    problem: FitProblem,
    macro: np.ndarray,
    press: np.ndarray,
    nuisance: np.ndarray,
) -> SimpleNamespace:
    """Load shares (n, J) of presses; slopes by contact and centre (n, J, 2), turn and log(F/E)."""
    alpha = macro[:, 2]
    across = problem.across_m[press] + nuisance[:, 0] - macro[:, 0]
    along = problem.along_m[press] + nuisance[:, 1] - macro[:, 1]
    log_ratio = np.log(problem.force_n[press]) + nuisance[:, 2] - macro[:, 3]
    uv = to_patch(across, along, alpha)
    tables = images if isinstance(images, Tables) else images.tables()
    got = looked_up(tables, problem.indenter[press], problem.rows[press], np.array(macro), uv, log_ratio)
    value, by_u, by_v, by_alpha, by_ratio, east, north = got.transpose(1, 0, 2)
    cos, sin = np.cos(alpha)[:, None], np.sin(alpha)[:, None]
    by_contact = np.stack([cos * by_u - sin * by_v, sin * by_u + cos * by_v], axis=-1)
    return SimpleNamespace(
        value=value,
        by_contact=by_contact,
        by_centre=np.stack([east, north], axis=-1) - by_contact,
        by_alpha=by_alpha + by_u * uv[:, 1:] - by_v * uv[:, :1],
        by_log_ratio=by_ratio,
    )
