"""Which effects of a calibration a dataset does not tell enough for, in words."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from skincal.calibration import Calibration
from skincal.dataset import Dataset
from skincal.effects import COVARIATES
from skincal.errors import Problem
from skincal.predict.samples import TIMES, pose_names, session_samples
from skincal.predict.touches import CalibratedSkin, Touches

_COLUMNS = {**COVARIATES, "time": f"{', '.join(TIMES)} of every press", "shear": "shear_u_n and shear_v_n"}
_LEFT_OUT = "The prediction is without it."


def abstaining(on: CalibratedSkin, dataset: Dataset) -> dict[str, tuple[str, ...]]:
    """Names of effects that abstain, each with the covariates that are missing."""
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
    """What a person should know: effects that abstain, and hand poses that the calibration does not know.

    Args:
        calibration: the skin.
        dataset: what was predicted.
        lacking: effects that abstain and what they lack.
    """
    place = "the dataset" if dataset.folder is None else str(dataset.folder)
    found = [
        Problem(f"{place}, for the effect {name}", _columns(missing), "none", _LEFT_OUT)
        for name, missing in lacking.items()
    ]
    poses = pose_names(dataset)
    for one in calibration.effects:
        several = any(isinstance(v, tuple) and len(v) > 1 for v in one.parameters.values())
        new = [pose for pose in poses if pose not in one.poses]
        if one.poses and several and new:
            where = f"{place}, column pose, for the effect {one.name}"
            fix = "In other poses it is neutral."
            found.append(Problem(where, f"the poses {', '.join(one.poses)}", ", ".join(new), fix))
    return tuple(found)


def _columns(missing: tuple[str, ...]) -> str:
    # Phases come with the times, frames or not.
    named = [name for name in missing if name != "phase" or "time" not in missing]
    return " and ".join(np.unique([_COLUMNS[name] for name in named]).tolist())
