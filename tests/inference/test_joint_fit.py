"""The joint fit: what tells a turn of the sensor, places of presses, errors of equations."""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from inference.made import KINDS, made
from report.diagnosis_cases import calibration

from skincal.diagnosis.gap import measure_gap, place_presses
from skincal.diagnosis.observed import Observed, observe
from skincal.effects import effect
from skincal.inference.columns import free_parameters
from skincal.inference.fit import Fitter
from skincal.inference.forward import BASE, LAW, Forward
from skincal.inference.score import folds_of
from skincal.inference.start import candidate_placements, relocate_presses


@cache
def seen(kind: str) -> Observed:
    """A kind of session, as the engine takes it."""
    data = made(**KINDS[kind])  # type: ignore[arg-type]
    return observe(data, replace(calibration(), sensor=data.meta.sensor), np.random.default_rng(0))


def test_points_that_come_and_go_do_not_tell_a_turn():
    observed, sd = seen("nothing"), []
    own = observed.fitter.forward
    for resolution in (2e-4, 6e-4):
        forward = Forward(
            own.session,
            own.surface,
            own.layout,
            own.noise,
            clipped=own.rests_clipped,
            resolution_m=resolution,
        )
        fit = Fitter(forward, observed.fitter.counts, observed.fitter.priors).linearise(
            observed.fitter.priors.start, ()
        )
        sd.append(np.sqrt(fit.covariance[2, 2]))
    assert sd[1] == pytest.approx(sd[0], rel=0.15)


def sliding() -> Forward:
    """The model of a session whose contacts slide by 0.4 mm as the force grows."""
    own = seen("nothing").fitter.forward
    samples = own.session.samples
    force = np.where(samples.touching, np.nan_to_num(samples.contacts.force_n), 0.0)
    far = 4e-4 * force / force.max()
    points = samples.contacts.points_m.copy()
    on = samples.touching & np.isfinite(points).all(axis=1)
    points[on] = own.surface.offset(own.surface.project(points[on]), far[on], -far[on] / 2)
    moved = replace(samples, contacts=replace(samples.contacts, points_m=points))
    return Forward(
        replace(own.session, samples=moved), own.surface, own.layout, own.noise, clipped=own.rests_clipped
    )


@pytest.mark.parametrize("column", ["elasticity", *LAW])
def test_slopes_of_presses_that_slide_are_what_differences_say(column: str):
    forward, ways = sliding(), [*BASE, *LAW]
    state = replace(seen("nothing").fitter.priors.start, law=np.array([-0.1, 0.1, 0.1, 0.3]))
    by = forward.base_columns(forward.predict(state))[..., ways.index(column)]
    if column == "elasticity":
        ends = [replace(state, log_e=state.log_e + h) for h in (0.02, -0.02)]
    else:
        one = np.eye(len(LAW))[LAW.index(column)]
        ends = [replace(state, law=state.law + h * one) for h in (0.02, -0.02)]
    more, less = (forward.predict(end).values for end in ends)
    apart = (more - less) / 0.04
    assert np.sqrt(np.mean((by - apart) ** 2)) < 0.03 * np.sqrt(np.mean(apart**2))


def test_a_turn_is_what_differences_say():
    fitter = seen("nothing").fitter
    forward, state = fitter.forward, fitter.priors.start
    column = forward.base_columns(forward.predict(state))[..., 2]
    ends = [
        forward.predict(replace(state, pose=replace(state.pose, alpha_rad=state.pose.alpha_rad + h))).values
        for h in (0.02, -0.02)
    ]
    apart = (ends[0] - ends[1]) / 0.04
    assert np.sqrt(np.mean((column - apart) ** 2)) < 0.05 * np.sqrt(np.mean(apart**2))


def test_slopes_by_elasticity_and_law_match_differences():
    # Anywhere between laws: a harder skin and a larger ball do nearly alike, so each must be right by itself.
    fitter = seen("nothing").fitter
    forward = fitter.forward
    state = replace(fitter.priors.start, law=np.array([-0.03, 0.3, 0.02, 0.4]))
    columns = forward.base_columns(forward.predict(state))
    numbers = [("log_e", 3, 0.015), *((k, 6 + k, h) for k, h in enumerate((0.05, 0.1, 0.015, 0.1)))]
    for name, column, h in numbers:
        ends = [
            replace(state, log_e=state.log_e + step)
            if name == "log_e"
            else replace(state, law=state.law + step * np.eye(len(LAW))[column - 6])
            for step in (h, -h)
        ]
        apart = (forward.predict(ends[0]).values - forward.predict(ends[1]).values) / (2 * h)
        off = np.sqrt(np.mean((columns[..., column] - apart) ** 2) / np.mean(apart**2))
        assert off < 0.01, (name, off)


