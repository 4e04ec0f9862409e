"""Tasks, observations, engines, backends and protocols by name, and what is published; nothing that help waits for."""

from __future__ import annotations

from enum import StrEnum
from typing import Final, Literal


class Task(StrEnum):
    """Object between the fingers."""

    marble = "marble"
    bolt = "bolt"
    pellets = "pellets"


class PolicyKind(StrEnum):
    """Observations of a policy (the paper's table "Observation space of different policies")."""

    tactile = "tactile"
    joint_angles = "joint-angles"
    desired = "desired"
    ideal = "ideal"


class BackendName(StrEnum):
    """Backend: Stable-Baselines3 in torch, or the same algorithm in jax."""

    sb3 = "sb3"
    sbx = "sbx"


class Engine(StrEnum):
    """Physics engine; policies are trained in the first."""

    pybullet = "pybullet"
    mujoco = "mujoco"


ENVIRONMENT_IDS: Final = {
    Task.marble: "skincal/MarbleRoll-v0",
    Task.bolt: "skincal/BoltRoll-v0",
    Task.pellets: "skincal/PelletSeparate-v0",
}
"""What gymnasium makes a task by."""

ObjectName = Literal["marble", "bolt"]
"""Objects of ranges, ``object.NAME``."""

OBJECTS: Final[dict[Task, ObjectName]] = {Task.marble: "marble", Task.bolt: "bolt", Task.pellets: "marble"}
"""Object of each task; pellets are small marbles."""

PresetName = Literal["iros24", "icra26"]
"""Published works whose randomization comes along as a preset."""

TASK_PRESETS: Final[dict[Task, PresetName]] = {
    Task.marble: "iros24",
    Task.bolt: "iros24",
    Task.pellets: "icra26",
}
"""Preset that a task is trained on where no ranges are given."""

PROTOCOLS: Final = {
    "full": "presses that can show every effect except tangential force and, without --second-indenter-mm, the "
    "indenter's size",
    "paper": "60 static ones",
}
"""What each protocol of ``skincal collect`` draws, as its help says; the functions are in ``collect/protocols.py``."""

PUBLISHED_STEPS: Final = {Task.marble: 800_000, Task.bolt: 600_000, Task.pellets: 8_000_000}
"""Length of a training run [environment steps], Kasolowsky & Bäuml, IROS 2024, section V-E; pellets: ICRA 2026."""

DURATION_S: Final = {Task.marble: 8.0, Task.bolt: 24.0, Task.pellets: 6.0}
"""Length of a run of an evaluation [s]."""

SPEEDS_RAD_PER_S: Final = {Task.marble: 0.3, Task.bolt: 0.6, Task.pellets: 0.3}
"""Joint velocity that an action of 1 commands; assumed [rad/s]."""

JOINT_OFFSETS: Final = ("finger.joint_offset_rad",)
"""All that the paper randomizes in its evaluation; everything else is nominal."""
