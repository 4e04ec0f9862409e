"""Places that are off in a way that goes with something, told from places that are just off."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from gap.made_sessions import OPTIONS, Case, Effects, case, made, pressed

from skincal.gap.choice import Choice
from skincal.gap.models import Material, Model, scene_of
from skincal.gap.place_moves import PlaceMoves, told
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


def measured_across(of: Case) -> np.ndarray:
    """Measured places (P,) of presses across, from the centre [m]."""
    return stretched(of, 1.0)[:, 0]


@cache
def many() -> Case:
    """More presses, with nothing hidden."""
    one = made({}, pressed(48, 6))
    model = Model(refit(one.start, one.session, one.reading, OPTIONS, learn=one.material.known))
    return Case(one, model, scene_of(model, one.material))


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
    assert beside is not None and beside.p_value > 0.02
    # Something else is found beside what a law does.
    more = moved(of, moves + stretched(of, -2 * STRETCH)[:, ::-1] + noise(of, 0, 2e-5))
    found = place_trend(more, material_of(of), [error], np.random.default_rng(0))
    assert found is not None and found.p_value <= SIGNIFICANT


def test_a_trend_must_hold_without_presses_that_may_be_elsewhere():
    of = many()
    model, material = moved(of, stretched(of, STRETCH) + noise(of, 0)), material_of(of)
    out = np.argsort(-np.abs(measured_across(of)))
    doubtful = np.zeros(len(out), dtype=bool)
    doubtful[out[::3]] = True
    trend = place_trend(model, material, [], np.random.default_rng(0), lambda: doubtful)
    assert trend is not None and trend.p_value <= SIGNIFICANT and trend.share > SHARE
    # What the others do not show is none.
    moves = noise(of, 3)
    moves[doubtful] += stretched(of, 3 * STRETCH)[doubtful]
    every = place_trend(moved(of, moves), material, [], np.random.default_rng(0))
    assert every is not None and every.p_value <= SIGNIFICANT
    sure = place_trend(moved(of, moves), material, [], np.random.default_rng(0), lambda: doubtful)
    assert sure is not None and sure.p_value > SIGNIFICANT
    # Too few that are sure say nothing.
    doubtful[out[4:]] = True
    assert place_trend(model, material, [], np.random.default_rng(0), lambda: doubtful) is None


def test_errors_of_what_is_measured_are_no_stretch():
    """Presses that are there have hit the skin: where one was measured too far out, it was found farther in."""
    of = case("none")
    out, share = measured_across(of), 0.6
    error = np.random.default_rng(0).standard_normal(len(out))
    one = np.ones(len(out))
    for known in (one, out):
        error -= known * (known @ error) / (known @ known)
    # So that nothing goes with the place that was found; with the one that was measured a stretch does.
    error *= np.sqrt(share * (1 - share)) * out.std() / error.std()
    moves = noise(of, 1, 2e-5)
    moves[:, 0] += error - share * (out - out.mean())
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


def test_moves_count_with_what_images_tell_of_them():
    """What a fit finds of a press, drawn as it is: each direction of each is as uncertain, and tells the number."""
    of, rng = case("none"), np.random.default_rng(0)
    material = material_of(of)
    prior, n = material.options.place_prior[:2], len(of.model.hypothesis.places)
    rows = np.arange(n)
    size = rng.uniform(0.2, 20.0, (n, 2))
    way = np.linalg.qr(rng.standard_normal((n, 2, 2)))[0]
    seen = np.einsum("rik,rk,rjk->rij", way, size, way)
    column = rng.standard_normal((n, 2, 1)) * prior[:, None]
    share = np.einsum("rik,rk,rjk->rij", way, size / (1 + size), way)
    left: list[np.ndarray] = []
    found: list[float] = []
    for _ in range(200):
        true = 0.5 * column[..., 0] / prior
        drawn = np.einsum("rik,rk,rk->ri", way, np.sqrt(size / (1 + size)), rng.standard_normal((n, 2)))
        model = moved(of, prior * (np.einsum("rij,rj->ri", share, true) + drawn))
        turns = np.zeros((n, 2, 3))
        some = PlaceMoves.of(model, material, [], rows, seen, column, turns)
        x, y = some.columns.ravel(), some.moves.ravel()
        found.append(float(x @ y / (x @ x)))
        left.append(some.moves - 0.5 * some.columns[..., 0])
    scatter = np.einsum("mri,mrj->rij", left, left) / len(left)
    assert np.abs(scatter - np.eye(2)).max() < 0.5 and np.abs(scatter.mean(axis=0) - np.eye(2)).max() < 0.05
    assert np.mean(found) == pytest.approx(0.5, abs=0.04)
    # As exact as it can be: 1 / sqrt of what all presses tell.
    told = float(np.einsum("ri,rij,rj->", column[..., 0] / prior, share, column[..., 0] / prior))
    assert np.std(found) == pytest.approx(told**-0.5, rel=0.2)


def test_a_press_of_which_one_direction_is_not_seen_is_left_out():
    of = case("none")
    material, session = material_of(of), of.made.session
    every, _ = told(of.model, material)
    slopes = of.model.refit.slopes
    blind = slopes.place.copy()
    blind[session.press == every[0], :, 1] = 0.0
    model = replace(of.model, refit=replace(of.model.refit, slopes=replace(slopes, place=blind)))
    rows, seen = told(model, material)
    assert rows.tolist() == every[1:].tolist() and np.linalg.eigvalsh(seen).min() > 1


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
