"""Pellets that are held between two fingertips and let go one at a time.

After the authors' later work (ICRA 2026): two or three pellets of 6 mm. Ranges and settings of the training are
published; the target numbers over time, the reward and the mass are assumed here.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any, Final

import numpy as np

from skincal.envs.bodies import Body
from skincal.envs.drawing import EFFECTS_PREFIX, Values, array, number
from skincal.envs.roll import RollEnv
from skincal.envs.tactile import SkinContact
from skincal.envs.world import View
from skincal.errors import input_error
from skincal.model import Contacts
from skincal.model.arrays import FloatArray
from skincal.tasks import Task

MASS_KG: Final = 0.9e-3
"""A ball of steel of 6 mm; assumed [kg]."""
APART: Final = 1.1
"""Distance of neighbours, in diameters."""
GONE_M: Final = 0.02
"""A pellet so far from where it was taken is gone [m]."""
LEAST: Final = 2
TRIES: Final = 20
"""Most attempts of the grasp to take the least number."""


class PelletSeparateEnv(RollEnv):
    """``skincal/PelletSeparate-v0``: see :class:`RollEnv`.

    The policy observes the target number of pellets: at first all of them, then one less at even intervals, in the end
    one. Each step in which it holds that many is rewarded; when it holds fewer, the episode ends.
    """

    task = Task.pellets
    target_size = 1
    target_limit = 10.0
    objects = 3
    own_size = 13

    def __init__(self, *arguments: Any, **named: Any) -> None:
        super().__init__(*arguments, **named)
        if any(path.startswith(EFFECTS_PREFIX) for path in self.ranges):
            fix = "Effects follow one contact; export ranges of a calibration without them."
            raise input_error("ranges", "no effects, for pellets", "skin.effects", fix)

    def _begin(self) -> None:
        """Grasp the pellets; repeat the grasp until the fingers hold two of them, as the task is to release one."""
        for _ in range(TRIES):
            super()._begin()
            self._look()
            if self._held >= LEAST:
                break
        self._set_targets(self._target_counts(self._held, len(self._targets)))

    def _body(self, values: Values) -> Body:
        drawn = int(self.np_random.integers(2, self.objects + 1))
        given = self._episode.pellets
        self._count = drawn if given is None else round(given)
        return replace(super()._body(values), mass_kg=MASS_KG)

    def _initial_positions_m(self, values: Values) -> list[FloatArray]:
        """Return positions side by side along the finger, or in a triangle about the middle."""
        width = APART * number(values, "object.marble.radius_m")
        middle = array(values, "object.marble.position_m")
        about = width if self._count == 2 else 2 * width / np.sqrt(3)
        angles = np.pi / 2 + 2 * np.pi * np.arange(self._count) / self._count
        return [middle / 4 + about * np.array([np.cos(a), np.sin(a), 0.0]) for a in angles]

    def _plan_targets(self, steps: int) -> FloatArray:
        return self._target_counts(self._count, steps)

    def _target_counts(self, count: int, steps: int) -> FloatArray:
        """Return target numbers of pellets (steps, 1): all at first, one less after each equal part of the episode."""
        passed = np.arange(steps) * count // self._steps
        return np.maximum(count - passed, 1)[:, None].astype(np.float64)

    def _look(self) -> None:
        self._views = [self.world.look(k) for k in range(self._count)]
        if self._step == 0:
            self._begun_m = [view.body.origin_m for view in self._views]
            self._there = [None not in (view.skin, view.thumb) for view in self._views]
        self._there = [
            there and bool(np.linalg.norm(view.body.origin_m - begun) < GONE_M)
            for there, view, begun in zip(self._there, self._views, self._begun_m, strict=True)
        ]
        first = [*self._present_views(), self._views[0]][0]
        skin, thumb = self.world.running.touches()
        self._view = replace(first, skin=skin, thumb=thumb)

    def _present_views(self) -> list[View]:
        return [view for view, there in zip(self._views, self._there, strict=True) if there]

    @property
    def _held(self) -> int:
        return sum(self._there)

    def _dropped(self) -> bool:
        return not self._view.sound or self._held < self._targets[self._step, 0]

    def _target_m(self) -> FloatArray:
        return self._view.position_m

    def _error_m(self) -> float:
        """Return the difference of held and target numbers of pellets."""
        return abs(self._held - float(self._targets[self._step, 0]))

    def skin_contact(self) -> SkinContact | None:
        """See :meth:`RollEnv.skin_contact`: one contact for each pellet that touches the skin."""
        found = [
            one for view in self._present_views() if (one := view.skin_contact(self.world.body)) is not None
        ]
        if not found:
            return None
        parts = [one.contacts for one in found]
        contacts = Contacts(
            np.concatenate([one.points_m for one in parts]),
            np.concatenate([one.normals for one in parts]),
            np.concatenate([one.force_n for one in parts]),
        )
        return SkinContact(contacts, sum(one.shear_u_n for one in found), sum(one.shear_v_n for one in found))

    def _own(self) -> FloatArray:
        """Return the number held; then for each pellet: held, position on the sensor [m], force on the skin [N]."""
        rows = np.zeros((self.objects, 4))
        for row, view, there in zip(rows, self._views, self._there, strict=False):
            row[:] = there, *view.position_m, view.skin.force_n if view.skin else 0.0
        return np.concatenate([[self._held], rows.ravel()])

    def _info(self, terms: dict[str, float]) -> dict[str, Any]:
        target = int(self._targets[self._step, 0])
        found = super()._info(terms) | {"pellets_held": self._held, "pellets_target": target}
        return found | {"success": found["success"] and self._held == target}
