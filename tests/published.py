"""The published skin (IROS 2024): its sensor, its fingertip and its rig, as most tests have them; presses on it."""

from __future__ import annotations

import numpy as np

from skincal.dataset import DatasetMeta, IndenterSpec, MountSpec, PositionSpec, SensorSpec, SurfaceSpec
from skincal.model import Contacts, Cylinder, Surface, TaxelLayout

RADIUS_M = 0.0115
FINGER = Cylinder(RADIUS_M)
LAYOUT = TaxelLayout.grid(4, 4, taxel_size_m=0.0025, pitch_m=0.004)
META = DatasetMeta(
    sensor=SensorSpec(4, 4, (0.0025, 0.0025), (0.004, 0.004), value_min=0, value_max=255, integer=True),
    surface=SurfaceSpec("cylinder", RADIUS_M),
    indenter=IndenterSpec("sphere", 0.006),
    mount=MountSpec(0.0235, 0.0, (0.0195, 0.0275), (-20.0, 20.0), beta_deg=0.0, beta_range_deg=(-12.0, 12.0)),
    position=PositionSpec(0.001, 0.002),
)


def presses_on(surface: Surface, across_m: object, along_m: object, force_n: object) -> Contacts:
    """Presses at arc lengths from the point beta = 0, y = 23.5 mm."""
    across, along, force = np.broadcast_arrays(*np.atleast_1d(across_m, along_m, force_n))
    start = np.tile([0.0, 0.0235, RADIUS_M], (len(across), 1))
    points = surface.offset(start, across, along)
    return Contacts(points, surface.normal_at(points), np.asarray(force, dtype=float))
