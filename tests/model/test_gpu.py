"""The model on a GPU, by numba's simulator: in a process of its own, as it is chosen when numba is imported."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from typing import Any

import numpy as np
import pytest

import skincal.model.indenters.flat
import skincal.model.indenters.sphere
from skincal.errors import InputError
from skincal.model import Patch, Plane, SensorPose, Skin, SkinParameters, Sphere, TaxelLayout

PRESSES = """
import json
import numpy as np
from skincal.model import *
from skincal.model.gpu import DeviceSkin
from skincal.errors import SkincalError

FREE = TaxelLayout(1, 3, [[-3e-3, 0.0], [0.0, 1e-3], [4e-3, -2e-3]], [[2e-3, 4e-3], [3e-3, 3e-3], [2e-3, 1e-3]])
MANY = TaxelLayout.grid(18, 18, taxel_size_m=5e-4, pitch_m=5e-4)
EVEN = TaxelLayout.grid(2, 2, taxel_size_m=2.5e-3, pitch_m=4e-3)
STIFF, SOFT = StressLaw(1.7, 1e-4), StressLaw(0.6, 1e-4)
cylinder, plane = Cylinder(0.0115), Plane()
rng = np.random.default_rng(0)


def presses(surface, forces, reach=4e-3):
    start = np.tile([0.0, 0.0235, 0.0115 if surface is cylinder else 0.0], (len(forces), 1))
    across, along = rng.uniform(-reach, reach, (2, len(forces)))
    points = surface.offset(start, across, along)
    return Contacts(points, surface.normal_at(points), forces)


def turned(contacts):
    tilt = 0.05 * rng.normal(size=(len(contacts), 3))
    normals = contacts.normals + tilt
    normals /= np.linalg.norm(normals, axis=1)[:, None]
    origins = contacts.points_m + 1e-4 * rng.normal(size=(len(contacts), 3))
    return Contacts(contacts.points_m, normals, contacts.force_n, contact_rotations(contacts.normals), origins)


def press(surface, layout, indenter, contacts, law, precision, resolution, converter=None):
    patch = Patch.build(surface, layout, SensorPose(0.0235, 0.2), resolution, margin_m=3e-3)
    skin = Skin(patch, SkinParameters(4e8, 68.0), converter or Converter.none(), law)
    expected, place = skin.respond(indenter, contacts), contacts.indenter_origins_m
    found = DeviceSkin(skin, indenter, precision=precision, block=8).respond(
        contacts.normals, place, contacts.force_n, contacts.rotations
    )
    image, status = found.image.copy_to_host(), found.status.copy_to_host()
    values = skin.converter.apply(68.0 * expected.loads_n)
    apart = np.abs(image - values) / max(np.nanmax(values), 1e-9)
    depth = np.abs(found.penetration_m.copy_to_host() - expected.penetration_m)
    return {
        "image": float(np.nanmax(apart)), "depth": float(np.nanmax(depth)), "largest": float(np.nanmax(values)),
        "unknown": bool((np.isnan(image) == np.isnan(values)).all()),
        "status": status.tolist(), "expected": expected.status.tolist(), "type": str(image.dtype),
    }


some = [2.0, 0.7]
edge = presses(cylinder, [1.0, 0.0, -1.0, np.nan, 3.0, 400.0])
far = cylinder.offset([[0.0, 0.0235, 0.0115]], 0.0, 0.05)
edge = Contacts(np.r_[edge.points_m, far], np.r_[edge.normals, cylinder.normal_at(far)], np.r_[edge.force_n, 1.0])
cases = {
    "sphere on cylinder": press(cylinder, EVEN, Sphere(6e-3), presses(cylinder, some), None, "double", 1e-3),
    "sphere on plane, law": press(plane, FREE, Sphere(6e-3), presses(plane, some), STIFF, "double", 1e-3),
    "flat on plane": press(plane, EVEN, FlatPunch(3e-3), presses(plane, some), None, "double", 1e-3),
    "flat on cylinder, law": press(cylinder, FREE, FlatPunch(3e-3), presses(cylinder, some), SOFT, "double", 1e-3),
    "turned flat": press(cylinder, EVEN, FlatPunch(3e-3), turned(presses(cylinder, some)), None, "double", 1e-3),
    "turned sphere": press(cylinder, EVEN, Sphere(6e-3), turned(presses(cylinder, some)), None, "single", 1e-3),
    "statuses": press(cylinder, EVEN, Sphere(6e-3), edge, None, "double", 1e-3),
    "finer than points": press(plane, EVEN, Sphere(1e-4), presses(plane, some), None, "double", 2e-3),
    "converter": press(cylinder, EVEN, Sphere(6e-3), presses(cylinder, [2.0, 9.0]), None, "double", 1e-3, Converter()),
    "single precision": press(cylinder, FREE, Sphere(6e-3), presses(cylinder, some), None, "single", 1e-3),
    "many taxels and points": press(plane, MANY, FlatPunch(0.05), presses(plane, [5.0]), None, "double", 2.5e-4),
}
skin = Skin(Patch.build(plane, EVEN, SensorPose(0.0, 0.0), 1e-3), SkinParameters(4e8, 68.0))
device = DeviceSkin(skin, Sphere(6e-3), block=8)
none = device.respond(np.zeros((0, 3)), np.zeros((0, 3)), np.zeros(0))
cases["no presses"] = list(none.image.shape)
image = device._cuda.to_device(np.zeros((2, 4), np.float32))
given = np.tile([0.0, 0.0, 1.0], (2, 1)), np.zeros((2, 3)), np.full(2, 2.0)
device.respond(*given, image=image)
cases["own image"] = [image.copy_to_host().tolist(), device.respond(*given).image.copy_to_host().tolist()]


