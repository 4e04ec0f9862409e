"""A marble that is rolled along a trajectory on the skin."""

from __future__ import annotations

from skincal.envs.roll import RollEnv
from skincal.envs.task_options import EpisodeOptions
from skincal.envs.trajectories import ROUND_S, TO_SIDE_S, planned, wander
from skincal.model.arrays import FloatArray


class MarbleRollEnv(RollEnv):
    """``skincal/MarbleRoll-v0``: see :class:`RollEnv`. The target is a place on the sensor, in patch coordinates."""

    object_name = "marble"
    target_size = 2

    def _duration_s(self, asked: EpisodeOptions) -> float:
        if asked.duration_s is None and isinstance(asked.trajectory, str) and asked.trajectory == "circle":
            return TO_SIDE_S + ROUND_S
        return super()._duration_s(asked)

    def _plan(self, asked: EpisodeOptions, steps: int) -> FloatArray:
        # Drawn in any case, so that what is drawn later does not depend on the trajectory.
        drawn = wander(self.np_random, steps, self.options.box_half_m)
        is_random = isinstance(asked.trajectory, str) and asked.trajectory == "random"
        return drawn if is_random else planned(asked.trajectory, steps)
