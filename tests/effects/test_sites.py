"""What sites have met before."""

import numpy as np

from skincal.effects import met_before

SITES = np.array([[0.0, 0.0, 0.0], [2e-3, 0.0, 0.0], [0.0, 2e-3, 0.0], [2e-3, 2e-3, 0.0]])


def touched(presses: int, seed: int, off_m: float = 0.0):
    """Sites of presses, touches before, forces, and places that are measured with an error."""
    rng = np.random.default_rng(seed)
    site = rng.integers(0, len(SITES), presses)
    cycle = np.array([(site[:k] == site[k]).sum() for k in range(presses)], dtype=float)
    force = rng.uniform(0.5, 5.0, presses)
    places = SITES[site] + off_m * rng.uniform(-1.0, 1.0, (presses, 3))
    met = [force[:k][site[:k] == site[k]].max(initial=0.0) for k in range(presses)]
    return site, cycle, force, places, np.array(met)


def test_the_largest_force_of_a_site_is_remembered():
    _, cycle, force, places, met = touched(40, 0)
    assert np.array_equal(met_before(cycle, force, places), met)
    assert (met > 0).sum() == 36


def test_places_may_be_off_by_less_than_sites_are_apart():
    _, cycle, force, places, met = touched(40, 1, off_m=0.4e-3)
    assert np.array_equal(met_before(cycle, force, places), met)


def test_two_sites_that_measured_places_confuse_still_have_one_history_each():
    # Both second touches are nearer to the first site; the later of them has to go on from the other one.
    places = np.array([[0.0, 0, 0], [1e-3, 0, 0], [0.1e-3, 0, 0], [0.3e-3, 0, 0]])
    met = met_before(np.array([0.0, 0, 1, 1]), np.array([1.0, 2.0, 9.0, 9.0]), places)
    assert met.tolist() == [0.0, 0.0, 1.0, 2.0]


def test_what_is_not_known_stays_so():
    places = np.tile(SITES[0], (5, 1))
    places[4] = np.nan
    # The second counts no touches, the third has no earlier one in the session, the last has no place.
    met = met_before(np.array([0.0, np.nan, 3.0, 1.0, 2.0]), np.array([2.0, 5.0, 1.0, 1.0, 1.0]), places)
    assert met[[0, 3]].tolist() == [0.0, 2.0]
    assert np.isnan(met[[1, 2, 4]]).all()
    assert met_before(np.zeros(0), np.zeros(0), np.zeros((0, 3))).shape == (0,)
