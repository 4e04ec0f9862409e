"""Columns of effects: those of single taxels stay with their taxel."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from inference.made import made
from model.model_shapes import cylinder_mesh
from report.diagnosis_cases import calibration

from skincal.dataset import SurfaceSpec
from skincal.diagnosis.observed import Observed, observe
from skincal.inference.candidate_scores import scene_of
from skincal.inference.columns import Candidate, candidates, free_columns, free_parameters
from skincal.inference.fit import Fitted
from skincal.inference.forward import Effects

OFFSET = {"taxel_offset": {"offset_counts": np.linspace(-3, 3, 16)}}
LEAK = {"crosstalk": {"leak": np.asarray(0.05)}}


@cache
def seen() -> Observed:
    """A few presses."""
    data = made(presses=4, rest=30.0)
    return observe(
        data, replace(calibration(), sensor=data.meta.sensor), np.random.default_rng(0), keep=False
    )


def fitted(effects: Effects) -> Fitted:
    fitter = seen().fitter
    return fitter.linearise(replace(fitter.priors.start, effects=effects), ())


def found(effects: Effects, *names: str) -> list[Candidate]:
    fit, fitter = fitted(effects), seen().fitter
    _, slope = fitter.forward.noise.written(fit.prediction.values + fit.state.rest)
    return list(candidates(fitter.forward, fit.prediction, scene_of(fitter, fit), slope, names, set()))


def test_an_effect_of_each_taxel_has_a_compact_column_a_taxel():
    (offset,) = found({}, "taxel_offset")
    assert offset.columns.dense.shape[2] == 0 and offset.columns.single.shape[1] == 16
    assert offset.columns.taxel.tolist() == list(range(16))
    for one in found({}, "dead_taxel"):
        assert one.columns.dense.shape[2] == 0 and set(one.columns.taxel.tolist()) == {one.start.alone}


def test_where_taxels_are_mixed_behind_it_others_see_it():
    (gain,) = found(LEAK, "taxel_gain")
    assert gain.columns.dense.shape[2] == 16
    assert (np.abs(gain.columns.dense).max(axis=0) > 0).sum(axis=0).max() > 1
    # Levels at rest are added behind the leak.
    (offset,) = found(LEAK, "taxel_offset")
    assert offset.columns.dense.shape[2] == 0


@pytest.mark.parametrize("others", [{}, LEAK])
def test_columns_of_one_run_are_those_of_runs_of_their_own(others: Effects):
    fit, forward = fitted({**OFFSET, **others}), seen().fitter.forward
    free = free_parameters("taxel_offset", OFFSET["taxel_offset"], None, seen().covariates)
    whole = free_columns(forward, fit.prediction, free)
    for k in (0, 7):
        (alone,) = free_columns(forward, fit.prediction, [free[k]])
        assert whole[k].array() == pytest.approx(alone.array(), abs=1e-9)
        changed = {n: {p: np.array(v) for p, v in own.items()} for n, own in fit.state.effects.items()}
        changed["taxel_offset"]["offset_counts"][k] += 0.5
        slope = (forward.with_effects(fit.prediction, changed) - fit.prediction.values) / 0.5
        assert whole[k].array()[..., 0] == pytest.approx(slope, abs=1e-6)


def test_columns_of_the_base_on_a_mesh_are_those_of_its_cylinder():
    data = made(presses=4, rest=30.0)
    mesh = cylinder_mesh(120)
    other = replace(
        data,
        meta=replace(data.meta, surface=SurfaceSpec("mesh", None, "tip.stl")),
        meshes={"tip.stl": mesh.export(file_type="stl")},
    )
    columns = list[np.ndarray]()
    for one in (data, other):
        known = replace(calibration(), sensor=one.meta.sensor, surface=one.meta.surface, meshes=one.meshes)
        fitter = observe(one, known, np.random.default_rng(0), keep=False).fitter
        fit = fitter.linearise(fitter.priors.start, ())
        columns.append(fitter.forward.base_columns(fit.prediction)[..., :5].reshape(-1, 5))
    plain, meshed = (c / np.linalg.norm(c, axis=0) for c in columns)
    assert ((plain * meshed).sum(axis=0) > 0.98).all()
