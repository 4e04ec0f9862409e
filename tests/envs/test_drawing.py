"""Domain randomization draws every parameter of the table from checked ranges."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from calibrations import on_a_plane
from making import BOLT, MARBLE, make

from skincal.envs.drawing import ranges_for
from skincal.errors import InputError
from skincal.ranges import Parameter, Ranges, from_calibration, preset, write_ranges


def draws(env: Any, seeds: range, **options: Any) -> list[dict[str, Any]]:
    infos = [env.reset(seed=seed, options=options)[1] for seed in seeds]
    return [info["randomized"] | info["noise"] for info in infos]


@pytest.mark.parametrize(("name", "kind"), [(MARBLE, "marble"), (BOLT, "bolt")])
def test_every_parameter_is_drawn_from_its_range(name: str, kind: str) -> None:
    ranges = preset("iros24")
    concerned = [p for p in ranges if not p.startswith("object.") or p.startswith(f"object.{kind}.")]
    seen = draws(make(name), range(8))
    for path in concerned:
        parameter = ranges[path]
        values = np.array([np.ravel(info[path]) for info in seen])
        if parameter.distribution == "constant":
            assert np.all(values == parameter.value), path
            continue
        assert values.std(axis=0).min() > 0, path
        if parameter.low is not None:
            assert values.min() >= parameter.low and values.max() <= parameter.high, path


def test_one_seed_gives_every_policy_the_same_marble() -> None:
    seen = {p: draws(make(policy=p), range(2, 4)) for p in ("tactile", "joint-angles", "desired")}
    for path in ("object.marble.radius_m", "finger.k_p_nm_per_rad", "finger.joint_offset_rad"):
        assert np.all(seen["tactile"][0][path] == seen["desired"][0][path])
        assert np.all(seen["tactile"][0][path] == seen["joint-angles"][0][path])
    for policy in ("joint-angles", "desired"):
        pose = [[info[f"skin.{name}"] for name in ("y_m", "beta_deg", "alpha_deg")] for info in seen[policy]]
        assert pose == [[0.0235, 0.0, 0.0]] * 2
    assert seen["tactile"][0]["skin.y_m"] != seen["tactile"][1]["skin.y_m"]


def test_nothing_randomized_is_the_middle_of_every_range() -> None:
    first, second = draws(make(), range(2), randomize="none")
    assert all(np.all(first[path] == second[path]) for path in first)
    assert first["object.marble.radius_m"] == pytest.approx(0.006)
    assert first["object.marble.spinning_friction"] == pytest.approx(np.sqrt(2e-3 * 2e-2))
    assert first["skin.elasticity_pa_per_m"] == pytest.approx(542e6)
    for path in ("finger.joint_offset_rad", "finger.joint_noise_rad", "skin.taxel_noise_counts",
                 "skin.taxel_offset_counts", "object.marble.random_force_n"):  # fmt: skip
        assert np.all(first[path] == 0), path


def test_tables_and_single_values_can_be_asked_for() -> None:
    env = make()
    asked = {
        "randomize": ["finger.joint_offset_rad"],
        "values": {"skin.y_m": 0.022, "object.marble.mass_kg": 0.01},
    }
    first, second = draws(env, range(2), **asked)
    assert np.any(first["finger.joint_offset_rad"] != second["finger.joint_offset_rad"])
    assert first["finger.k_p_nm_per_rad"] == pytest.approx(5.0)
    assert (first["skin.y_m"], first["object.marble.mass_kg"]) == (0.022, 0.01)


def test_ranges_come_from_a_file_and_take_effect(tmp_path: Path) -> None:
    path = tmp_path / "ranges.toml"
    narrow = Parameter.uniform(5.0e8, 5.1e8, source="calibrated")
    write_ranges(preset("iros24").replace({"skin.elasticity_pa_per_m": narrow}), path)
    values = [info["skin.elasticity_pa_per_m"] for info in draws(make(ranges=path), range(6))]
    assert 5.0e8 <= min(values) < max(values) <= 5.1e8


@pytest.mark.parametrize("name", [MARBLE, BOLT])
def test_the_other_preset_works_as_it_is(name: str) -> None:
    info = draws(make(name, ranges="icra26"), range(1))[0]
    kind = "marble" if name == MARBLE else "bolt"
    assert info[f"object.{kind}.mass_kg"] == pytest.approx({"marble": 0.004, "bolt": 0.006}[kind])


@pytest.mark.parametrize(
    "path", ["finger.k_p_nm_per_rad", "object.marble.mass_kg", "skin.y_m", "skin.taxel_noise_counts"]
)
def test_a_missing_parameter_is_named_and_described(tmp_path: Path, path: str) -> None:
    file = tmp_path / "mine.toml"
    rest = {p: parameter for p, parameter in preset("iros24").items() if p != path}
    write_ranges(Ranges(rest, provenance={"preset": "iros24"}), file)
    with pytest.raises(
        InputError, match=rf"mine.toml, \[{path}\]: expected .*got no such table. Add the table"
    ):
        make(ranges=file)


def test_what_cannot_change_in_a_step_is_refused() -> None:
    ranges = preset("iros24").replace({"finger.k_p_nm_per_rad": Parameter.uniform(4.8, 5.2, mode="step")})
    with pytest.raises(InputError, match=r"\[finger.k_p_nm_per_rad\] mode: expected episode"):
        make(ranges=ranges)


def test_lists_that_do_not_fit_the_hand_are_refused() -> None:
    ranges = preset("iros24").replace({"finger.k_p_nm_per_rad": Parameter.constant((5.0, 5.0))})
    with pytest.raises(InputError, match=r"finger\.k_p_nm_per_rad holds 2 numbers"):
        make(ranges=ranges)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"trajektory": "circle"}, 'options, trajektory: expected one of .*Did you mean "trajectory"'),
        ({"trajectory": "square"}, "options, trajectory: expected one of random, circle, still, or targets"),
        ({"trajectory": np.zeros((3, 3))}, "options, trajectory"),
        ({"duration_s": -1.0}, "options, duration_s: expected a number between"),
        ({"randomize": ["finger.k_q"]}, "options randomize: expected tables"),
        ({"randomize": 3}, "options, randomize"),
        ({"values": {"skin.y": 0.02}}, "options values: expected one of"),
        ({"values": {"skin.y_m": 23.5}}, "options values skin.y_m: expected -1 to 1 m"),
        ({"values": {"skin.y_m": np.nan}}, "options values skin.y_m"),
        ({"orientation_deg": "across"}, "options, orientation_deg"),
    ],
)
def test_options_that_make_no_sense_are_refused_in_words(options: dict[str, Any], message: str) -> None:
    env = make(policy="desired")
    with pytest.raises(InputError, match=message):
        env.reset(options=options)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"policy": "blind"}, "policy: expected one of tactile, joint-angles, desired"),
        ({"ranges": "no/such.toml"}, "no/such.toml: expected a ranges file; got no such file"),
        (
            {"speed_rad_per_second": 1.0},
            'environment, speed_rad_per_second: .*Did you mean "speed_rad_per_s"',
        ),
        ({"duration_s": 0}, "environment, duration_s: expected a number > 0"),
        (
            {"solver_iterations": 2.5},
            "environment, solver_iterations: expected a whole number > 0, below 10000",
        ),
        ({"hand": "/nowhere"}, "no such file"),
    ],
)
def test_arguments_that_make_no_sense_are_refused_in_words(arguments: dict[str, Any], message: str) -> None:
    with pytest.raises(InputError, match=message):
        make(**arguments)


@pytest.mark.parametrize("task", ["marble", "bolt"])
def test_ranges_of_a_flat_pad_are_refused_with_the_reason(tmp_path: Path, task):
    write_ranges(from_calibration(on_a_plane()), tmp_path / "ranges.toml")
    with pytest.raises(InputError) as refused:
        ranges_for(task, tmp_path / "ranges.toml")
    assert "flat pad" in str(refused.value)
    assert "ranges.toml" in str(refused.value)
    assert "Add the table" not in str(refused.value)
