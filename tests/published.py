"""The published skin (IROS 2024): its sensor, its fingertip and its rig, as most tests have them."""

from __future__ import annotations

from skincal.dataset import DatasetMeta, IndenterSpec, MountSpec, PositionSpec, SensorSpec, SurfaceSpec
from skincal.model import Cylinder, TaxelLayout

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
