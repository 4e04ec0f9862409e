"""A recorded session as a hand: programs can be tried on it, or it can be watched, without the hand."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import numpy as np

from skincal.dataset import Frames, read_dataset
from skincal.errors import input_error
from skincal.hand.driver import HandCommand, HandDriver, HandState
from skincal.hand.errors import HandError
from skincal.model.arrays import FloatArray
from skincal.robot import hand_named
from skincal.robot.description import HandDescription


class ReplayDriver(HandDriver):
    """Driver that plays the frames of a dataset as states, one per call.

    The frames need ``q_0 ..`` and ``tau_0 ..``, one of each for every joint of the hand. If present,
    ``dq_0 ..`` are its velocities (else differences of the angles), ``q_desired_0 ..`` its desired angles (else the
    measured ones), ``taxel_time_s`` the time stamps of the taxels (else those of the frames), and ``temperature_c``.

    Commands have no effect; they are stored in ``commands``, each with the time of the state that it answered.

    Raises:
        InputError: the dataset cannot be read, or has no such frames.
    """

    name = "replay"
    follows_commands = False
    real_time = False

    def __init__(
        self,
        dataset: Annotated[Path, "folder of the dataset to play"],
        *,
        hand: Annotated[str, "name of the hand it was recorded with, or its hand.toml"] = "dlr_hand_2",
    ) -> None:
        self._description = hand_named(hand)
        self._place = str(dataset)
        self._states = _states(Path(dataset), self._description)
        steps = np.diff([state.time_s for state in self._states])
        self._period_s = float(np.median(steps))
        self._next = 0
        self._connected = False
        self.commands: list[tuple[float, HandCommand]] = []

    @property
    def description(self) -> HandDescription:
        """The hand that the session was recorded with."""
        return self._description

    @property
    def period_s(self) -> float:
        """Median time between two frames [s]."""
        return self._period_s

    def connect(self) -> None:
        """Start at the first frame."""
        self._next = 0
        self._connected = True

    def observe(self) -> HandState:
        """Return the next frame.

        Raises:
            HandError: the recording has ended (kind ``end``), or is not connected.
        """
        self._check_connected("observe")
        if self._next == len(self._states):
            last_s = self._states[-1].time_s
            text = f"{self._place}: the record ends at {last_s:.6g} s, after {self._next} frames; nothing comes after"
            raise HandError(text, "end")
        self._next += 1
        return self._states[self._next - 1]

    def act(self, command: HandCommand) -> None:
        """Store the command, which has no effect."""
        self._check_connected("act")
        time_s = self._states[max(self._next - 1, 0)].time_s
        self.commands.append((time_s, HandCommand(np.array(command.q_desired_rad, dtype=float))))

    def stop(self) -> None:
        """Do nothing: a recording does not move."""

    def close(self) -> None:
        """End the replay."""
        self._connected = False

    def _check_connected(self, what: str) -> None:
        if not self._connected:
            raise HandError(f"{what}() before connect()", "order")


def _states(folder: Path, description: HandDescription) -> list[HandState]:
    data = read_dataset(folder)
    if data.frames is None:
        fix = "Collect with frames, or replay another session."
        raise input_error(str(folder), "a dataset with frames, to play them", "none", fix)
    taxels, expected = data.meta.sensor.taxels, description.meta.sensor.taxels
    if taxels != expected:
        fix = "Give the hand that it was recorded with: --driver-option hand=..."
        raise input_error(str(folder), f"{expected} taxels, as the hand has", taxels, fix)
    # Repeated times are not new states.
    rows = np.flatnonzero(np.diff(data.frames.time_s, prepend=-np.inf) > 0)
    if len(rows) < 2:
        raise input_error(str(folder), "two frames or more", len(rows))
    return _from_frames(folder, data.frames.select(rows), len(description.joints))


def _from_frames(folder: Path, frames: Frames, joints: int) -> list[HandState]:
    times = frames.time_s
    q, tau = _needed(folder, frames, "q", joints), _needed(folder, frames, "tau", joints)
    dq, desired = (_joint_columns(frames, name, joints) for name in ("dq", "q_desired"))
    dq = np.gradient(q, times, axis=0) if dq is None else dq
    desired = q if desired is None else desired
    stamps = _column(frames, "taxel_time_s", times)
    temperature = _column(frames, "temperature_c", np.full(len(times), np.nan))
    rows = zip(times, q, dq, tau, desired, frames.counts, stamps, temperature, strict=True)
    return [
        HandState(
            float(t), angles, speeds, torques, targets, counts, np.full(len(counts), stamp), float(heat)
        )
        for t, angles, speeds, torques, targets, counts, stamp, heat in rows
    ]


def _column(frames: Frames, name: str, default: FloatArray) -> FloatArray:
    column = frames.column(name)
    return default if column is None else np.asarray(column, dtype=np.float64)


def _joint_columns(frames: Frames, name: str, joints: int) -> FloatArray | None:
    columns = [frames.column(f"{name}_{j}") for j in range(joints)]
    complete = [np.asarray(column, dtype=float) for column in columns if column is not None]
    return np.column_stack(complete) if len(complete) == joints else None


def _needed(folder: Path, frames: Frames, name: str, joints: int) -> FloatArray:
    values = _joint_columns(frames, name, joints)
    if values is None:
        got = ", ".join(n for n in frames.columns if n.startswith(f"{name}_")) or "none of them"
        expected = f"columns {name}_0 to {name}_{joints - 1}, one per joint"
        raise input_error(f"{folder}, frames", expected, got)
    return values
