"""The skin of the environments is the model itself, at the values drawn."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from calibrations import make_calibration
from making import BOLT, make
from published import FINGER, LAYOUT

from skincal.envs.bodies import Bolt
from skincal.envs.observations import STACKED
from skincal.envs.pinch import read_pinch
from skincal.envs.tactile import TactileSkin
from skincal.model import Contacts, Converter, MeshIndenter, Patch, SensorPose, Skin, SkinParameters, Sphere
from skincal.ranges import Parameter, from_calibration, preset

STILL = np.zeros(6)


def image(observation: dict[str, np.ndarray]) -> np.ndarray:
    """The newest tactile image in what a policy sees."""
    policy = observation["policy"]
    now = len(policy) // STACKED  # the target at the end has fewer numbers than there are stacked steps
    return policy[(STACKED - 1) * now :][: LAYOUT.taxels]


def direct(env: Any, info: dict[str, Any]) -> np.ndarray:
    """The image of the present contact, from the true state and the draws told in ``info``."""
    drawn, seen = info["randomized"], env.truth
    pose = SensorPose(
        drawn["skin.y_m"], np.radians(drawn["skin.alpha_deg"]), np.radians(drawn["skin.beta_deg"])
    )
    parameters = SkinParameters(drawn["skin.elasticity_pa_per_m"], drawn["skin.scale_per_n"])
    skin = Skin(Patch.build(FINGER, LAYOUT, pose), parameters)
    normal = seen.tip.turned(np.array(seen.skin.normal))
    radius = drawn["object.marble.radius_m"]
    point = seen.tip.inside(seen.body.origin_m) - radius * normal
    values = skin.values(Sphere(radius), Contacts(point[None], normal[None], np.array([seen.skin.force_n])))[
        0
    ]
    counts = values + drawn["skin.taxel_offset_counts"] + info["noise"]["skin.taxel_noise_counts"]
    return Converter().apply(counts)


def test_images_have_offset_and_noise_once() -> None:
    env = make()
    observation, info = env.reset(seed=11)
    for _ in range(4):
        # Both round; a value on the edge of two counts may fall on either side.
        assert np.abs(image(observation) - direct(env, info)).max() <= 1
        assert np.count_nonzero(image(observation) - direct(env, info)) <= 1
        observation, *_, info = env.step(np.full(6, 0.05))
    assert image(observation).sum() > 20


def test_taxels_that_nothing_touches_read_their_offset() -> None:
    env = make()
    values = {"skin.taxel_offset_counts": 20.0, "skin.taxel_noise_counts": 0.0}
    observation, _ = env.reset(seed=0, options={"values": values})
    assert np.count_nonzero(image(observation) == 20) >= 8 and image(observation).min() == 20


def test_patches_of_other_poses_are_those_that_the_model_builds() -> None:
    felt = TactileSkin(read_pinch())
    for pose in (SensorPose(0.0215, 0.25, -0.2), SensorPose(0.0255, -0.2, 0.15)):
        ours, theirs = felt.patch(pose), Patch.build(FINGER, LAYOUT, pose)
        assert np.array_equal(ours.points_m, theirs.points_m) and np.array_equal(ours.taxel, theirs.taxel)
        out = np.array([np.sin(0.1), 0.0, np.cos(0.1)])
        contacts = Contacts((0.0115 * out + [0, 0.024, 0])[None], out[None], np.array([2.0]))
        loads = [Skin(p, SkinParameters(5e8, 68.0)).loads(Sphere(0.006), contacts) for p in (ours, theirs)]
        assert loads[0] == pytest.approx(loads[1], abs=1e-12)


def test_the_bolt_feels_as_its_mesh_however_it_lies() -> None:
    bolt, rng = Bolt(0.006, 0.006), np.random.default_rng(0)
    plain = MeshIndenter(*bolt.mesh())
    skin = Skin(Patch.build(FINGER, LAYOUT, SensorPose(0.0235, 0.1, 0.1)), SkinParameters(5e8, 68.0))
    for _ in range(25):
        turn, lean = rng.uniform(0, 2 * np.pi), rng.normal(0, 0.15)
        axis = np.array([np.cos(turn) * np.cos(lean), np.sin(turn) * np.cos(lean), np.sin(lean)])
        side = np.cross([0.0, 0.0, 1.0], axis)
        side /= np.linalg.norm(side)
        rotation = np.stack([axis, side, np.cross(axis, side)], axis=1)
        origin = np.array([0.0, 0.0235, 0.0175]) + rng.uniform(-0.045, 0.045) * axis
        normal = np.array([0.0, 0.0, 1.0]) + rng.normal(0, 0.1, 3)
        contacts = Contacts(
            np.array([[0.0, 0.0235, 0.0115]]),
            (normal / np.linalg.norm(normal))[None],
            rng.uniform(0.1, 8.0, 1),
            rotation[None],
            origin[None],
        )
        expected = skin.values(plain, contacts)
        assert skin.values(bolt.indenter, contacts) == pytest.approx(expected, abs=1e-9)


def test_a_bolt_is_felt_along_its_axis() -> None:
    env = make(BOLT)
    images = {}
    for angle in (0.0, 90.0):
        asked = {"orientation_deg": angle, "randomize": "none", "values": {"skin.elasticity_pa_per_m": 2e8}}
        observation, info = env.reset(seed=0, options=asked)
        assert info["orientation_rad"] == pytest.approx(np.radians(angle), abs=0.02)
        images[angle] = image(observation).reshape(4, 4)
    # Rows are along the finger: the bolt that lies along it touches more of them.
    assert (images[90.0].sum(axis=1) > 0).sum() > (images[0.0].sum(axis=1) > 0).sum()


def test_ranges_of_a_calibration_take_effect() -> None:
    narrow = {"y_m": (0.0221, 0.0223), "beta_deg": (4.0, 4.2), "alpha_deg": (9.0, 9.5),
              "elasticity_pa_per_m": (2.5e8, 2.6e8), "scale_per_n": (90.0, 91.0)}  # fmt: skip
    calibrated = make(ranges=from_calibration(make_calibration(intervals=narrow)))
    usual = make()
    ours, theirs = calibrated.reset(seed=5), usual.reset(seed=5)
    for name, (low, high) in narrow.items():
        assert low <= ours[1]["randomized"][f"skin.{name}"] <= high
    # The same marble, felt by another skin at another place.
    radius = "object.marble.radius_m"
    assert set(ours[1]["randomized"]) == set(theirs[1]["randomized"])
    assert 0.004 <= ours[1]["randomized"][radius] <= 0.008
    assert np.abs(image(ours[0]) - image(theirs[0])).max() > 20
    expected = direct(calibrated, ours[1])
    assert np.abs(image(ours[0]) - expected).max() <= 1


def test_a_cloud_of_draws_is_drawn_row_by_row() -> None:
    ranges = from_calibration(make_calibration(), joint=True)
    env = make(ranges=ranges)
    info = env.reset(seed=0)[1]["randomized"]
    assert ranges.joint is not None
    row = [info[name] for name in ranges.joint.columns]
    assert any(np.allclose(row, drawn, rtol=1e-12) for drawn in ranges.joint.draws)


def felt_along(env: Any) -> tuple[np.ndarray, np.ndarray]:
    """Images of some steps, and where the object is after them."""
    env.reset(seed=3, options={"values": {"skin.taxel_noise_counts": 0.0}})
    actions = [np.array([0, 0.5 * sign, 0.5 * sign, 0, 0, 0]) for sign in (1, 1, -1, -1)]
    images = np.array([image(env.step(action)[0]) for action in actions])
    return images, env.truth.position_m


@pytest.fixture(scope="module")
def without() -> tuple[np.ndarray, np.ndarray]:
    """The same without effects."""
    return felt_along(make())


@pytest.mark.parametrize(
    ("effect", "parameters"),
    [
        ("cover", {"carried_n": 1.0}),
        ("crosstalk", {"leak": 0.2}),
        ("stiffening", {"exponent": 2.0}),
        ("taxel_gain", {"gain": 2.0}),
        ("creep", {"amplitude": 0.8, "time_constant_s": 0.2}),
        ("latency", {"delay_s": 0.2}),
        ("rate", {"exponent": 0.2}),
        ("hysteresis", {"height": 0.8}),
        ("gain_drift", {"rate_per_s": 2e-3}),
        ("baseline_drift", {"slope_counts_per_s": 0.1}),
    ],
)
def test_effects_of_the_ranges_take_effect(
    effect: str, parameters: dict[str, float], without: tuple[np.ndarray, np.ndarray]
) -> None:
    extra = {f"skin.effects.{effect}.{name}": Parameter.constant(v) for name, v in parameters.items()}
    images, place = felt_along(make(ranges=preset("iros24").replace(extra)))
    assert np.abs(images - without[0]).max() >= 2
    # The skin does not act back on the physics.
    assert np.array_equal(place, without[1])


def test_effects_of_the_rig_are_not_the_skins() -> None:
    extra = {
        "skin.effects.force_bias.offset_n": Parameter.constant(0.5),
        "skin.effects.contact_offset.skew": Parameter.constant(0.1),
    }
    env, plain = make(ranges=preset("iros24").replace(extra)), make()
    assert set(env.ignored_ranges) == set(extra)
    assert np.array_equal(image(env.reset(seed=1)[0]), image(plain.reset(seed=1)[0]))


def test_a_contact_law_that_is_drawn_is_felt() -> None:
    env = make()
    images = []
    for exponent in (1.0, 2.0):
        values = {"skin.contact_law.exponent": exponent, "skin.taxel_noise_counts": 0.0}
        observation, info = env.reset(seed=3, options={"randomize": "none", "values": values})
        assert info["randomized"]["skin.contact_law.exponent"] == exponent
        images.append(image(observation))
    assert (images[0] != images[1]).any()