def test_slopes_between_taxels_are_bounded():
    # On a hard skin a ball meets what no taxel feels, but where that is spread.
    fitter = seen("nothing").fitter
    start, rng = fitter.priors.start, np.random.default_rng(22)
    move = start.move.copy()
    move[:, :2] = rng.uniform(-1.2e-3, 1.2e-3, (len(move), 2))
    law = np.array([-0.6, -0.3, -0.15, 0.0])
    felt = fitter.forward.predict(replace(start, law=law, log_e=start.log_e + 4, move=move))
    columns = fitter.forward.base_columns(felt)
    assert np.abs(columns[..., 6:]).max() < 3 * felt.values.max()


def test_small_steps_of_positions_change_images_in_proportion():
    # Presses follow such a step; what they cannot follow is what bends, and would tell against it.
    fitter = seen("nothing").fitter
    forward, state = fitter.forward, fitter.priors.start
    at = forward.predict(state)
    scene: Any = SimpleNamespace(poses=1)
    for start in effect("contact_offset").starts(scene):
        for point in start.points:
            whole, half = (
                forward.with_effects(at, {"contact_offset": {k: part * v for k, v in point.items()}})
                - at.values
                for part in (1.0, 0.5)
            )
            assert np.abs(whole).max() > 0
            assert np.sqrt(np.mean((whole - 2 * half) ** 2) / np.mean(whole**2)) < 5e-3


def test_moving_presses_back_undoes_a_shift():
    fitter = seen("nothing").fitter
    forward, state = fitter.forward, fitter.priors.start
    other = replace(state, effects={"contact_offset": {"stretch_along": np.array(0.05)}})
    back = state.move.copy()
    back[:, :2] -= forward.contact_shifts(other)
    was, moved, is_back = (forward.predict(x).values for x in (state, other, replace(other, move=back)))
    assert np.abs(moved - was).max() > 5
    assert np.abs(is_back - was).max() < 0.5


def test_the_others_go_where_a_number_at_its_bound_leaves_them():
    fitter = seen("nothing").fitter
    state = replace(fitter.priors.start, law=np.zeros(len(LAW)))
    less = fitter.forward.predict(replace(state, law=np.array([-0.05, 0.0, 0.0, -0.45])))
    told = Fitter(fitter.forward, fitter.expected(less)[0], fitter.priors)
    at = told.linearise(state, ())
    h, g = at.blocks.h.sum(axis=0) + np.diag(at.prior), at.blocks.b.sum(axis=0) - at.pull
    assert np.linalg.solve(h, g)[-1] < -0.02
    new = told.moved(at, told.gauss_newton_step(at))
    assert new.law[-1] == 0
    assert new.law[:3] == pytest.approx(np.linalg.solve(h[:-1, :-1], g[:-1])[6:9], rel=1e-3)


def test_what_memory_keeps_of_a_press_does_not_tell_the_pose():
    fitter, sd = seen("creep").fitter, []
    creep = effect("creep").checked({"amplitude": 0.4, "time_constant_s": 3.0}, fitter.counts.shape[1])
    for effects in ({}, {"creep": dict(creep)}):
        state = replace(fitter.priors.start, effects=effects)
        sd.append(np.sqrt(np.diag(fitter.linearise(state, (), word=True).covariance))[:3])
    assert (sd[1] > 0.8 * sd[0]).all()


@pytest.mark.parametrize("kind", ["law", "taxel_gain", "creep"])
def test_a_press_is_found_by_the_chain_as_it_is(kind: str):
    """Wherever it was thought to be: what the law and effects do to its image is what they do at each place."""
    fitter = seen("nothing").fitter
    state = fitter.priors.start
    if kind == "law":
        state = replace(state, law=np.array([-0.6, 0.0, 0.0, 0.0]), log_e=state.log_e + 1.0)
    elif kind == "taxel_gain":
        gain = np.exp(0.7 * np.random.default_rng(3).standard_normal(fitter.counts.shape[1]))
        state = replace(state, effects={"taxel_gain": {"gain": gain}})
    else:
        creep = effect("creep").checked({"amplitude": 0.5, "time_constant_s": 1.0}, fitter.counts.shape[1])
        state = replace(state, effects={"creep": dict(creep)})
    at = replace(state, move=np.zeros_like(state.move))
    told = Fitter(fitter.forward, fitter.expected(fitter.forward.predict(at))[0], fitter.priors)
    rows = np.unique(fitter.press[fitter.press >= 0])
    lost = state.move.copy()
    lost[rows, :2] = fitter.priors.slack_m * 0.6
    found = candidate_placements(told, replace(state, move=lost), rows)[0].move[rows, :2]
    assert (np.linalg.norm(found, axis=1) < 0.3 * fitter.priors.slack_m).mean() > 0.9


def test_a_press_no_model_can_follow_has_no_part_in_the_gap():
    observed = seen("hysteresis")
    row = int(np.flatnonzero(observed.is_test)[0])
    counts = observed.session.counts
    assert counts is not None
    image = counts[observed.session.press == row]
    counts[observed.session.press == row] = image[:, ::-1]
    gap = measure_gap(
        observed, observed.fitter.priors.start, observed.fitter.priors.start, np.random.default_rng(0)
    )
    counts[observed.session.press == row] = image
    assert row not in gap.presses
    assert len(gap.presses) == observed.is_test.sum() - 1


