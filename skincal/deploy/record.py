"""A run as a session: a dataset that ``dataset show`` plots and the driver ``replay`` plays back."""

from __future__ import annotations

from dataclasses import dataclass, replace
from datetime import UTC, datetime
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from skincal.dataset import HOLD, IDLE, Dataset, Frames, IndenterSpec, Presses, write_dataset
from skincal.dataset.dataset import layout_of, pose_of, surface_of
from skincal.hand.driver import HandState
from skincal.model.arrays import FloatArray
from skincal.robot.description import JOINT_FIELDS, joint_columns

if TYPE_CHECKING:
    from skincal.deploy.handover import Motion, PinchForces
    from skincal.robot import HandDescription


@dataclass(frozen=True, eq=False, kw_only=True)
class Record:
    """States of a run, and positions of the object.

    Attributes:
        states: the T states of the hand.
        phases: (T,) phase of each state.
        places_m: (T, 2) true position of the object on the sensor [m]; NaN if unknown.
        acting: index of the state at which the policy began.
        rest_counts: (J,) rest levels of the taxels [counts].
        grip_n: (T,) normal force on the object from joint torques, mean of both fingers, zero or more [N].
    """

    states: tuple[HandState, ...]
    phases: tuple[str, ...]
    places_m: FloatArray
    acting: int
    rest_counts: FloatArray
    grip_n: FloatArray

    @classmethod
    def of(cls, motion: Motion, acting: int, forces: PinchForces) -> Record:
        """Return the record of a motion so far."""
        # An interrupt may have come while the last state was stored; the list of samples is extended last.
        states, count = tuple(motion.samples), len(motion.samples)
        normal = np.array([np.mean(forces.normal_n(state)) for state in states])
        return cls(
            states=states, phases=tuple(motion.phases[:count]), places_m=np.array(motion.places_m[:count]),
            acting=acting, rest_counts=motion.rest_counts, grip_n=np.maximum(normal, 0.0),
        )  # fmt: skip

    @property
    def is_acting(self) -> NDArray[np.bool_]:
        """(T,) True while the policy acts."""
        return np.array([phase == "acting" for phase in self.phases])

    @property
    def images_counts(self) -> FloatArray:
        """(T, J) images above rest [counts]; a taxel without a reading is 0."""
        return np.nan_to_num(np.array([state.taxels for state in self.states]) - self.rest_counts)

    @property
    def centroids_m(self) -> FloatArray:
        """(T, J) images above rest with negative values set to 0, as weights of centroids [counts]."""
        return np.maximum(self.images_counts, 0.0)


def write_record(
    record: Record, description: HandDescription, path: Path, *, radius_m: float, source: str
) -> None:
    """Write a run as a dataset with one press, which lasts while the policy acts.

    Contact points are the centroids of the images at the sensor's nominal pose, and are listed as assumed. Forces come
    from the joint torques.

    Args:
        record: record of the run.
        description: the hand.
        path: folder to create.
        radius_m: radius of the object [m].
        source: text for ``source`` in ``dataset.toml``.
    """
    meta = replace(
        description.meta,
        indenter=IndenterSpec("sphere", radius_m),
        source=source,
        created=datetime.now(UTC).replace(microsecond=0),
        assumed=("position",),
        sensor=replace(description.meta.sensor, baseline="raw"),
    )
    write_dataset(Dataset(meta, *_tables(record, description)), path)


def _tables(record: Record, description: HandDescription) -> tuple[Presses, Frames]:
    states, acting = record.states, record.is_acting
    counts = np.array([state.taxels for state in states])
    points = _points(record, description)
    columns = joint_columns(states, tuple(JOINT_FIELDS))
    columns |= {"object_u_m": record.places_m[:, 0], "object_v_m": record.places_m[:, 1]}
    frames = Frames(
        np.where(acting, 0, -1), np.where(acting, HOLD, IDLE).astype(np.int8),
        np.array([state.time_s for state in states]), np.where(acting, record.grip_n, 0.0),
        np.where(acting[:, None], points, np.nan), counts, columns=columns,
    )  # fmt: skip
    presses = Presses(
        np.array([0]),
        points[acting].mean(axis=0, keepdims=True),
        record.grip_n[acting].mean(keepdims=True),
        counts[acting].mean(axis=0, keepdims=True),
    )
    return presses, frames


def _points(record: Record, description: HandDescription) -> FloatArray:
    """Return contact points (T, 3) [m]: centroids of the images at the sensor's nominal pose."""
    meta = description.meta
    layout, surface = layout_of(meta.sensor, None), surface_of(meta.surface, {})
    images = record.centroids_m
    total = images.sum(axis=1, keepdims=True)
    uv = np.where(total > 0, images @ layout.centres_m / np.maximum(total, 1e-12), 0.0)
    return surface.wrap(pose_of(meta.mount), uv)[0]
