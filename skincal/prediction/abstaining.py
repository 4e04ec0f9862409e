"""Effects of a calibration that abstain because a dataset lacks their covariates, in words."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from skincal.calibration import Calibration, Effect
from skincal.dataset import IDLE, Dataset
from skincal.effects import COVARIATES, EFFECTS
from skincal.errors import Problem
from skincal.prediction.session_samples import pose_names, session_samples
from skincal.prediction.touches import CalibratedSkin, Touches

_LEFT_OUT = "The prediction leaves it out."


def abstaining(on: CalibratedSkin, dataset: Dataset) -> dict[str, tuple[str, ...]]:
    """Return the names of effects that abstain, each with its missing covariates."""
    if not on.has_effects:
        return {}
    touches = Touches.of_presses(on, dataset) if dataset.frames is None else Touches.of_frames(on, dataset)
    samples = session_samples(touches, dataset, pose_names(dataset))
    lacking = {
        one.effect.name: tuple(name for name in one.needs if not samples.has(name))
        for one in on.full.effects
        if not one.neutral
    }
    return {name: missing for name, missing in lacking.items() if missing}


def abstaining_problems(
    calibration: Calibration, dataset: Dataset, lacking: Mapping[str, tuple[str, ...]]
) -> tuple[Problem, ...]:
    """Return warnings about effects that abstain, and about hand poses that the calibration does not know."""
    place = "the dataset" if dataset.folder is None else str(dataset.folder)
    found = [
        Problem(f"{place}, for the effect {name}", _columns(missing), "none", _LEFT_OUT)
        for name, missing in lacking.items()
    ]
    found += [problem for one in calibration.effects for problem in _partly(one, dataset, place, lacking)]
    poses = pose_names(dataset)
    for one in calibration.effects:
        several = any(isinstance(v, tuple) and len(v) > 1 for v in one.parameters.values())
        new = [pose for pose in poses if pose not in one.poses]
        if one.poses and several and new:
            where = f"{place}, column pose, for the effect {one.name}"
            fix = "It is neutral in other poses."
            found.append(Problem(where, f"the poses {', '.join(one.poses)}", ", ".join(new), fix))
    return tuple(found)


def _columns(missing: tuple[str, ...]) -> str:
    # Phases come with the times, with or without frames; a site's largest force comes with the count of its touches.
    named = [name for name in missing if COVARIATES[name].comes_with not in missing]
    return " and ".join(sorted({str(COVARIATES[name]) for name in named}))


def _partly(
    effect: Effect, dataset: Dataset, place: str, lacking: Mapping[str, tuple[str, ...]]
) -> list[Problem]:
    """Return problems of covariates of an effect that only a part of the presses have."""
    if effect.name in lacking:
        return []
    found: list[Problem] = []
    frames = dataset.frames
    one = EFFECTS[effect.name]
    at_work = {p.name for p in one.parameters if _moves(effect, p.name, p.neutral)}
    needs = {*one.covariates, *(need for p in one.parameters if p.name in at_work for need in p.needs)}
    for name in sorted(needs):
        for column in COVARIATES[name].columns:
            values = None if frames is None else frames.column(column)
            what = "frames under load"
            if values is not None and frames is not None:
                values = values[frames.phase != IDLE]
            else:
                values, what = dataset.presses.column(column), "presses"
            empty = 0 if values is None else int(np.isnan(values).sum())
            if values is not None and 0 < empty < len(values):
                got = f"empty in {empty} of {len(values)} {what}"
                fix = "The effect is left out there, which makes steps: fill the cells, or remove the column."
                found.append(
                    Problem(f"{place}, column {column}, for the effect {effect.name}", "a value", got, fix)
                )
    return found


def _moves(effect: Effect, name: str, neutral: float) -> bool:
    return name in effect.parameters and bool(np.any(np.asarray(effect.parameters[name]) != neutral))
