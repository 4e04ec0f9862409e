"""Choose a way to fit a dataset, and convert the dataset to a fit problem."""

from __future__ import annotations

from dataclasses import dataclass, replace
from itertools import count, takewhile
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from skincal.calibration import MARGIN_M
from skincal.calibration.parts import ELASTICITY_PA_PER_M
from skincal.dataset import Dataset, Presses, idle_means
from skincal.dataset.dataset import refusal
from skincal.dataset.rest import rest_drift
from skincal.dataset.uniform_pressure import UNIFORM, uniform_pressure
from skincal.errors import InputError, Problem, input_error
from skincal.fitting.fit_options import FitOptions, SearchBox
from skincal.fitting.general_local import LocalPlaces
from skincal.fitting.general_skin import TABLE_MARGIN_M, ContactMap
from skincal.fitting.kernel import contact_reach
from skincal.fitting.observe import Readout
from skincal.fitting.problem import FitProblem, PressTable, Rig, build_problem
from skincal.model import Surface
from skincal.model.arrays import FloatArray
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


def fit_problem(dataset: Dataset, options: FitOptions, way: Way | None = None) -> FitProblem:
    """Choose the presses to fit, and clean their values; a problem without presses says why in its status.

    Raises:
        WorkError: the session cannot determine the parameters, whatever its presses are.
    """
    way = way or choose_way(dataset)
    rig, kinds = _build_rig(dataset)
    presses = dataset.presses
    beta = dataset.meta.mount.beta_deg
    across, along = unroll(rig.arc_radius_m, presses.position_m, rad(beta or 0.0))
    shifts = rest_drift(dataset)
    table = PressTable(
        presses.press.astype(np.intp), across, along, presses.force_n,
        presses.counts if shifts is None else presses.counts - shifts, kinds, idle_means(dataset),
        joint_angles(presses),
    )  # fmt: skip
    problem = build_problem(rig, table, active_counts=options.active_counts, min_active=options.min_active)
    if way.method == "fast":
        return problem
    contacts = ContactMap.of(
        rig.surface, presses.position_m, problem.rows, rig.slack_m + TABLE_MARGIN_M, presses.normals
    )
    mount, radius = dataset.meta.mount, rig.arc_radius_m
    nominal = (mount.x_m or 0.0) if radius is None else radius * rad(beta or 0.0)
    local = LocalPlaces.of(problem, presses.position_m, np.array([nominal, mount.y_m]))
    contacts = replace(contacts, local=local, skin_on_grid=way.method == "nlopt")
    return replace(problem, contacts=contacts)


def joint_angles(presses: Presses) -> FloatArray | None:
    """Return joint angles (K, Q) in the holds [rad]; None if the session has none."""
    names = takewhile(lambda name: presses.column(name) is not None, (f"q_{i}" for i in count()))
    angles = [np.asarray(presses.column(name), dtype=np.float64) for name in names]
    return np.stack(angles, axis=1) if angles else None


_EXACT_M = 1e-6
"""Smallest standard deviation of a measured position [m]."""


def _build_rig(dataset: Dataset) -> tuple[Rig, NDArray[np.intp]]:
    """Return the rig of a dataset, and the number of the indenter of each press (K,)."""
    if uniform_pressure(dataset):
        reason = f"{UNIFORM}; `skincal fit` does it, in Python skincal.calibrate.calibrate_uniform"
        raise refusal(dataset, reason)
    meta, layout, surface = dataset.meta, dataset.layout(), dataset.surface()
    indenters, kinds = dataset.indenters()
    sensor = meta.sensor
    readout = Readout(sensor.value_min, sensor.value_max, sensor.integer, sensor.baseline == "subtracted")
    position, radius = meta.position, _arc_radius(dataset, surface)
    # A position that is known exactly still gets a tiny sigma. If the slack is not bounded, a press still
    # lies on the patch.
    sigma = max(position.sigma_m, _EXACT_M)
    low, high = layout.bounds_m
    slack = position.slack_m if np.isfinite(position.slack_m) else float((high - low).max()) / 2
    return Rig(layout, surface, indenters, readout, sigma, slack, radius, meta.force_scale_sigma), kinds


