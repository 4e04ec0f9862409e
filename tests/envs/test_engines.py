"""Scenes: contact points made one, and the same task in both physics engines."""

from __future__ import annotations

import math
import pickle
from typing import Any

import numpy as np
import pytest
from making import BOLT, MARBLE, make

from skincal.envs.bodies import Bolt, Marble
from skincal.envs.pinch import read_pinch
from skincal.envs.scene import Point, make_scene, merged
from skincal.errors import InputError


@pytest.fixture
def mujoco() -> None:
    pytest.importorskip("mujoco", reason="needs skincal[mujoco]")


def test_an_engine_that_does_not_exist_is_refused() -> None:
    with pytest.raises(InputError, match="expected pybullet or mujoco; got 'bullet3'"):
        make(engine="bullet3")


def test_only_pybullet_makes_pictures() -> None:
    with pytest.raises(InputError, match="mujoco makes no pictures"):
        make(engine="mujoco", render_mode="rgb_array")


def test_a_missing_engine_is_reported_how_to_install(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(__import__("sys").modules, "mujoco", None)
    with pytest.raises(InputError, match=r"pip install 'skincal\[mujoco\]'"):
        make_scene("mujoco", read_pinch(None), 20)


def test_bodies_are_the_same_in_both() -> None:
    assert [part.radius_m for part in Marble(6e-3, 4e-3).parts] == [6e-3]
    shank, head = Bolt(6e-3, 6e-3).parts
    assert shank.length_m == pytest.approx(0.07) and head.radius_m == pytest.approx(9e-3)
    assert head.at_m - head.length_m / 2 == pytest.approx(shank.at_m + shank.length_m / 2)


@pytest.mark.usefixtures("mujoco")
def test_a_grasp_presses_alike() -> None:
    seen = {}
    for engine in ("pybullet", "mujoco"):
        env = make(engine=engine)
        env.reset(seed=3, options={"trajectory": "still"})
        for _ in range(10):
            env.step(np.zeros(6))
        truth = env.truth
        assert truth.skin is not None and truth.thumb is not None and not truth.dropped
        seen[engine] = (truth.skin.force_n, truth.position_m, env.image, np.array(truth.skin.normal))
    (force, place, image, normal), (force_2, place_2, image_2, normal_2) = seen["pybullet"], seen["mujoco"]
    assert force_2 == pytest.approx(force, rel=0.1)
    assert np.linalg.norm(place - place_2) < 0.5e-3
    assert np.corrcoef(image, image_2)[0, 1] > 0.98
    assert normal @ normal_2 > 0.999


@pytest.mark.parametrize("name", [MARBLE, BOLT])
@pytest.mark.usefixtures("mujoco")
def test_a_pull_moves_the_object_alike(name: str) -> None:
    """Mass, inertia and where its centre is, friction of both fingers, and how they yield."""
    moved = {}
    for engine in ("pybullet", "mujoco"):
        env = make(name, engine=engine, policy="desired")
        env.reset(seed=1, options={"randomize": "none"} | ({"orientation_deg": 45.0} if name == BOLT else {}))
        for _ in range(5):
            env.step(np.zeros(6))
        scene, before = env.world.scene, env.truth
        scene.force_n = (np.array(scene.force_n) + before.tip.rotation[:, 1]).tolist()
        scene.run(30)
        moved[engine] = before.tip.turned(scene.object_frame().origin_m - before.body.origin_m)
        assert None not in scene.touches()
    assert np.linalg.norm(moved["pybullet"]) > 0.4e-3
    np.testing.assert_allclose(moved["mujoco"], moved["pybullet"], atol=0.03e-3)


@pytest.mark.usefixtures("mujoco")
def test_every_contact_has_the_friction_of_its_pair() -> None:
    env = make(engine="mujoco", policy="desired")
    env.reset(seed=0, options={"randomize": "none", "values": {"finger.lateral_friction": 0.5}})
    model, tips = env.world.scene._model, sorted(env.world.scene._tip_geoms)
    expected = 0.5 * env.world.values["object.marble.lateral_friction"]
    for pair in range(model.npair):
        of_tips = sorted([model.pair_geom1[pair], model.pair_geom2[pair]]) == tips
        assert model.pair_friction[pair, 0] == pytest.approx(0.25 if of_tips else expected)
        assert model.pair_dim[pair] == (3 if of_tips else 4)


@pytest.mark.usefixtures("mujoco")
def test_a_bolt_along_the_finger_lies_on_a_line() -> None:
    env, points = make(BOLT, engine="mujoco", policy="desired"), []
    env.reset(seed=0, options={"randomize": "none", "orientation_deg": 90.0})
    start = env.truth.position_m
    for _ in range(10):
        env.step(np.zeros(6))
        points.append(env.truth.skin.points)
    assert np.mean(points) > 2
    assert np.linalg.norm(env.truth.position_m - start) < 0.2e-3


@pytest.mark.usefixtures("mujoco")
def test_contact_is_the_spring_that_was_asked_for() -> None:
    """Force over depth is the grip's stiffness, however heavy the bodies are."""
    env = make(engine="mujoco", policy="desired")
    for mass in (3e-3, 30e-3):
        env.reset(seed=0, options={"randomize": "none", "values": {"object.marble.mass_kg": mass}})
        for _ in range(10):
            env.step(np.zeros(6))
        scene = env.world.scene
        touching = [c for c in scene._data.contact if c.dist < 0]
        skin, thumb = scene.touches()
        stiffness = (skin.force_n + thumb.force_n) / -sum(c.dist for c in touching)
        across = 1 / (1 / 6e-3 + 1 / 11.5e-3)
        elasticity = env.world.values["skin.elasticity_pa_per_m"]
        expected = np.sqrt(np.pi * elasticity * np.sqrt(6e-3 * across) * env.options.grasp.stiffness_at_n)
        assert stiffness == pytest.approx(expected, rel=0.02)


@pytest.mark.usefixtures("mujoco")
def test_a_seed_gives_the_same_episode_to_the_last_bit() -> None:
    env, places = make(engine="mujoco"), []
    for seed in (5, 6, 5):
        env.reset(seed=seed)
        places.append([env.step(np.full(6, 0.1))[4]["position_m"] for _ in range(5)])
    np.testing.assert_array_equal(places[0], places[2])


@pytest.mark.usefixtures("mujoco")
def test_a_copy_has_the_same_engine() -> None:
    copied = pickle.loads(pickle.dumps(make(engine="mujoco", policy="desired")))
    assert copied.engine == "mujoco" and copied.policy == "desired"


@pytest.mark.parametrize("name", [MARBLE, BOLT])
@pytest.mark.usefixtures("mujoco")
def test_extreme_actions_end_in_a_drop_and_print_nothing(
    name: str, capfd: pytest.CaptureFixture[str], tmp_path: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    env, rng = make(name, engine="mujoco"), np.random.default_rng(0)
    env.reset(seed=0)
    ended = False
    while not ended:
        observation, reward, terminated, truncated, _ = env.step(rng.choice([-1.0, 1.0, np.nan], 6))
        ended = terminated or truncated
        assert env.observation_space.contains(observation) and np.isfinite(reward)
    assert capfd.readouterr() == ("", "") and not list(tmp_path.iterdir())


def row(
    force: float,
    place: tuple[float, float, float] = (0.0, 0.0, 0.0),
    normal: tuple[float, float, float] = (0.0, 0.0, 1.0),
    friction: float = 0.0,
) -> Point:
    return Point(place, normal, force, (friction, 0.0, 0.0))


def test_it_does_not_matter_how_many_points_carry_a_force() -> None:
    one = merged([row(2.0, (0.0, 0.01, 0.0), friction=0.4)], 100.0)
    many = merged([row(0.5, (0.0, 0.01, 0.0), friction=0.1) for _ in range(4)], 100.0)
    assert one is not None and many is not None
    assert many.force_n == pytest.approx(one.force_n)
    assert many.point_m == pytest.approx(one.point_m)
    assert many.normal == pytest.approx(one.normal) and one.normal == (0.0, 0.0, 1.0)
    assert many.friction_n == pytest.approx(one.friction_n)
    assert (one.points, many.points) == (1, 4)


def test_points_count_by_their_force() -> None:
    tilted = (math.sin(0.4), 0.0, math.cos(0.4))
    found = merged([row(3.0, (0.0, 0.0, 0.0)), row(1.0, (0.0, 0.008, 0.0), tilted)], 100.0)
    assert found is not None
    assert found.force_n == pytest.approx(4.0)
    assert found.point_m == pytest.approx((0.0, 0.002, 0.0))
    mean = 3.0 * np.array([0.0, 0.0, 1.0]) + 1.0 * np.array(tilted)
    assert found.normal == pytest.approx(tuple(mean / np.linalg.norm(mean)))


@pytest.mark.parametrize(
    "bad",
    [
        row(math.nan),
        row(math.inf),
        row(1e6),
        row(-1.0),
        row(0.0),
        row(1.0, (math.nan, 0.0, 0.0)),
        row(1.0, normal=(math.nan, 0.0, 1.0)),
        row(1.0, normal=(0.0, 0.0, 2.0)),
        row(1.0, friction=math.nan),
    ],
)
def test_implausible_contacts_are_left_out(bad: Point) -> None:
    assert merged([bad], 100.0) is None
    found = merged([bad, row(1.5, (0.0, 0.01, 0.0))], 100.0)
    assert found is not None and found.force_n == 1.5 and found.points == 1


def test_no_points_are_no_contact() -> None:
    assert merged([], 100.0) is None
