"""Where presses were, to a first guess."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from gap.gap_sessions import READOUT
from gap.made_sessions import MODEL, SIGMA, Made, held, made, pressed, read

from skincal.effects import EffectSkin, Samples
from skincal.gap.hypothesis import Hypothesis
from skincal.gap.reading import Reading
from skincal.gap.session import GapSession
from skincal.gap.start import start_places, valleys

SLACK_M = 0.8e-3


def displaced(session: GapSession, taxels: np.ndarray | None = None) -> Made:
    """Presses that are off by most of a millimetre."""
    rng = np.random.default_rng(7)
    places = np.zeros((session.presses, 3))
    places[:, :2] = SLACK_M * rng.standard_normal((session.presses, 2))
    truth = Hypothesis(MODEL, places)
    seen = session if taxels is None else session.of_taxels(taxels)
    counts = read(seen, truth.values(seen), rng, READOUT)
    seen = replace(seen, counts=counts)
    return Made(seen, Reading.of(seen, SIGMA, READOUT), truth)


def found(one: Made, sigma_m: float = SLACK_M) -> np.ndarray:
    return start_places(MODEL.skin, one.session, one.reading, sigma_m, 2e-3)


@pytest.mark.parametrize("kind", ["frames", "holds"])
def test_places_are_found_as_well_as_the_grid_allows(kind: str):
    one = displaced(pressed() if kind == "frames" else held())
    left = found(one) - one.truth.places
    inside = np.abs(one.truth.places[:, :2]).max(axis=1) < 2e-3
    assert np.median(np.hypot(*left[inside, :2].T)) < 0.45e-3
    assert (found(one)[:, 2] == 0).all()
    values = Hypothesis(MODEL, found(one)).values(one.session)
    before = one.reading.residual(one.start.values(one.session))
    assert (one.reading.residual(values) ** 2).sum() < 0.2 * (before**2).sum()


def test_places_are_found_from_some_taxels():
    one = displaced(pressed(), np.array([0, 1, 3, 4, 5, 7]))
    left = found(one) - one.truth.places
    assert np.median(np.hypot(*left[:, :2].T)) < 0.5e-3


def test_valleys_come_best_first_and_are_as_many_as_there_are():
    one = displaced(pressed())
    many = valleys(MODEL.skin, one.session, one.reading, SLACK_M, 2e-3, 4)
    assert many.shape == (one.session.presses, 4, 2)
    there = np.isfinite(many).all(axis=-1)
    assert there[:, 0].all() and not there.all()
    assert (there[:, :-1] >= there[:, 1:]).all()
    assert (many[:, 0] == found(one)[:, :2]).all()
    steps = np.diff(many, axis=1)
    assert not (np.abs(steps).max(axis=-1) < 1e-4).any()


def test_places_without_an_image_are_no_valleys(monkeypatch: pytest.MonkeyPatch):
    """On a mesh a walk can end beyond the rim."""
    one, usual = displaced(pressed()), EffectSkin.values

    def torn(skin: EffectSkin, samples: Samples) -> np.ndarray:
        values = usual(skin, samples)
        values[np.arange(len(values)) % 3 > 0] = np.nan
        return values

    monkeypatch.setattr(EffectSkin, "values", torn)
    many = valleys(MODEL.skin, one.session, one.reading, SLACK_M, 2e-3, 3)
    assert np.isfinite(many[:, 0]).all()
    monkeypatch.setattr(
        EffectSkin, "values", lambda skin, samples: np.full_like(usual(skin, samples), np.nan)
    )
    assert np.isnan(valleys(MODEL.skin, one.session, one.reading, SLACK_M, 2e-3, 3)).all()
    assert not found(one).any()


def test_a_sure_place_is_kept():
    one = displaced(pressed())
    assert not found(one, sigma_m=1e-6).any()


def test_presses_that_show_nothing_stay_where_they_were_measured():
    one = made()
    counts = one.session.counts.copy()
    gone = np.isin(one.session.press, [2, 9])
    counts[gone] = np.nan
    session = replace(one.session, counts=counts)
    places = start_places(MODEL.skin, session, Reading.of(session, SIGMA, READOUT), 1e-3, 2e-3)
    assert not places[[2, 9]].any()
    rest = session.press < 0
    nothing = replace(session, press=np.full_like(session.press, -1))
    assert not start_places(MODEL.skin, nothing, Reading.of(nothing, SIGMA, READOUT), 1e-3, 2e-3).any()
    assert rest.any()
