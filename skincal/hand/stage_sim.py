"""A simulated stage: a sphere on a load cell above a flat pad; an example of a driver, for trials without a rig."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import numpy as np

from skincal.dataset import DatasetMeta, IndenterSpec, MountSpec, PositionSpec, SensorSpec, SurfaceSpec
from skincal.hand.driver import FloatArray, StageDescription, StageDriver, StageState
from skincal.hand.errors import HandError
from skincal.hand.sim import write_truth
from skincal.model import (
    Contacts,
    Converter,
    Patch,
    Plane,
    SensorPose,
    Skin,
    SkinParameters,
    Sphere,
    TaxelLayout,
)
from skincal.units import deg, rad

TRUTH_FORMAT = "skincal-stage-truth/1"
PERIOD_S = 0.01
LAG_S = 0.015
"""Time constant with which the tip follows its commands [s]."""

NOISE_COUNTS, NOISE_N, NOISE_M = 0.8, 0.004, 3e-6
RADIUS_M = 0.004

META = DatasetMeta(
    sensor=SensorSpec(4, 4, (0.0025, 0.0025), (0.004, 0.004), 0, 255, True),
    surface=SurfaceSpec("plane"),
    indenter=IndenterSpec("sphere", RADIUS_M),
    mount=MountSpec(0.0, 0.0, (-0.003, 0.003), (-10.0, 10.0), x_m=0.0, x_range_m=(-0.003, 0.003)),
    position=PositionSpec(0.1e-3, 0.4e-3),
)


class StageSim(StageDriver):
    """The simulated stage. The same seed and commands give the same states.

    Args:
        seed: seed of the pad's position on the bench, its elasticity and scale, and all noise.
        truth_path: file for the drawn values (JSON), written when the stage is connected.
    """

    name = "stage-sim"
    real_time = False

    def __init__(
        self,
        *,
        seed: Annotated[int, "seed of the hidden truth and of all noise"] = 0,
        truth_path: Annotated[Path | None, "file for the truth (JSON)"] = None,
    ) -> None:
        rng = np.random.default_rng([seed, 0])
        y_m, alpha_deg, x_m = (float(rng.uniform(-most, most)) for most in (1e-3, 5.0, 1e-3))
        self.pose = SensorPose(y_m, rad(alpha_deg), x_m=x_m)
        self.elasticity_pa_per_m = float(5e8 * np.exp(0.5 * float(rng.uniform(-1.0, 1.0))))
        self.scale_per_n = float(rng.uniform(50.0, 80.0))
        self._seed, self._truth_path = seed, truth_path
        self._skin: Skin | None = None
        self._halted = True

    @property
    def description(self) -> StageDescription:
        """The rig."""
        lower, upper = np.array([-0.012, -0.012, -0.003]), np.array([0.012, 0.012, 0.02])
        return StageDescription("simulated stage", META, lower, upper, 0.05, 12.0)

    @property
    def period_s(self) -> float:
        """Time between two states [s]."""
        return PERIOD_S

    def connect(self) -> None:
        """Connect: place the tip above the pad, at time 0."""
        layout = TaxelLayout.grid(4, 4, taxel_size_m=0.0025, pitch_m=0.004)
        parameters = SkinParameters(self.elasticity_pa_per_m, self.scale_per_n)
        self._skin = Skin(Patch.build(Plane(), layout, self.pose), parameters, Converter.none())
        # Force by depth, from the skin itself: in its middle, up to the depth of a press.
        forces = np.geomspace(1e-3, 40.0, 60)
        middle = np.tile([self.pose.x_m, self.pose.y_m, 0.0], (len(forces), 1))
        up = np.tile([0.0, 0.0, 1.0], (len(forces), 1))
        depth = self._skin.respond(Sphere(RADIUS_M), Contacts(middle, up, forces)).penetration_m
        self._depths, self._forces = np.concatenate([[0.0], depth]), np.concatenate([[0.0], forces])
        self._rng = np.random.default_rng([self._seed, 1])
        self._time_s, self._tip = 0.0, np.array([0.0, 0.0, 0.01])
        self._wanted, self._halted = self._tip.copy(), False
        if self._truth_path is not None:
            write_truth(self._truth_path, TRUTH_FORMAT, self.truth())

    def truth(self) -> dict[str, float]:
        """Return what is hidden from the fit."""
        return {
            "x_m": self.pose.x_m,
            "y_m": self.pose.y_m,
            "alpha_deg": deg(self.pose.alpha_rad),
            "elasticity_pa_per_m": self.elasticity_pa_per_m,
            "scale_per_n": self.scale_per_n,
        }

    def observe(self) -> StageState:
        """Advance the stage by one period and return its state."""
        if self._skin is None:
            raise HandError("stage-sim: connect first", "order")
        if not self._halted:
            self._tip = self._tip + (self._wanted - self._tip) * (1 - np.exp(-PERIOD_S / LAG_S))
        self._time_s += PERIOD_S
        force = float(np.interp(max(-float(self._tip[2]), 0.0), self._depths, self._forces))
        values = np.zeros(16)
        if force > 0:
            contact = Contacts(
                self._tip[None] * np.array([1.0, 1.0, 0.0]), np.array([[0.0, 0.0, 1.0]]), np.array([force])
            )
            values = np.nan_to_num(self._skin.values(Sphere(RADIUS_M), contact)[0])
        noise = self._rng.standard_normal(20)
        taxels = np.clip(np.rint(values + NOISE_COUNTS * noise[:16]), 0, 255)
        return StageState(
            self._time_s, self._tip + NOISE_M * noise[16:19], force + NOISE_N * noise[19], taxels
        )

    def act(self, position_m: FloatArray) -> None:
        """Set the target position."""
        if not self._halted:
            self._wanted = np.array(position_m, dtype=np.float64)

    def stop(self) -> None:
        """Hold the present position."""
        self._halted = True

    def close(self) -> None:
        """End the session."""
        self._skin = None
