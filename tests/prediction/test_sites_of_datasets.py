"""Sites of a dataset's presses, and the history of each."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from skincal.dataset import Dataset
from skincal.prediction.session_samples import met_forces, sites

SITE = np.array([0, 1, 0, 1, 0])
CYCLE = np.array([0.0, 0.0, 1.0, 1.0, 2.0])
FORCE = np.array([1.5, 4.0, 0.8, 2.0, 1.0])
MET = [0.0, 0.0, 1.5, 4.0, 1.5]
ROWS = np.arange(5)


def touched(dataset: Dataset, *, targets: bool = True, **columns: np.ndarray) -> Dataset:
    """The session with two sites, pressed again and again, and places that are measured a little off."""
    presses = dataset.presses
    meant = presses.position_m[SITE]
    given = {**presses.columns, "cycle": CYCLE}
    if targets:
        given |= dict(zip(("target_x_m", "target_y_m", "target_z_m"), meant.T, strict=True))
    given |= columns
    off = np.random.default_rng(0).uniform(-5e-4, 5e-4, meant.shape)
    return replace(dataset, presses=replace(presses, columns=given, force_n=FORCE, position_m=meant + off))


def reordered(dataset: Dataset, rows: np.ndarray) -> Dataset:
    return replace(dataset, presses=dataset.presses.select(rows))


def told(dataset: Dataset, rows: np.ndarray = ROWS) -> list[float] | None:
    met = met_forces(dataset, rows)
    return None if met is None else met.tolist()


def test_targets_tell_sites_and_what_they_have_met(session: Callable[..., Dataset]) -> None:
    dataset = touched(session(5))
    assert len(set(sites(dataset).tolist())) == 2
    assert told(dataset) == MET
    assert told(dataset, np.array([3, 3, 0])) == [4.0, 4.0, 0.0]
    # Where an earlier press is not there, the middle of what others have met.
    assert told(reordered(dataset, np.array([0, 2, 3])), ROWS[:3]) == [0.0, 1.5, 1.5]


def test_without_targets_places_must_be_the_same(session: Callable[..., Dataset]) -> None:
    dataset = touched(session(5), targets=False)
    assert len(set(sites(dataset).tolist())) == 5
    assert told(dataset) is None
    exact = replace(dataset, presses=replace(dataset.presses, position_m=session(5).presses.position_m[SITE]))
    assert told(exact) == MET
    uncounted = replace(dataset, presses=replace(dataset.presses, columns=session(5).presses.columns))
    assert told(uncounted) is None


def test_a_target_that_is_empty_is_a_site_of_its_own(session: Callable[..., Dataset]) -> None:
    dataset = touched(session(5))
    empty = dataset.presses.columns["target_x_m"].copy()
    empty[[0, 1]] = np.nan
    some = touched(session(5), target_x_m=empty)
    assert len(set(sites(some).tolist())) == 4
    assert told(some) == [0.0, 0.0, 0.8, 0.8, 0.8]


def test_the_order_is_that_of_time_whoever_tells_it(session: Callable[..., Dataset]) -> None:
    dataset = touched(session(5))
    back = ROWS[::-1]
    assert told(reordered(dataset, back)) == MET[::-1]
    timeless = {name: own for name, own in dataset.presses.columns.items() if not name.startswith("t_")}
    framed = replace(dataset, presses=replace(dataset.presses, columns=timeless))
    assert told(reordered(framed, back)) == MET[::-1]
    assert told(replace(framed, frames=None)) == MET


def test_touches_may_be_counted_in_the_frames(session: Callable[..., Dataset]) -> None:
    dataset = touched(session(5))
    frames = dataset.frames
    assert frames is not None
    own = {name: value for name, value in dataset.presses.columns.items() if name != "cycle"}
    counted = replace(
        frames, columns={**frames.columns, "cycle": np.where(frames.press >= 0, CYCLE[frames.press], np.nan)}
    )
    assert told(replace(dataset, frames=counted, presses=replace(dataset.presses, columns=own))) == MET
