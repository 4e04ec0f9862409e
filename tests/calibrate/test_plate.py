"""A plate on a curved fingertip is a contact like any other; on a flat pad it is a pressure chamber."""

from __future__ import annotations

from dataclasses import replace
from itertools import product
from pathlib import Path

import numpy as np
import pytest
from chambers import Chamber

from skincal.calibrate import calibrate, choose_way
from skincal.calibrate.checkpoint import Checkpoint
from skincal.calibration import MARGIN_M
from skincal.dataset import Dataset, IndenterSpec, SurfaceSpec, read_dataset
from skincal.dataset.uniform_pressure import centre_contacts, uniform_pressure
from skincal.errors import WorkError
from skincal.fitting.fit_options import FitOptions, GridSteps
from skincal.model import (
    Contacts,
    Converter,
    Cylinder,
    FlatPunch,
    Patch,
    Plane,
    SensorPose,
    Skin,
    SkinParameters,
)
from skincal.units import rad

RADIUS, E, S = 0.0115, 5e8, 60.0
POSE = SensorPose(0.0237, rad(3.0), beta_rad=0.6e-3 / RADIUS)
QUICK = FitOptions(
    steps=GridSteps(2.5e-3, 3e-3, rad(10), 6),
    law_spreads_m=(0.0,),
    rounds=(3, 4),
    round_size=100,
    enough_draws=60,
)


@pytest.fixture
def chamber(tmp_path: Path) -> Dataset:
    return read_dataset(Chamber.plain().write(tmp_path / "chamber", frames=False))


@pytest.fixture(scope="module")
def rolled(tmp_path_factory: pytest.TempPathFactory) -> Dataset:
    """A cylinder that was rolled over a plate: a line of contact across the patch at every press."""
    data = read_dataset(Chamber.plain().write(tmp_path_factory.mktemp("plate") / "chamber", frames=False))
    meta, rng, presses = data.meta, np.random.default_rng(2), 16
    surface = Cylinder(RADIUS)
    mount = replace(
        meta.mount, x_m=None, x_range_m=None, y_m=0.0235, y_range_m=(0.021, 0.026), beta_deg=0.0,
        beta_range_deg=(-10.0, 10.0), alpha_range_deg=(-10.0, 10.0),
    )  # fmt: skip
    meta = replace(
        meta,
        surface=SurfaceSpec("cylinder", RADIUS),
        indenter=replace(meta.indenter, radius_m=0.04),
        mount=mount,
        position=replace(meta.position, sigma_m=0.3e-3, slack_m=0.8e-3),
    )
    across, along = rng.uniform(-6e-3, 6e-3, presses), rng.uniform(0.020, 0.027, presses)
    at = np.stack([RADIUS * np.sin(across / RADIUS), along, RADIUS * np.cos(across / RADIUS)], axis=1)
    force = rng.uniform(2.0, 7.0, presses)
    patch = Patch.build(surface, data.layout(), POSE, 0.5e-3)
    skin = Skin(patch, SkinParameters(E, S), Converter.none())
    counts = skin.values(FlatPunch(0.04), Contacts(at, surface.normal_at(at), force))
    counts = np.clip(np.rint(counts + 0.3 * rng.standard_normal(counts.shape)), 0, 255)
    error = np.clip(0.2e-3 * rng.standard_normal((2, presses)), -0.7e-3, 0.7e-3)
    table = data.presses.select(np.arange(presses))
    table = replace(table, position_m=surface.offset(at, *error), force_n=force, counts=counts)
    return replace(data, meta=meta, presses=table)


def test_only_what_is_uniform_is_uniform(chamber: Dataset, rolled: Dataset) -> None:
    assert uniform_pressure(chamber)
    assert not uniform_pressure(rolled)
    # On a flat pad the edge of a punch that is only a little larger than the patch may cross it.
    position = replace(chamber.meta.position, sigma_m=1e-3, slack_m=2e-3)
    known = replace(chamber, meta=replace(chamber.meta, position=position))
    assert uniform_pressure(known)
    aside = np.tile([0.095, 0.0, 0.0], (len(known.presses), 1))
    assert not uniform_pressure(replace(known, presses=replace(known.presses, position_m=aside)))


