"""Evaluation of a policy on reference hands: each run uses another hand with hidden parameters, through its driver."""

from __future__ import annotations

from bisect import bisect_left
from collections.abc import Callable

import numpy as np

from skincal.deploy.policy_run import Deployed, deploy
from skincal.deploy.targets import marble_targets
from skincal.envs.pinch import read_pinch
from skincal.envs.reference_hand import ReferenceHand
from skincal.envs.trajectories import POLICY_HZ
from skincal.errors import InputError, Problem, WorkError
from skincal.model.arrays import FloatArray
from skincal.ranges import Ranges
from skincal.tasks import JOINT_OFFSETS, SPEEDS_RAD_PER_S, Task
from skincal.train.evaluate import Trial, environment_for, evaluate
from skincal.train.policy_file import Policy
from skincal.train.scores import Runs


def check_trial(trial: Trial) -> None:
    """Check that a trial can run on reference hands.

    Raises:
        InputError: the task is not the marble, or the trial sets options that a reference hand does not have.
    """
    problems: list[Problem] = []
    if trial.task is not Task.marble:
        fix = "skincal deploy bolt POLICY --driver reference"
        problems.append(Problem("--on reference", "the task marble", str(trial.task), fix))
    if isinstance(trial.trajectory, str) and trial.trajectory == "random":
        problems.append(Problem("--trajectory", "circle, still, or a file, with --on reference", "random"))
    if trial.values or trial.environment:
        got = ", ".join([*trial.values, *trial.environment])
        problems.append(Problem("--set, --environment", "nothing, with --on reference", got))
    if trial.randomize is not None and tuple(trial.randomize) != JOINT_OFFSETS:
        got = ", ".join(trial.randomize) or "none"
        problems.append(Problem("--randomize", "nothing: --on reference draws everything", got))
    if problems:
        raise InputError(problems)


def run_trial(
    where: str, policy: Policy, trial: Trial, ranges: Ranges | None, progress: Callable[[int], None]
) -> Runs:
    """Run a trial of a policy; ``where`` is a physics engine, or ``reference`` for reference hands."""
    if where == "reference":
        return reference_runs(policy, trial, ranges=ranges or "iros24", progress=progress)
    environment = environment_for(policy, trial, ranges, engine=where)
    try:
        return evaluate(policy, environment, trial, progress=progress)
    finally:
        environment.close()


def reference_runs(
    policy: Policy,
    trial: Trial,
    *,
    ranges: Ranges | str = "iros24",
    engine: str = "pybullet",
    progress: Callable[[int], None] = lambda _: None,
) -> Runs:
    """Run a policy for the marble on reference hands, one run per hand.

    All parameters but the object's radius are drawn. A run that a fault stops counts as a drop.

    Args:
        policy: the policy.
        trial: episodes, steps, trajectory and seeds.
        ranges: ranges of the hands' parameters.
        engine: physics engine.
        progress: callback with the number of finished runs.
    """
    check_trial(trial)
    pinch = read_pinch(None)
    targets = marble_targets(trial.trajectory, trial.steps / POLICY_HZ)
    speed = float(policy.description.environment.get("speed_rad_per_s", SPEEDS_RAD_PER_S[Task.marble]))
    runs = Runs.empty(trial.episodes, trial.steps, POLICY_HZ)
    runs.target_m[:], runs.rewards[:] = targets[1:], np.nan
    for number in range(trial.episodes):
        hand = ReferenceHand(seed=trial.episode_seed(number), ranges=ranges, engine=engine)
        width = hand.object_width_m
        try:
            run = deploy(policy, hand, pinch, targets, object_width_m=width, speed_rad_per_s=speed)
        except WorkError:
            runs.dropped[number] = True
        else:
            runs.error_m[number, : run.steps] = run.error_m
            runs.object_m[number, : run.steps] = _places(run)
            runs.dropped[number] = run.lost_s is not None
        progress(number + 1)
    return runs


def _places(run: Deployed) -> FloatArray:
    """Return the object's position at the end of each step of the policy (steps, 2) [m]."""
    record = run.record
    time_s = [state.time_s for state in record.states]
    start_s = time_s[record.acting]
    ends = (start_s + (k + 1) / POLICY_HZ for k in range(run.steps))
    rows = [min(bisect_left(time_s, end - 1e-6), len(time_s) - 1) for end in ends]
    return record.places_m[rows]
