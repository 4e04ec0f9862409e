"""Places that are off in a way that goes with something, told from places that are just off."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from gap.made_sessions import OPTIONS, Case, Effects, case, made, pressed

from skincal.gap.choose import Choice
from skincal.gap.models import Material, Model
from skincal.gap.places import NAME, SHARE, SIGNIFICANT, place_trend, with_places
from skincal.gap.refit import refit

STRETCH = 0.15


def material_of(of: Case) -> Material:
    """Places are measured to a millimetre: what images say of them is worth more."""
    return replace(of.made.material, options=replace(of.made.material.options, position_sigma_m=1e-3))


def moved(of: Case, places_m: np.ndarray) -> Model:
    """The base model with its presses elsewhere; what its images say of places is the same."""
    here = of.model.hypothesis
    places = np.zeros_like(here.places)
    places[:, :2] = places_m
    return replace(of.model, refit=replace(of.model.refit, hypothesis=replace(here, places=places)))


def stretched(of: Case, stretch: float) -> np.ndarray:
    """Moves (P, 2) of presses that are farther from the centre across than was measured."""
    session, setting = of.made.session, of.model.hypothesis.skin.setting
    moves = np.zeros((len(of.model.hypothesis.places), 2))
    place = (session.samples.contacts.points_m - setting.centre_m) @ setting.axes.T
    for row in range(len(moves)):
        moves[row, 0] = stretch * place[(session.row == row) & session.samples.touching, 0].mean()
    return moves


def noise(of: Case, seed: int, sigma_m: float = 1e-4) -> np.ndarray:
    return sigma_m * np.random.default_rng(seed).standard_normal((len(of.model.hypothesis.places), 2))


def test_a_stretch_is_found_for_what_it_is():
    of = case("none")
    model = moved(of, stretched(of, STRETCH) + noise(of, 0))
    trend = place_trend(model, material_of(of), [], np.random.default_rng(0))
    assert trend is not None
    assert trend.p_value <= SIGNIFICANT and trend.share > SHARE
    found = trend.found.parameters[NAME]
    assert float(found["stretch_across"]) == pytest.approx(STRETCH, abs=0.06)
    assert abs(float(found["stretch_along"])) < 0.06 and abs(float(found["skew"])) < 0.06
    # What goes with all places alike, or turns them all, is the sensor's pose.
    made = stretched(of, STRETCH)
    assert 0 < trend.rms_m < 1.3 * np.sqrt(((made - made.mean(axis=0)) ** 2).sum(axis=1).mean())


def test_a_pose_and_noise_are_no_trend():
    of = case("none")
    chances: list[float] = []
    for seed in range(12):
        model = moved(of, noise(of, seed) + np.array([4e-4, -2e-4]))
        trend = place_trend(model, material_of(of), [], np.random.default_rng(seed))
        assert trend is not None
        chances.append(trend.p_value)
    assert min(chances) > SIGNIFICANT
    assert 0.2 < np.mean(chances) < 0.8


def test_what_a_law_does_to_places_is_no_trend():
    of = case("none")
    moves = stretched(of, STRETCH)
    model = moved(of, moves + noise(of, 0, 2e-5))
    slopes, session = of.model.refit.slopes, of.made.session
    own = np.where((session.press >= 0)[:, None], moves[np.maximum(session.press, 0)], 0.0)
    error = (slopes.place[..., :2] * own[:, None, :]).sum(axis=-1)
    alone = place_trend(model, material_of(of), [], np.random.default_rng(0))
    beside = place_trend(model, material_of(of), [error], np.random.default_rng(0))
    assert alone is not None and alone.p_value <= SIGNIFICANT
    assert beside is not None and beside.p_value > 0.02 and beside.rms_m < 0.2 * alone.rms_m
    # Something else is found beside what a law does.
    more = moved(of, moves + stretched(of, -2 * STRETCH)[:, ::-1] + noise(of, 0, 2e-5))
    found = place_trend(more, material_of(of), [error], np.random.default_rng(0))
    assert found is not None and found.p_value <= SIGNIFICANT


def test_presses_that_may_be_elsewhere_say_nothing():
    of = case("none")
    model, material = moved(of, stretched(of, STRETCH) + noise(of, 0)), material_of(of)
    doubtful = np.zeros(len(model.hypothesis.places), dtype=bool)
    assert place_trend(model, material, [], np.random.default_rng(0), lambda: doubtful) is not None
    doubtful[np.unique(of.made.session.press)[1:9]] = True
    # Too few are left for nine numbers.
    assert place_trend(model, material, [], np.random.default_rng(0), lambda: doubtful) is None


def placed(of: Case) -> np.ndarray:
    """Measured places (P, 2) of presses from the centre."""
    return stretched(of, 1.0)[:, :1]


def test_errors_of_what_is_measured_are_no_stretch():
    """Presses that are there have hit the skin: where one was measured too far out, it was found farther in."""
    of = case("none")
    out, share = placed(of), 0.6
    error = np.random.default_rng(0).standard_normal(len(out))
    one = np.ones(len(out))
    for known in (one, out[:, 0]):
        error -= known * (known @ error) / (known @ known)
    # So that nothing goes with the place that was found; with the one that was measured a stretch does.
    error *= np.sqrt(share * (1 - share)) * out.std() / error.std()
    moves = noise(of, 1, 2e-5)
    moves[:, 0] += error - share * (out[:, 0] - out.mean())
    trend = place_trend(moved(of, moves), material_of(of), [], np.random.default_rng(0))
    assert trend is not None and trend.p_value > SIGNIFICANT
    moves[:, 0] -= error
    trend = place_trend(moved(of, moves), material_of(of), [], np.random.default_rng(0))
    assert trend is not None and trend.p_value <= SIGNIFICANT


def test_offsets_of_poses_have_nothing_in_common():
    """What all poses have in common is where the sensor is, to the last digit: it must not take up anything else."""
    of = case("none")
    session, pose = of.made.session, of.made.session.samples.pose
    own = np.array([pose[session.row == row][0] for row in range(len(of.model.hypothesis.places))])
    moves = noise(of, 0, 1e-4)
    moves[:, 0] += np.where(own == own[0], 4e-4, 0.0)
    trend = place_trend(moved(of, moves), material_of(of), [], np.random.default_rng(0))
    assert trend is not None and trend.p_value <= SIGNIFICANT
    found = trend.found.parameters[NAME]
    for number, size in (("pose_across_m", 4e-4), ("pose_along_m", 0.0)):
        offsets = np.asarray(found[number])
        assert abs(offsets.sum()) < 1e-7
        assert np.ptp(offsets) == pytest.approx(size, abs=1.5e-4)


def test_a_trend_of_doubtful_presses_alone_is_none():
    of = case("none")
    doubtful = np.zeros(len(of.model.hypothesis.places), dtype=bool)
    doubtful[np.argsort(-np.abs(placed(of)[:, 0]))[: len(doubtful) // 3]] = True
    moves = noise(of, 3, 3e-5)
    moves[doubtful] += stretched(of, 2 * STRETCH)[doubtful]
    every = place_trend(moved(of, moves), material_of(of), [], np.random.default_rng(0))
    assert every is not None and every.p_value <= SIGNIFICANT
    sure = place_trend(moved(of, moves), material_of(of), [], np.random.default_rng(0), lambda: doubtful)
    assert sure is None or sure.p_value > SIGNIFICANT


def wide(effects: Effects) -> tuple[Choice, Material]:
    """A session whose presses are told to a millimetre, and the fit of the base model."""
    one = made(effects, pressed(48, 6), exact=True)
    options = replace(OPTIONS, position_sigma_m=1e-3)
    material = replace(one.material, options=options)
    model = Model(refit(one.start, one.session, one.reading, options, learn=material.known))
    return Choice(model, model, (), (), (10.0, 10.0)), material


def test_it_is_named_beside_what_the_images_show():
    plain, material = wide({})
    assert with_places(plain, material, [], 1.0, np.random.default_rng(0)) is plain
    choice, material = wide({"contact_offset": {"stretch_across": STRETCH, "stretch_along": -STRETCH}})
    found = with_places(choice, material, [], 1.0, np.random.default_rng(0))
    assert [one.name for one in found.named] == [NAME] and found.after.names == (NAME,)
    again = with_places(found, material, [], 1.0, np.random.default_rng(0))
    assert again is found
