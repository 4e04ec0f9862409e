"""Columns are finite differences of the model itself, and what is projected out is gone."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from gap.gap_sessions import MODEL, READOUT, full

from skincal.effects import EFFECTS, EffectSkin
from skincal.fit.observe import Readout
from skincal.gap.audit import AuditOptions, linearise
from skincal.gap.base import STEP_M, base_columns, shifted
from skincal.gap.noise import assumed_floor
from skincal.gap.projection import Projection
from skincal.gap.sensitivity import STEP, Simulator, effect_columns
from skincal.model import Patch, SensorPose, Skin, SkinParameters

SESSION = full(10)
SIMULATOR = Simulator.of(MODEL, SESSION)
ONE = [
    ("force_bias", "offset_n"),
    ("indenter_radius", "scale"),
    ("stiffening", "exponent"),
    ("spread", "width_m"),
    ("hysteresis", "height"),
    ("creep", "amplitude"),
    ("crosstalk", "leak"),
    ("saturation", "inverse_ceiling_per_count"),
]


@pytest.mark.parametrize(("name", "parameter"), ONE)
def test_columns_are_differences_of_the_skin(name: str, parameter: str):
    columns = effect_columns(SIMULATOR, EFFECTS[name], np.random.default_rng(0))
    p = EFFECTS[name].parameter(parameter)
    changed = MODEL.skin.with_effects({name: {parameter: p.neutral + STEP * p.typical}})
    expected = SESSION.means(changed.values(SESSION.samples) - MODEL.skin.values(SESSION.samples))
    assert np.abs(columns.columns[..., columns.names.index(parameter)] - expected).max() < 1e-9
    assert np.abs(expected).max() > 1e-3


@pytest.mark.parametrize("name", list(EFFECTS))
def test_every_effect_has_columns_and_a_typical_case(name: str):
    found = effect_columns(SIMULATOR, EFFECTS[name], np.random.default_rng(0))
    assert found.columns.shape == (len(SESSION), 16, len(found.names))
    assert np.isfinite(found.columns).all() and np.isfinite(found.typical).all()
    assert np.abs(found.typical).max() > np.abs(found.half).max() > 0
    assert (found.least <= 0).all() and (found.most >= 0).all()


def test_base_columns_are_differences_of_the_skin():
    columns, step = base_columns(MODEL, SESSION), 1e-5
    skin, samples = MODEL.skin, SESSION.samples
    for axis in (0, 1):
        move = np.eye(2)[axis] * step
        rise = SESSION.means(
            skin.values(shifted(skin, samples, move)) - skin.values(shifted(skin, samples, -move))
        )
        assert np.abs(columns.press[..., axis] - rise / (2 * step)).max() < 0.15 * np.abs(columns.press).max()
    patch = Patch.build(MODEL.surface, MODEL.layout, SensorPose(0.0235, 0.21, 0.05), 0.8e-3, MODEL.margin_m)
    turned = EffectSkin(Skin(patch, SkinParameters(4e8, 70.0)), MODEL.surface)
    change = SESSION.means(turned.values(samples)) - columns.values
    close = np.corrcoef(change.ravel(), columns.base[..., 2].ravel())[0, 1]
    assert close > 0.99
    soft, stiff = (replace(MODEL, elasticity_pa_per_m=4e8 * (1 + s)).skin for s in (-0.01, 0.01))
    change = SESSION.means(stiff.values(samples) - soft.values(samples)) / 0.02
    assert np.abs(change - columns.base[..., 3]).max() < 0.02 * np.abs(change).max()


def test_a_patch_that_moves_is_presses_that_move_the_other_way():
    columns = base_columns(MODEL, SESSION)
    for axis, direction in enumerate(("across", "along")):
        one, other = (
            SESSION.means(MODEL.moved(direction, s).values(SESSION.samples)) for s in (STEP_M, -STEP_M)
        )
        slope = (one - other) / (2 * STEP_M)
        assert np.abs(slope - columns.base[..., axis]).max() < 1e-3 * np.abs(slope).max()


def test_projection_takes_out_base_and_nuisances():
    options = AuditOptions(position_sigma_m=0.05, force_sigma=100.0)
    linear = linearise(
        MODEL,
        SESSION,
        base_columns(MODEL, SESSION),
        assumed_floor(READOUT),
        options,
        np.random.default_rng(0),
        ("crosstalk",),
    )
    for change in (linear.base.base, linear.base.press[SESSION.press == 3][..., :1]):
        whole = np.zeros((*linear.base.values.shape, change.shape[-1]))
        whole[SESSION.press == 3 if len(change) < len(SESSION) else slice(None)] = change
        white = linear.whitened(whole)
        left = np.linalg.norm(linear.projection.apply(white), axis=0)
        assert (left < 0.02 * np.linalg.norm(white, axis=0)).all()


def test_projection_is_the_inverse_root_of_the_covariance():
    rng = np.random.default_rng(2)
    press = np.array([0, 1, 0, -1, 1])
    nuisance, shape = rng.normal(size=(5, 3, 2)), np.abs(rng.normal(size=(5, 3)))
    projection = Projection.of(press, nuisance, shape, np.zeros((5, 3, 1)))
    covariance = np.eye(15)
    for k in (0, 1):
        own = (press == k).astype(float)[:, None]
        for column in np.moveaxis(nuisance * own[..., None], -1, 0):
            covariance += np.outer(column.ravel(), column.ravel())
        for j in range(3):
            column = shape * own * (np.arange(3) == j)
            covariance += np.outer(column.ravel(), column.ravel())
    root = projection.apply(np.eye(15))
    assert np.allclose(root @ covariance @ root.T, np.eye(15), atol=1e-9)


def test_some_taxels_see_what_they_see_among_all():
    some = np.array([1, 5, 6, 10])
    few = Simulator.of(MODEL, SESSION.of_taxels(some))
    for name in ("taxel_gain", "crosstalk", "spread"):
        whole = effect_columns(SIMULATOR, EFFECTS[name], np.random.default_rng(0))
        part = effect_columns(few, EFFECTS[name], np.random.default_rng(0))
        of = [whole.names.index(n) for n in part.names]
        assert np.allclose(part.columns, whole.columns[:, some][..., of])
        assert np.allclose(part.typical, whole.typical[:, :, some])
    assert base_columns(MODEL, few.session).press.shape[1] == 4


def test_projected_residuals_of_a_true_model_are_noise():
    """Places, forces, pose and E differ from what is believed; what is left has the noise's own size."""
    rng, session = np.random.default_rng(3), full(20)
    believed = replace(MODEL, readout=Readout(None, None, integer=False))
    true = replace(believed, pose=SensorPose(0.0235 + 5e-5, 0.203, 0.052), elasticity_pa_per_m=4.1e8).skin
    row, sigma_p, sigma_f = np.maximum(session.row, 0), 6e-5, 0.005
    across, along = (rng.normal(0, sigma_p, session.presses)[row] for _ in range(2))
    samples = true.setting.moved(session.samples, across, along)
    force = samples.contacts.force_n * np.exp(rng.normal(0, sigma_f, session.presses)[row])
    felt = replace(samples, contacts=replace(samples.contacts, force_n=force))
    noise = rng.normal(size=(len(session), 16)) / np.sqrt(session.frames)[:, None]
    options = AuditOptions(position_sigma_m=sigma_p, force_sigma=sigma_f, shape_sigma=0.0)
    base = base_columns(believed, session)
    floor = assumed_floor(believed.readout, 1.0)
    linear = linearise(believed, session, base, floor, options, rng, ("crosstalk",))
    residual = linear.whitened((session.means(true.values(felt)) + noise - base.values)[..., None])
    left = linear.projection.apply(residual)
    assert np.mean(residual**2) > 1.5
    assert np.mean(left**2) == pytest.approx(1.0, abs=0.06)