def test_presses_kept_for_the_end_are_placed_where_they_fit():
    observed = seen("hysteresis")
    whole, rows = observed.fitter_of_all(), np.flatnonzero(observed.is_test)
    state = observed.fitter.priors.start
    own = place_presses(whole, state, rows)
    left = misfit(whole, own)[rows]
    for step in (2e-4, -2e-4):
        for axis in (0, 1):
            move = own.move.copy()
            move[rows, axis] += step
            assert (left <= misfit(whole, replace(own, move=move))[rows] + 1.0).all()
    # From where another model has them they come to places that are no worse, but for tables made elsewhere.
    far = replace(state, move=np.full_like(state.move, 3e-4))
    assert (misfit(whole, place_presses(whole, state, rows, [far]))[rows] <= left + 5.0).all()
    # A placement that goes on from an earlier one loses nothing, wherever the state has its presses.
    lost = replace(state, move=state.move + whole.priors.slack_m * np.array([0.6, 0.6, 0.0]))
    again = place_presses(whole, lost, rows, placed=own)
    assert (misfit(whole, replace(own, move=again.move))[rows] <= left + 0.1).all()


def misfit(fitter: Fitter, state) -> np.ndarray:  # type: ignore[no-untyped-def]
    """(P,) squares over the noise and of what is known of places."""
    sight = fitter.forward.predict(state)
    none = np.zeros((*sight.values.shape, 0))
    w = fitter.whitened(sight, none, none)
    each = (w.residual**2 + np.where(w.seen, 2 * w.log_sd, 0.0)).sum(axis=1)
    own = fitter.press >= 0
    return (
        np.bincount(fitter.press[own], each[own], fitter.forward.presses) + state.move**2 @ fitter.priors.move
    )


def test_common_equation_error_widens_what_depends_on_it():
    observed = seen("saturation")
    fitter, effects = observed.fitter, KINDS["saturation"]["effects"]
    values = {k: np.asarray(v) for k, v in effects["saturation"].items()}  # type: ignore[index]
    state = replace(fitter.priors.start, effects={"saturation": values})
    free = tuple(free_parameters("saturation", values, None, observed.covariates))
    narrow, wide = (fitter.linearise(state, free, word=word).covariance for word in (True, False))
    assert (np.diag(wide) >= np.diag(narrow) * (1 - 1e-6)).all()
    # The effect itself is known no better than its equation.
    assert wide[-1, -1] > 1.2 * narrow[-1, -1]
    alone = [fitter.linearise(fitter.priors.start, (), word=word).covariance for word in (True, False)]
    assert alone[1] == pytest.approx(alone[0])


def test_presses_go_on_by_themselves_after_a_step_of_the_whole():
    fitter = seen("nothing").fitter
    at = fitter.linearise(fitter.priors.start, ())
    state, _, loss = fitter._take_step(at, fitter.gauss_newton_step(at))
    assert loss < loss_at(fitter, fitter.moved(at, fitter.gauss_newton_step(at))) - 1.0
    assert (np.abs(state.move[:, :2]) < 1e-3).all()


def loss_at(fitter: Fitter, state) -> float:  # type: ignore[no-untyped-def]
    """What all presses leave where they are."""
    return float(fitter.profile_presses(state, steps=0).loss.sum())


def test_presses_return_from_wrong_positions():
    fitter = seen("nothing").fitter
    end = fitter.solve(fitter.priors.start, steps=4).state
    rng = np.random.default_rng(3)
    lost, which = end.move.copy(), rng.random(len(end.move)) < 0.6
    lost[which, :2] = (fitter.priors.slack_m * rng.choice([-0.6, 0.6], (len(which), 2)))[which]
    found = relocate_presses(fitter, replace(end, move=lost))
    assert (fitter.profile_presses(found).loss < fitter.profile_presses(end).loss + 2.0).all()


def test_a_loss_is_the_same_from_wherever_it_is_come_to():
    fitter = seen("nothing").fitter
    end = fitter.solve(fitter.priors.start, steps=4).state
    near = replace(end, move=end.move + np.array([1e-4, -1e-4, 0.0]))
    anew = seen.__wrapped__("nothing").fitter
    first = loss_at(anew, near), loss_at(anew, end)
    assert (loss_at(fitter, near), loss_at(fitter, end)) == pytest.approx(first, abs=1e-6)


def test_unfinished_fit_gets_no_credit_for_its_slopes():
    fitter = seen("nothing").fitter
    end = fitter.solve(fitter.priors.start, steps=12)
    short = fitter.linearise(replace(end.state, log_s=end.state.log_s + 0.05), ())
    folds = folds_of(end.blocks, np.random.default_rng(0))
    scores = [x.held_out_scores(folds).sum() for x in (end, short)]
    assert short.loss() - end.loss() > 10
    assert scores[0] - scores[1] == pytest.approx((short.loss() - end.loss()) / 2, rel=0.2)
