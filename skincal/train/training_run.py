"""A training run: a folder with its options, progress, and in the end a policy."""

from __future__ import annotations

import time
from collections.abc import Callable, Generator, Mapping
from contextlib import contextmanager, suppress
from dataclasses import dataclass, replace
from datetime import UTC, datetime
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any, Final, cast

import numpy as np
import tomli_w
from gymnasium import spaces

from skincal.dataset.findings import Findings
from skincal.dataset.schema import load_toml, read_table
from skincal.errors import WorkError, input_error, readable
from skincal.files import alone, real, recover, refuse_existing, whole_folder
from skincal.ranges import Ranges, read_ranges, write_ranges
from skincal.ranges.files import digest
from skincal.tasks import BackendName
from skincal.train.checkpoint import (
    ARRAYS,
    BEGINNING,
    STATE,
    Progress,
    fork_checkpoint,
    load_checkpoint,
    save_checkpoint,
)
from skincal.train.curve import Curve, Round
from skincal.train.learner import ACTOR_KEY, Learner, Make, end, in_full, parallel
from skincal.train.onnx_file import write_policy
from skincal.train.policy_file import Description, Policy, read_policy
from skincal.train.settings import PpoSettings, Settings, Work, part_seed, rounds_of

MARKER: Final = "run.toml"
FORMAT: Final = "skincal-run/1"
RANGES: Final = "ranges.toml"
CURVE: Final = "curve.csv"
CHECKPOINT: Final = "checkpoint"
POLICY: Final = "policy.onnx"
START: Final = "start.onnx"
"""The policy that a run goes on from."""


PACKAGES: Final = (
    "skincal", "gymnasium", "numpy", "pybullet", "stable-baselines3", "torch", "sbx-rl", "jax",
)  # fmt: skip
"""Packages whose versions a policy file tells."""

LATER: Final = (
    CURVE, "curve.png", POLICY, *(f"{CHECKPOINT}/{name}" for name in (STATE, ARRAYS, "weights.*")),
)  # fmt: skip
"""What a run's folder holds in the end, beyond what it begins with."""


@dataclass(frozen=True)
class Trained:
    """A training run that has come to its end.

    Attributes:
        description: what the file says of itself.
        last: figures of the last round; None where no round was missing.
    """

    folder: Path
    policy: Path
    description: Description
    last: Round | None


def begin(
    work: Work,
    ranges: Ranges,
    out: Path,
    *inputs: str | Path | None,
    start: Policy | None = None,
    run: Path | None = None,
    force: bool = False,
) -> None:
    """Make the folder of a run: its options, including the environment's numbers, and the ranges it randomises over.

    Args:
        work: options of the run.
        ranges: what is randomised.
        out: the folder.
        inputs: files that were read, and are not to be replaced; None is skipped.
        start: the policy that the run goes on from; None: it begins with random networks.
        run: folder of the run that learned ``start``; its critics and its memory are taken over, too.
        force: whether an earlier run there is replaced.

    Raises:
        InputError: something is there, the environment cannot be made of this, or a number is out of bounds; then there
            is no folder.
    """
    refuse_existing(out, *inputs, force=force, marker=MARKER)
    work = in_full(work, ranges)
    if start is not None:
        _check_start(start, work)
        work = replace(work, start=(Path(start.file) if run is None else real(run)).stem)
    content = {"format": FORMAT, **work.as_table()}
    findings = Findings(out)
    _work_of(content, findings)
    findings.raise_errors()
    with whole_folder(out, force=force, marker=MARKER, later=LATER) as temporary:
        (temporary / MARKER).write_text(readable(tomli_w.dumps(content)), encoding="utf-8")
        write_ranges(ranges, temporary / RANGES)
        if start is not None:
            write_policy(start.network, start.description, temporary / START)
        if run is not None:
            fork_checkpoint(run / CHECKPOINT, temporary / CHECKPOINT)


def _check_start(start: Policy, work: Work) -> None:
    """Check that a run can go on from a policy.

    Raises:
        InputError: it is of another task, sees something else, or has other layers.
    """
    hidden = tuple(len(bias) for bias in start.network.biases[:-1])
    about = start.description
    wanted = f"a policy of {work.task} that sees {work.policy}, with layers of {work.settings.hidden}"
    if (about.task, about.policy, hidden) != (work.task, work.policy, work.settings.hidden):
        got = f"one of {about.task} that sees {about.policy}, with layers of {hidden}"
        raise input_error(start.file, wanted, got)


def read_run(folder: Path) -> tuple[Work, Ranges]:
    """Return options of a run.

    Raises:
        InputError: the folder is no run's.
    """
    place = folder / MARKER
    for one in (folder, folder / CHECKPOINT):
        recover(one)
    findings = Findings(folder)
    table = load_toml(place, findings, what="training run", within=folder) or {}
    findings.raise_errors()
    work = _work_of(table, findings)
    findings.raise_errors()
    return work, read_ranges(folder / RANGES)


def _work_of(content: Mapping[str, Any], findings: Findings) -> Work:
    """Return the run that a table describes; what is wrong with it becomes findings."""
    table = dict(content)
    given: object = table.pop("settings", {})
    if not isinstance(given, dict):
        findings.error(f"{MARKER}, [settings]", "a table [settings]", given)
    settings = cast("dict[str, Any]", given) if isinstance(given, dict) else {}
    kind = PpoSettings if "rollout_steps" in settings else Settings
    work = read_table(Work, table, findings, MARKER, FORMAT)
    return replace(work, settings=read_table(kind, settings, findings, MARKER, within=("settings",)))


