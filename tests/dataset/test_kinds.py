"""Every kind of surface and indenter that a file may name has a model, and the compiled routine knows its form."""

from __future__ import annotations

import shutil
from dataclasses import replace
from pathlib import Path
from typing import Any

import numba
import numpy as np
import pytest

from skincal.dataset import IndenterSpec, SurfaceSpec
from skincal.dataset.dataset import indenter_of, surface_of
from skincal.dataset.kinds import INDENTERS, SURFACES, Kind
from skincal.envs.pinch import read_pinch
from skincal.errors import InputError
from skincal.model import ClosedForm, SensorPose
from skincal.model.press.meet import meet_point
from skincal.robot import Kinematics, bundled_hand, read_hand

# A tetrahedron that stands on its tip at the origin: closed, as an indenter is.
MESH = b"OFF\n4 4 0\n0 0 0\n-1 -1 2\n2 -1 2\n-1 2 2\n3 0 1 2\n3 0 2 3\n3 0 3 1\n3 1 3 2\n"


@numba.njit  # device functions can only be called by compiled ones
def distance(kind: Any, radius: Any, frame: Any, x: Any) -> Any:
    return meet_point(kind, radius, frame, x, 0.0, 0.0)[0]


def _hand_of_another_kind(folder: Path, kind: str) -> Path:
    """The bundled hand with "cone" in the place of a kind."""
    shutil.copytree(bundled_hand().urdf.parent, folder)
    file = folder / "hand.toml"
    file.write_text(file.read_text().replace(f'kind = "{kind}"', 'kind = "cone"'))
    return folder


def _given(kind: Kind) -> dict[str, object]:
    return dict.fromkeys(kind.numbers, 0.006) | ({"file": "shape.off"} if kind.mesh else {})


@pytest.mark.parametrize("name", SURFACES)
def test_a_surface_is_made_and_says_what_it_is(name: str) -> None:
    spec = SurfaceSpec(name, **_given(SURFACES[name]))
    surface = surface_of(spec, {"shape.off": MESH})
    assert spec.across == ("x_m" if spec.is_plane else "beta_deg")
    points = np.array([[1e-3, 0.0235, 0.0], [0.0, 0.024, 0.006]])
    # Hands find contacts in closed form, and tasks roll objects round one radius.
    assert surface.is_uniform or not SURFACES[name].on_hand
    assert surface.arc_radius_m is not None or not SURFACES[name].in_tasks
    if not surface.is_uniform:
        with pytest.raises(TypeError, match="the same everywhere"):
            surface.unrolled(points, points[:1])
        return
    # Arcs and y are those by which points are offset, and a pose moves by arcs.
    for beta in (0.0, np.pi - 0.1):
        pose = SensorPose(0.0235, beta)
        moved = surface.moved_pose(pose, 2e-3)
        here, there = (surface.wrap(p, np.zeros((1, 2)))[0] for p in (pose, moved))
        np.testing.assert_allclose(surface.offset(here, 2e-3, 0.0), there, atol=1e-12)
        np.testing.assert_allclose(surface.unrolled(there, here), [[2e-3, 0.0]], atol=1e-12)
    radius = surface.arc_radius_m
    assert radius == surface.arc_radius_at(pose)
    assert (radius is None) == spec.is_plane


@pytest.mark.parametrize("name", INDENTERS)
def test_an_indenter_is_made_and_its_compiled_form_is_its_own(name: str) -> None:
    indenter = indenter_of(IndenterSpec(name, **_given(INDENTERS[name])), {"shape.off": MESH})
    if not isinstance(indenter, ClosedForm):
        return
    frame = (0.0, 0.0, 1.0, 1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0)
    for x in (0.0, 1e-3, 4e-3):
        met = distance(indenter.kind, indenter.radius_m, frame, x)
        assert met == pytest.approx(indenter.cast([[x, 0.0, 0.0]], [0.0, 0.0, 1.0]).distance_m[0], abs=1e-12)


@pytest.mark.parametrize("table", ["surface", "indenter"])
def test_hands_refuse_a_new_kind(table: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    hand = bundled_hand()
    kinds, like = (SURFACES, "cylinder") if table == "surface" else (INDENTERS, "sphere")
    new = Kind(kinds[like].model, kinds[like].numbers)
    monkeypatch.setitem(kinds, "cone", new)
    folder = _hand_of_another_kind(tmp_path / "hand", like)
    with pytest.raises(InputError, match=rf'\[{table}\] kind: expected "{like}".*got "cone"'):
        read_hand(folder)
    # A driver may bring a description of its own.
    shape = replace(getattr(hand.meta, table), kind="cone")
    with pytest.raises(InputError, match=rf'\[{table}\] kind: expected "{like}"'):
        Kinematics(replace(hand, meta=replace(hand.meta, **{table: shape})))


def test_tasks_refuse_a_new_kind_of_surface(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(SURFACES, "cone", replace(SURFACES["cylinder"], in_tasks=False))
    folder = _hand_of_another_kind(tmp_path / "hand", "cylinder")
    with pytest.raises(InputError, match=r'\[surface\] kind: expected "cylinder", for the tasks; got "cone"'):
        read_pinch(folder)
