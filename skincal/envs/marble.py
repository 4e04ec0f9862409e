"""A marble that is rolled along a trajectory on the skin."""

from __future__ import annotations

from skincal.envs.roll import RollEnv
from skincal.envs.trajectories import ROUND_S, TO_SIDE_S, planned, wander
from skincal.model.arrays import FloatArray
from skincal.tasks import Task


class MarbleRollEnv(RollEnv):
    """``skincal/MarbleRoll-v0``: see :class:`RollEnv`. The target is a place on the sensor, in patch coordinates."""

    task = Task.marble
    target_size = 2

    def _follows(self, name: str) -> bool:
        trajectory = self._episode.trajectory
        return isinstance(trajectory, str) and trajectory == name

    def _duration_s(self) -> float:
        is_circle = self._episode.duration_s is None and self._follows("circle")
        return TO_SIDE_S + ROUND_S if is_circle else super()._duration_s()

    def _plan_targets(self, steps: int) -> FloatArray:
        # Drawn in any case, so that what is drawn later does not depend on the trajectory.
        drawn = wander(self.np_random, steps, self.options.box_half_m)
        return drawn if self._follows("random") else planned(self._episode.trajectory, steps)