def train(
    folder: Path,
    make: Make,
    steps: int | None = None,
    *,
    processes: bool = False,
    progress: Callable[[Round], None] = lambda _: None,
) -> Trained:
    """Train until a run has so many steps; goes on from its last checkpoint where there is one.

    Args:
        folder: of the run, made by :func:`begin`.
        make: makes an environment.
        steps: environment steps that it shall have in the end, of all environments together; None: as planned.
        processes: whether each environment has a process of its own.
        progress: progress callback; gets the figures of every round.

    Raises:
        InputError: the folder is no run's, or another process works on it.
        WorkError: the networks hold numbers that are not finite.
    """
    work, ranges = read_run(folder)
    with alone(folder / MARKER, folder), _learner(work, make, processes=processes) as learner:
        course = _Course(folder, work, ranges, learner, progress)
        course.go_on(rounds_of(work.settings, steps or work.steps))
        about = course.write_policy()
    return Trained(folder, folder / POLICY, about, course.last)


class _Course:
    """Progress of one run from checkpoint to checkpoint."""

    def __init__(
        self, folder: Path, work: Work, ranges: Ranges, learner: Learner, report: Callable[[Round], None]
    ) -> None:
        self.folder, self.work, self.ranges = folder, work, ranges
        self.learner, self.report = learner, report
        self.last: Round | None = None
        there = (folder / CHECKPOINT).is_dir()
        self.progress = load_checkpoint(learner, folder / CHECKPOINT) if there else BEGINNING
        if work.start:
            start = read_policy(folder / START)
            learner.go_on_from(None if there else start.network, start.description.steps)

    def go_on(self, rounds: int) -> None:
        """Work until so many rounds are done."""
        with Curve(self.folder / CURVE, self.progress.steps) as curve:
            every = self.work.rounds_per_checkpoint
            while (done := self.progress.rounds) < rounds:
                self._segment(min(rounds, (done // every + 1) * every), curve)
                self.write_policy()

    def write_policy(self) -> Description:
        """Write the policy as it is now."""
        network = self.learner.network()
        if not all(np.isfinite(layer).all() for layer in (*network.weights, *network.biases)):
            fault = "the networks hold numbers that are not finite; nothing was written"
            raise WorkError(f"{self.folder}: {fault}")
        work = self.work
        about = Description(
            task=work.task,
            policy=work.policy,
            observation=_layout(self.learner),
            actions=network.actions,
            ranges_sha256=digest(self.ranges),
            seed=work.seed,
            steps=self.progress.steps,
            wall_time_s=round(self.progress.wall_s, 1),
            backend=str(work.backend),
            environment=work.environment,
            versions=_versions(),
            created=datetime.now(UTC).isoformat(timespec="seconds"),
            start=work.start,
        )
        write_policy(network, about, self.folder / POLICY, force=True)
        return about

    def _segment(self, until: int, curve: Curve) -> None:
        def listen(row: Round) -> None:
            self.last = row
            curve.add(row)
            self.report(row)

        began, done = time.perf_counter(), self.progress.rounds
        self.learner.learn(until - done, part_seed(self.work.seed, done), listen)
        wall_s = self.progress.wall_s + time.perf_counter() - began
        self.progress = Progress(until, self.learner.steps, wall_s)
        curve.sync()
        save_checkpoint(self.learner, self.progress, self.folder / CHECKPOINT)


def _layout(learner: Learner) -> tuple[dict[str, Any], ...]:
    """Return the parts of the policy's observation: as the environment tells them, or one for all."""
    environments = learner.normalised
    if environments.has_attr("observation_layout"):
        return tuple(dict(part) for part in environments.get_attr("observation_layout", 0)[0])
    space = environments.observation_space
    assert isinstance(space, spaces.Dict)
    return ({"name": ACTOR_KEY, "size": spaces.flatdim(space[ACTOR_KEY])},)


def _versions() -> dict[str, str]:
    found: dict[str, str] = {}
    for package in PACKAGES:
        with suppress(PackageNotFoundError):
            found[package] = version(package)
    return found


@contextmanager
def _learner(work: Work, make: Make, *, processes: bool) -> Generator[Learner]:
    environments = parallel(make, work.settings.environments, processes=processes)
    try:
        yield _backend(work)(environments, work.settings, work.seed)
    except BaseException:
        end(environments)
        raise
    environments.close()


def _backend(work: Work) -> type[Learner]:
    """Return the learner of a run, whose libraries are loaded only now."""
    name = work.backend
    try:
        if name is BackendName.sbx and isinstance(work.settings, Settings):
            from skincal.train.sbx_learner import SbxLearner

            return SbxLearner
        from skincal.train.sb3_learner import PpoLearner, Sb3Learner

        return PpoLearner if isinstance(work.settings, PpoSettings) else Sb3Learner
    except ModuleNotFoundError as error:
        fix = f"pip install 'skincal[{'sbx' if name is BackendName.sbx else 'train'}]'"
        raise input_error(f"--backend {name}", f"the package {error.name}", "nothing", fix) from error
