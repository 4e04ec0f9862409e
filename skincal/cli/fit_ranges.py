"""The search ranges of ``skincal fit`` from its options."""

from __future__ import annotations

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from skincal.dataset import Dataset, SurfaceSpec
    from skincal.fitting.fit_options import SearchBox

Pair = tuple[float, float]

LARGEST_E_MPA_PER_M = 1e6
"""Far stiffer than any skin: 0.1 mm of a hard plastic has 3e7 Pa / 1e-4 m = 3e5 MPa/m."""

NARROW = 0.01
"""A range below this part of the mount's, which overlaps it only when read in metres, is taken to be in metres."""


def searched(
    data: Dataset,
    y_mm: Pair | None,
    x_mm: Pair | None,
    beta_deg: Pair | None,
    alpha_deg: Pair | None,
    elasticity_mpa_per_m: Pair | None,
) -> SearchBox:
    """Return the search box: the given ranges, else those of the dataset's ``[mount]``.

    Raises:
        InputError: a range that the surface does not have, in another unit, or from high to low.
    """
    from skincal.calibrate import search_box

    mount = data.meta.mount
    x_m = _metres("--x-range-mm", x_mm, mount.x_range_m)
    return search_box(
        data,
        y_m=_metres("--y-range-mm", y_mm, mount.y_range_m),
        across=_across(data.meta.surface, x_m, beta_deg),
        alpha_deg=alpha_deg,
        elasticity_pa_per_m=_elasticity(elasticity_mpa_per_m),
    )


def _metres(option: str, range_mm: Pair | None, mount_m: Pair | None) -> Pair | None:
    """Return a range given in millimetres, in metres."""
    from skincal.errors import InputError, Problem

    if range_mm is None:
        return None
    low, high = range_mm
    if mount_m is not None and _in_metres(range_mm, mount_m):
        what = f"low and high [mm] ([mount] has {1e3 * mount_m[0]:g} to {1e3 * mount_m[1]:g})"
        fix = "Are they in metres? Multiply by 1000."
        raise InputError([Problem(option, what, f"{low:g} and {high:g}", fix)])
    return low * 1e-3, high * 1e-3


def _in_metres(given: Pair, mount_m: Pair) -> bool:
    """Return whether a range that should be in millimetres makes sense only in metres."""
    overlaps = given[0] <= mount_m[1] and given[1] >= mount_m[0]
    return overlaps and abs(given[1] - given[0]) < NARROW * 1e3 * (mount_m[1] - mount_m[0])


def _across(surface: SurfaceSpec, x_m: Pair | None, beta_deg: Pair | None) -> Pair | None:
    """Return the range across the finger: of x [m] on a plane, else of beta [°]."""
    from skincal.errors import InputError, Problem

    own, other = (x_m, beta_deg) if surface.is_plane else (beta_deg, x_m)
    if other is not None:
        right, wrong = ("--x-range-mm", "--beta-range-deg")[:: 1 if surface.is_plane else -1]
        raise InputError(
            [Problem(wrong, f"no such range on a {surface.kind}", "one", f"Give {right} instead.")]
        )
    return own


def _elasticity(range_mpa_per_m: Pair | None) -> Pair | None:
    """Return the range of E [Pa/m]."""
    from skincal.errors import InputError, Problem

    if range_mpa_per_m is None:
        return None
    low, high = range_mpa_per_m
    if max(low, high) > LARGEST_E_MPA_PER_M:
        what = f"low and high [MPa/m], at most {LARGEST_E_MPA_PER_M:g}"
        fix = "Are they in Pa/m? Divide by 1e6."
        raise InputError([Problem("--e-range-mpa-per-m", what, f"{low:g} and {high:g}", fix)])
    return low * 1e6, high * 1e6