def test_pressure_is_even_wherever_the_sensor_is(chamber: Dataset) -> None:
    placed = centre_contacts(chamber, MARGIN_M)
    at, up, force = placed.presses.position_m[:1], np.array([[0.0, 0.0, 1.0]]), placed.presses.force_n[:1]
    for x, y in product(*(getattr(chamber.meta.mount, name) for name in ("x_range_m", "y_range_m"))):
        pose = SensorPose(y, rad(5.0), x_m=x)
        skin = Skin(Patch.build(Plane(), placed.layout(), pose, 1e-3), SkinParameters(E, S))
        loads = skin.loads(placed.indenter(), Contacts(at, up, force))
        even = chamber.presses.force_n[0] * 2.5e-3**2 / (np.pi * 0.1**2)
        assert loads == pytest.approx(np.full((1, 16), even), rel=1e-6)


@pytest.mark.slow
def test_a_plate_tells_pose_elasticity_and_scale(rolled: Dataset) -> None:
    assert choose_way(rolled).method == "general"
    found = calibrate(rolled, options=QUICK, workers=1).calibration
    assert found.model.elasticity_pa_per_m == pytest.approx(E, rel=0.15)
    assert found.model.scale_per_n == pytest.approx(S, rel=0.04)
    assert found.model.beta_deg == pytest.approx(np.degrees(POSE.beta_rad), abs=1.0)
    assert "dead_taxel" not in {one.code for one in found.findings}


def test_a_plate_whose_place_is_not_known_is_refused(rolled: Dataset) -> None:
    presses = replace(rolled.presses, position_m=np.full_like(rolled.presses.position_m, np.nan))
    with pytest.raises(WorkError, match="place of a press is missing") as refused:
        calibrate(replace(rolled, presses=presses), options=QUICK, workers=1)
    assert "x_m, y_m, z_m" in str(refused.value)
    assert "If a pressure chamber pressed a flat pad" in str(refused.value)


def test_weights_on_a_flat_pad_without_places_are_refused(chamber: Dataset) -> None:
    presses = replace(chamber.presses, position_m=np.full_like(chamber.presses.position_m, np.nan))
    meta = replace(chamber.meta, indenter=IndenterSpec("sphere", 0.006))
    with pytest.raises(WorkError, match="of weights laid on by hand, where they were laid") as refused:
        calibrate(replace(chamber, meta=meta, presses=presses), options=QUICK, workers=1)
    assert "pressure chamber" not in str(refused.value)


def test_tables_of_an_interrupted_fit_are_taken_up(rolled: Dataset, tmp_path: Path) -> None:
    """Interrupted while it makes tables of images, a fit does not make again those that it had."""
    seen: list[tuple[int, int]] = []

    def interrupted(stage: str, done: int, total: int) -> None:
        if stage == "images":
            seen.append((done, total))
            if done == 2 and len(seen) == 3:
                raise KeyboardInterrupt

    few = replace(rolled, presses=rolled.presses.select(np.arange(10)), sha256="data")
    with pytest.raises(KeyboardInterrupt):
        calibrate(few, options=QUICK, workers=1, checkpoint=tmp_path / "kept", progress=interrupted)
    assert len(list((tmp_path / "kept").glob("table-*.npz"))) == 2
    seen.clear()

    def first(stage: str, done: int, total: int) -> None:
        if stage == "images":
            seen.append((done, total))
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        calibrate(few, options=QUICK, workers=1, checkpoint=tmp_path / "kept", progress=first)
    assert seen[0][0] == 2
    assert Checkpoint(tmp_path / "kept", "another").table("nothing") is None
