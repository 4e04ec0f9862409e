"""The audit of datasets and plans."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from calibrations import make_calibration
from diagnosis.diagnose_data import moving, still

from skincal.collect import Mount, full_plan, paper_plan
from skincal.dataset import IDLE, Dataset, SurfaceSpec
from skincal.diagnosis.audit import AuditReport, audit_dataset, audit_plan
from skincal.diagnosis.planned_session import plan_session
from skincal.effects import EFFECTS
from skincal.effects.samples import HOLD
from skincal.errors import InputError, WorkError
from skincal.report.diagnosis_figures import audit_figure
from skincal.robot import hand_named

HAND = hand_named()
MOUNT = Mount.of(HAND.meta)
DYNAMIC = {"hysteresis", "creep", "rate", "latency", "first_cycle", "baseline_drift", "gain_drift"}


def rng() -> np.random.Generator:
    return np.random.default_rng(0)


@pytest.fixture(scope="module")
def framed() -> AuditReport:
    return audit_dataset(moving(), None, rng())


@pytest.fixture(scope="module")
def static() -> AuditReport:
    return audit_dataset(still(), None, rng())


def test_frames_show_dynamic_effects(framed: AuditReport):
    assert DYNAMIC - {"first_cycle", "gain_drift"} <= set(framed.visible)
    assert framed.presses == 16 and framed.has_frames and not framed.calibrated
    assert set(framed.visible) | set(framed.cannot_see) == set(EFFECTS)


def test_static_presses_hide_dynamic_effects(static: AuditReport):
    assert set(static.cannot_see) >= DYNAMIC | {"shear"}
    assert set(static.reasons) == set(static.cannot_see)
    assert {"crosstalk", "ghosting", "taxel_offset"} <= set(static.visible)


def test_times_alone_hide_memory():
    clocked = audit_dataset(still(clock=True), None, rng())
    assert {"hysteresis", "rate", "latency"} <= set(clocked.cannot_see)
    assert "baseline_drift" in clocked.visible


def test_same_seed_gives_same_audit(static: AuditReport):
    repeated = audit_dataset(still(), None, rng())
    assert all(repeated.effects[n].distance == one.distance for n, one in static.effects.items())


def test_calibration_is_checked():
    calibration = make_calibration()
    report = audit_dataset(still(), calibration, rng())
    assert report.calibrated
    other = replace(still(), meta=replace(still().meta, surface=SurfaceSpec("cylinder", 0.02)))
    with pytest.raises(InputError, match="radius_m"):
        audit_dataset(other, calibration, rng())


def test_plan_of_another_hand_is_refused():
    calibration = make_calibration()
    plan = paper_plan(rng(), MOUNT.layout)
    assert audit_plan(plan, HAND, calibration, rng()).calibrated
    other = replace(calibration, surface=SurfaceSpec("cylinder", 0.02))
    with pytest.raises(InputError, match=f"hand {HAND.name}.*radius_m"):
        audit_plan(plan, HAND, other, rng())


def test_nothing_to_audit():
    data = still()
    nowhere = replace(data.presses, position_m=np.full_like(data.presses.position_m, np.nan))
    with pytest.raises(WorkError, match="nothing to audit"):
        audit_dataset(replace(data, presses=nowhere), None, rng())


@pytest.mark.parametrize("data", [moving(), still()], ids=["frames", "holds"])
def test_force_outlier_is_left_out(data: Dataset, framed: AuditReport, static: AuditReport):
    presses, frames = data.presses, data.frames
    force = presses.force_n.copy()
    force[3] = 2500.0
    if frames is not None:
        frames = replace(frames, force_n=np.where(frames.press == presses.press[3], 2500.0, frames.force_n))
    report = audit_dataset(replace(data, presses=replace(presses, force_n=force), frames=frames), None, rng())
    expected = static if frames is None else framed
    assert report.left_out == (int(presses.press[3]),) and expected.left_out == ()
    assert report.presses == expected.presses - 1
    smallest = [[one.smallest_strength for one in r.effects.values()] for r in (report, expected)]
    visible = np.isfinite(smallest).all(axis=0) & (np.array(smallest) < 1).all(axis=0)
    np.testing.assert_allclose(*np.array(smallest)[:, visible], rtol=0.3)


def test_frames_without_contact_are_refused():
    data = moving()
    assert data.frames is not None
    phase = np.full_like(data.frames.phase, IDLE)
    press = np.full_like(data.frames.press, -1)
    frames = replace(data.frames, phase=phase, press=press)
    with pytest.raises(WorkError, match=r"columns press and phase.* got such frames of 0 of 16"):
        audit_dataset(replace(data, frames=frames), None, rng())


def test_frames_without_positions_are_refused():
    data = moving()
    assert data.frames is not None
    frames = replace(data.frames, position_m=np.full_like(data.frames.position_m, np.nan))
    with pytest.raises(WorkError, match=r"columns x_m, y_m, z_m and force_n: .* got such frames of 0 of 16"):
        audit_dataset(replace(data, frames=frames), None, rng())


def test_force_outliers_of_single_frames_are_left_out(framed: AuditReport):
    data = moving()
    assert data.frames is not None
    force = data.frames.force_n.copy()
    force[np.flatnonzero(data.frames.phase == HOLD)[::40]] = 2500.0
    report = audit_dataset(replace(data, frames=replace(data.frames, force_n=force)), None, rng())
    assert report.left_out == () and report.presses == framed.presses
    assert report.visible == framed.visible


@pytest.mark.parametrize(("presses", "is_outlier"), [(4, False), (5, True), (10, True)])
def test_few_presses_have_no_outlier(presses: int, is_outlier: bool):
    data = still()
    force = np.concatenate([[2500.0], np.full(len(data.presses) - 1, 2.0)])
    force[presses:] = np.nan
    report = audit_dataset(replace(data, presses=replace(data.presses, force_n=force)), None, rng())
    assert report.left_out == ((int(data.presses.press[0]),) if is_outlier else ())


def test_plan_has_the_frames_of_collect():
    plan = paper_plan(rng(), MOUNT.layout)
    session = plan_session(plan, HAND)
    held = session.phase == HOLD
    assert session.presses == len(plan)
    assert session.frames[held].sum() == pytest.approx(25 * sum(p.hold_s for p in plan.presses), rel=0.01)
    assert (np.diff(session.samples.time_s) >= 0).all()


def test_full_plan_shows_all_but_shear():
    report = audit_plan(full_plan(rng(), MOUNT.layout), HAND, None, rng())
    assert report.cannot_see == ("shear",)
    assert "plan" in report.reasons["shear"] and report.planned
    figure = audit_figure(report)
    assert len(figure.axes) == 3 and f"{len(EFFECTS) - 1} of {len(EFFECTS)}" in figure.get_suptitle()
