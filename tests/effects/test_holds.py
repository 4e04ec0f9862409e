"""Histories of sites over a session."""

import numpy as np

from skincal.effects import met_before


def test_the_largest_force_of_a_site_is_remembered():
    rng = np.random.default_rng(0)
    site, force = rng.integers(0, 4, 40), rng.uniform(0.5, 5.0, 40)
    cycle = np.array([(site[:k] == site[k]).sum() for k in range(40)], dtype=float)
    met = [force[:k][site[:k] == site[k]].max(initial=0.0) for k in range(40)]
    assert np.array_equal(met_before(site, cycle, force), met)


def test_an_unlisted_touch_leaves_each_site_its_history():
    # The fourth touch was cut off; it counts, but is no press.
    met = met_before(np.array([1, 1, 0, 0, 1]), np.array([0.0, 1, 0, 2, 2]), np.array([1.0, 5, 2, 0.5, 1]))
    assert met.tolist() == [0.0, 1.0, 0.0, 2.0, 5.0]


def test_plateaus_remember_the_peak_of_the_touch_before():
    force = np.array([1.0, 2, 5, 3, 1])
    met = met_before(np.zeros(10, dtype=int), np.repeat([0.0, 1.0], 5), np.tile(force, 2))
    assert met.tolist() == [0.0] * 5 + [5.0] * 5


def test_an_unknown_history_is_the_median_of_others():
    site, cycle = np.array([0, 0, 1, 1, 2, 3]), np.array([0.0, 1, 0, 1, 4, np.nan])
    met = met_before(site, cycle, np.array([1.0, 9, 2, 9, 9, 9]))
    assert met[:5].tolist() == [0.0, 1.0, 0.0, 2.0, 1.5]
    assert np.isnan(met[5])


def test_where_no_press_tells_of_an_earlier_one_nothing_is_known():
    met = met_before(np.arange(3), np.array([0.0, 1.0, 2.0]), np.ones(3))
    assert met[0] == 0.0 and np.isnan(met[1:]).all()
    # A force that is not known is none of the site's.
    assert np.isnan(met_before(np.zeros(2, dtype=int), np.array([0.0, 1.0]), np.array([np.nan, 1.0]))[1])
    nothing = np.zeros(0)
    assert met_before(nothing.astype(int), nothing, nothing).shape == (0,)
