"""All that is listed beside a verdict, from what the stages know."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from skincal.calibration import Finding
from skincal.dataset import Dataset
from skincal.diagnose.answer import Answer
from skincal.diagnose.base_fit import Base
from skincal.diagnose.diagnosis import NamedEffect
from skincal.diagnose.findings import (
    few_of_the_end,
    findings_of,
    of_noise,
    too_many_glitches,
    within_the_clocks,
)
from skincal.diagnose.prepare import OFFSET, Prepared
from skincal.diagnose.session import repeats
from skincal.effects import EFFECTS
from skincal.gap.heldout import Gap
from skincal.gap.hypothesis import Hypothesis
from skincal.gap.models import Model
from skincal.gap.noise import NoiseFloor
from skincal.gap.reading import Reading
from skincal.gap.robust import too_many
from skincal.model.arrays import IntArray

_PULLED = 16.0
"""A press that has so many standard deviations of its measured force more, or less, is told."""


def listed(
    dataset: Dataset,
    ready: Prepared,
    base: Base,
    answer: Answer,
    effects: Sequence[NamedEffect],
    floor: NoiseFloor,
    gap: Gap,
    last: tuple[Model, Hypothesis],
    reading: Reading,
    of_law: float,
) -> tuple[Finding, ...]:
    """Findings: of the noise, of the presses of the end, of the clocks, of faults of sensor and rig.

    Args:
        dataset: the session.
        ready: as it was prepared.
        base: the base model's fit.
        answer: what the session says.
        effects: that were named; none where the verdict is another.
        floor: the noise, with what repeats say.
        gap: before and after.
        last: the model that counts, and it with every press at its best place.
        reading: without what presses that show silent taxels say of these.
        of_law: what another contact law would explain, in units of the noise.
    """
    session, presses = ready.session, dataset.presses
    model, placed = last
    clock = dataset.meta.clock
    wild = too_many(model.refit.slopes.residual, reading.seen & base.material.known[:, None], session.press)
    return (
        *of_noise(
            floor, frames=session.has_frames, repeated=_repeated(dataset), uniform=not ready.options.base
        ),
        *few_of_the_end(gap),
        *within_the_clocks(effects, None if clock is None else clock.sigma_s),
        *too_many_glitches(presses.press, wild),
        *findings_of(
            dataset.layout(),
            presses.press,
            base.glitches.tolist(),
            base.jumps,
            [*base.dead, *(one.dead for one in base.silent)],
            ready.reading.seen,
            session.taxels,
            of_law,
            base.stuck,
            presses.counts.shape[1],
            answer.doubted.tolist(),
            pulled(placed, ready, base.glitches),
            (ready.floor.frame_counts, ready.floor.taxel_counts),
            None if session.samples.time_s is not None else session.press,
            of_single=[e.name for e in effects if _has_numbers_of_taxels(e) and not _of_all(e, ready)],
        ),
    )


def _repeated(dataset: Dataset) -> bool | None:
    """Whether any press is an exact repeat of another; None where no targets tell."""
    names = ("target_force_n", "target_x_m", "target_y_m", "target_z_m")
    targets = [c for name in names if (c := dataset.presses.column(name)) is not None]
    if len(targets) < len(names) or not np.isfinite(np.stack(targets)).all(axis=0).any():
        return None
    return bool(len(repeats(dataset)[0]))


def pulled(after: Hypothesis, ready: Prepared, glitches: IntArray) -> dict[int, float]:
    """Rows of presses that fit best with quite another force, and by which part it is larger than the measured one."""
    if not ready.options.base:
        return {}
    own = np.abs(after.places[:, 2]) > _PULLED * ready.options.force_sigma
    rows = np.setdiff1d(np.flatnonzero(own), glitches)
    return {int(row): float(np.expm1(after.places[row, 2])) for row in rows}


def _has_numbers_of_taxels(effect: NamedEffect) -> bool:
    return any(p.shape == "per-taxel" for p in EFFECTS[effect.name].parameters)


def _of_all(effect: NamedEffect, ready: Prepared) -> bool:
    """Whether an effect has numbers of all taxels, though some only were looked at."""
    return effect.name == OFFSET and ready.rest_counts is not None