def _arc_radius(dataset: Dataset, surface: Surface) -> float | None:
    """Return R of arc = R beta at the nominal pose [m]; None on a plane."""
    try:
        return surface.arc_radius_at(dataset.nominal_pose())
    except ValueError as error:
        reason = (
            f"the nominal pose in [mount] does not lie on the surface: {error}. Correct [mount], or the mesh"
        )
        raise refusal(dataset, reason) from error


def unroll(
    arc_radius_m: float | None, points_m: FloatArray, about_rad: float = 0.0
) -> tuple[FloatArray, FloatArray]:
    """Return the arc round the finger R beta (x where there is no R) and y of points (K, 3) [m].

    On a mesh these are labels of places: R is the mesh's at the sensor's nominal pose, and the same everywhere. Angles
    are within half a turn of ``about_rad``, where the sensor is, so that none of its presses lies across a cut.
    """
    if arc_radius_m is None:
        return points_m[:, 0].copy(), points_m[:, 1].copy()
    beta = np.arctan2(points_m[:, 0], points_m[:, 2]) - about_rad
    beta = about_rad + (beta + np.pi) % (2 * np.pi) - np.pi
    return arc_radius_m * beta, points_m[:, 1].copy()


def search_box(
    dataset: Dataset,
    *,
    y_m: tuple[float, float] | None = None,
    across: tuple[float, float] | None = None,
    alpha_deg: tuple[float, float] | None = None,
    elasticity_pa_per_m: tuple[float, float] | None = None,
) -> SearchBox:
    """Return the ranges to search: those given, else those of the dataset's ``[mount]``.

    Args:
        dataset: a session.
        y_m: low and high of y [m].
        across: low and high of beta [°]; on a plane of x [m].
        alpha_deg: low and high of alpha [°].
        elasticity_pa_per_m: low and high of E [Pa/m].

    Raises:
        InputError: a range has its low end above its high end.
    """
    mount, surface = dataset.meta.mount, dataset.surface()
    given = {"y": y_m, "beta or x": across, "alpha": alpha_deg, "E": elasticity_pa_per_m}
    wrong = [
        Problem(f"range of {name}", "low below high", f"{r[0]:g} and {r[1]:g}")
        for name, r in given.items()
        if r is not None and not (np.isfinite(r).all() and r[0] < r[1])
    ]
    low, high = ELASTICITY_PA_PER_M
    if (
        elasticity_pa_per_m is not None
        and not low <= min(elasticity_pa_per_m) <= max(elasticity_pa_per_m) <= high
    ):
        got = " and ".join(f"{end:g}" for end in elasticity_pa_per_m)
        wrong.append(Problem("range of E", f"positive values, {low:g} to {high:g} Pa/m", got))
    if not uniform_pressure(dataset):
        own = [
            ("y", y_m, mount.y_range_m),
            ("alpha", alpha_deg, mount.alpha_range_deg),
            ("beta", across, mount.beta_range_deg),
            ("x", across, mount.x_range_m),
        ]
        wrong += [
            Problem(
                f"[mount] {name}_range",
                "low below high, for a fit needs room to search",
                f"{bounds[0]:g} and {bounds[1]:g}",
                "Widen it a little.",
            )
            for name, asked, bounds in own
            if asked is None and bounds is not None and not bounds[0] < bounds[1]
        ]
    if wrong:
        raise InputError(wrong)
    radius = _arc_radius(dataset, surface)
    if radius is not None:
        low, high = across or mount.beta_range_deg or (0.0, 0.0)
        arc = (rad(low) * radius, rad(high) * radius)
    else:
        arc = across or mount.x_range_m or (0.0, 0.0)
    alpha = alpha_deg or mount.alpha_range_deg
    box = SearchBox(arc, y_m or mount.y_range_m, (rad(alpha[0]), rad(alpha[1])))
    if elasticity_pa_per_m is None:
        return box
    return SearchBox(box.across_m, box.y_m, box.alpha_rad, elasticity_pa_per_m)
