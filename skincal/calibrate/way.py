"""Choose between the fast way to fit a dataset and the general one, which any geometry allows."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np

from skincal.calibration import MARGIN_M
from skincal.dataset import Dataset
from skincal.errors import input_error
from skincal.fitting.fit_options import SearchBox
from skincal.fitting.kernel import contact_reach
from skincal.model import Surface
from skincal.units import deg, rad

Method = Literal["auto", "fast", "general", "nlopt"]
METHODS: tuple[Method, ...] = ("auto", "fast", "general", "nlopt")
"""Values of ``--method``."""

TILT_RAD = rad(2.0)
"""Rms difference of measured normals from the surface's own [rad] from which the general way is used."""


@dataclass(frozen=True)
class Way:
    """A way to fit a dataset.

    Attributes:
        method: "fast", by kernel tables and Gauss-Newton on a surface that looks the same everywhere;
            "general", by image tables of the skin model, press by press; or "nlopt", by those after a grid of
            the skin model itself.
        why: the reason, if it is not the fast one.
    """

    method: Literal["fast", "general", "nlopt"]
    why: str = ""


def choose_way(dataset: Dataset, method: Method = "auto") -> Way:
    """Return the way to fit a dataset: the fast one if possible, unless ``method`` says otherwise.

    Raises:
        InputError: the fast way was asked for and is impossible, or there is no such method.
    """
    if method not in METHODS:
        raise input_error("--method", "one of " + ", ".join(METHODS), method)
    if method in ("general", "nlopt"):
        return Way(method, "it was asked for")
    why = _find_obstacle(dataset)
    if not why:
        return Way("fast")
    if method == "fast":
        raise input_error(
            "--method", "auto or general for these data", "fast", f"the fast way cannot be used: {why}"
        )
    return Way("general", why)


def _find_obstacle(dataset: Dataset) -> str:
    """Return why the fast way is impossible; '' if it is possible."""
    if not dataset.surface().is_uniform:
        return f"the surface is a {dataset.meta.surface.kind}, which does not look the same everywhere"
    reach = _contact_reach_m(dataset)
    if reach > MARGIN_M:
        return (
            f"a contact reaches {1e3 * reach:.0f} mm round its centre, and the skin that carries it ends "
            f"{1e3 * MARGIN_M:.0f} mm beyond the taxels"
        )
    normals = dataset.presses.normals
    if normals is None or not np.isfinite(normals).all(axis=1).any():
        return ""
    tilt = _normal_tilt(dataset.surface(), dataset.presses.position_m, normals, dataset.meta.position.sigma_m)
    if tilt <= TILT_RAD:
        return ""
    return f"the measured contact normals are tilted against the surface by {deg(tilt):.1f}°"


def _contact_reach_m(dataset: Dataset) -> float:
    """Return the radius of the largest contact on a skin of medium elasticity [m]."""
    force = dataset.presses.force_n
    force = force[np.isfinite(force) & (force > 0)]
    radii = dataset.indenter_radii_m()
    known = np.unique(radii[np.isfinite(radii)])
    indenters = [dataset.indenter(float(r)) for r in known] if len(known) else [dataset.indenter()]
    softness = 1.0 / np.sqrt(np.prod(SearchBox.elasticity_pa_per_m))
    ratio = float(force.max(initial=1e-3) * softness)
    return max(contact_reach(dataset.surface(), one, ratio) for one in indenters)


def _normal_tilt(surface: Surface, points_m: np.ndarray, normals: np.ndarray, sigma_m: float) -> float:
    """Return the rms tilt [rad] of measured normals (K, 3) against the surface, beyond the effect of position errors.

    On a curved surface, a position error of d turns the surface's normal by d / R, so a normal that is off by
    this much may still be the surface's own.
    """
    given = np.isfinite(normals).all(axis=1) & np.isfinite(points_m).all(axis=1)
    own = surface.normal_at(points_m[given])
    away = normals[given] - np.einsum("ki,ki->k", normals[given], own)[:, None] * own
    along = away[:, 1]
    across = np.linalg.norm(away - along[:, None] * [0.0, 1.0, 0.0], axis=1)
    bend = 0.0 if surface.arc_radius_m is None else sigma_m / surface.arc_radius_m
    squares = float((along**2).mean()) + max(0.0, float((across**2).mean()) - bend**2)
    return float(np.sqrt(squares))