class Full:
    def __init__(self, cuda):
        self.cuda = cuda

    def __getattr__(self, name):
        return getattr(self.cuda, name)

    def device_array(self, *_):
        raise MemoryError("out of memory")


full = DeviceSkin(skin, Sphere(6e-3), block=8)
full._cuda = Full(full._cuda)
for name, ask in {
    "no memory": lambda: full.respond(*given),
    "wrong precision": lambda: device.respond(*given, image=device._cuda.to_device(np.zeros((2, 4)))),
    "bad shape": lambda: device.respond(np.zeros((2, 3)), np.zeros((3, 3)), np.zeros(2)),
    "mesh": lambda: DeviceSkin(skin, MeshIndenter([[0, 0, 0], [1, 0, 0], [0, 1, 0]], [[0, 1, 2]], closed=False)),
}.items():
    try:
        ask()
    except (ValueError, SkincalError) as error:
        cases[name] = str(error)
print(json.dumps(cases))
"""
CLOSED_FORMS = (
    "sphere on cylinder",
    "sphere on plane, law",
    "flat on plane",
    "flat on cylinder, law",
    "turned flat",
    "many taxels and points",
)


@pytest.fixture(scope="module")
def simulated() -> dict[str, Any]:
    done = subprocess.run(
        [sys.executable, "-c", PRESSES],
        capture_output=True,
        text=True,
        check=False,
        env={**os.environ, "NUMBA_ENABLE_CUDASIM": "1"},
    )
    if "numba.cuda" in done.stderr and "ModuleNotFoundError" in done.stderr:
        pytest.skip("this numba has no simulator of a GPU")
    assert done.returncode == 0, done.stderr
    return json.loads(done.stdout)


@pytest.mark.slow
@pytest.mark.parametrize("case", CLOSED_FORMS)
def test_device_equals_processor(simulated: dict[str, Any], case: str):
    found = simulated[case]
    assert found["image"] < 1e-11
    assert found["depth"] < 1e-14
    assert found["largest"] > 0.1
    assert found["status"] == found["expected"]


@pytest.mark.slow
@pytest.mark.parametrize("case", ["single precision", "turned sphere"])
def test_single_precision_is_close(simulated: dict[str, Any], case: str):
    found = simulated[case]
    assert found["type"] == "float32"
    assert 1e-12 < found["image"] < 1e-5
    assert found["depth"] < 1e-8


@pytest.mark.slow
def test_statuses_of_the_device(simulated: dict[str, Any]):
    found = simulated["statuses"]
    assert found["status"] == found["expected"]
    assert {1, 2, 4, 6} <= set(found["status"])
    assert found["unknown"]
    assert set(simulated["finer than points"]["status"]) == {5}


@pytest.mark.slow
def test_device_converts_to_counts(simulated: dict[str, Any]):
    assert simulated["converter"]["image"] == 0
    assert simulated["converter"]["largest"] > 50


@pytest.mark.slow
def test_device_refuses_with_a_reason(simulated: dict[str, Any]):
    assert simulated["no presses"] == [0, 4]
    assert "origins_m: expected shape (2, 3); got (3, 3)" in simulated["bad shape"]
    assert "closed form" in simulated["mesh"]
    assert "free memory; got: out of memory" in simulated["no memory"]
    assert "image: expected float32; got float64" in simulated["wrong precision"]


@pytest.mark.slow
def test_device_fills_an_image_of_the_callers(simulated: dict[str, Any]):
    mine, new = simulated["own image"]
    assert np.max(mine) > 5
    assert mine == new


def test_no_gpu_is_said():
    patch = Patch.build(
        Plane(), TaxelLayout.grid(1, 1, taxel_size_m=2e-3, pitch_m=3e-3), SensorPose(0.0, 0.0), 1e-3
    )
    from skincal.model.gpu import DeviceSkin

    with pytest.raises(InputError, match=r"skincal\[gpu\]|NVIDIA GPU"):
        DeviceSkin(Skin(patch, SkinParameters(5e8, 60.0)), Sphere(6e-3))


@pytest.mark.parametrize("module", [skincal.model.indenters.sphere, skincal.model.indenters.flat])
def test_single_precision_stays_single(module: Any):
    """A constant in double precision would make all that follows it double, at half the speed or worse."""
    import numba

    from skincal.model.gpu.target import Target

    frame = numba.types.UniTuple(numba.float32, 12)
    for function, given in ((module.meet, (numba.float32,) * 3), (module.paraboloid, ())):
        compiled = numba.njit(Target("single").retarget(function))
        compiled.compile((numba.float32, frame, *given))
        returned = compiled.nopython_signatures[0].return_type
        assert set(returned.types) == {numba.float32}
    assert np.float32 is Target("single").real
