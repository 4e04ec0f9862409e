"""One parameter: what it may be, and what is said of one that cannot be."""

import math

import pytest

from skincal.errors import InputError
from skincal.ranges import Parameter


def test_all_that_is_wrong_is_said_at_once():
    with pytest.raises(InputError) as caught:
        Parameter("uniform", mode="hour", source="guessed", low=math.nan, sigma=1.0)  # type: ignore[arg-type]
    places = {problem.place for problem in caught.value.problems}
    assert places == {f"parameter {key}" for key in ("mode", "source", "low", "high", "sigma")}


@pytest.mark.parametrize(
    ("make", "place"),
    [
        (lambda: Parameter.uniform(2.0, 1.0), "low"),
        (lambda: Parameter.uniform((0.0, 2.0), (1.0, 1.0)), "low"),
        (lambda: Parameter.log_uniform(0.0, 1.0), "low"),
        (lambda: Parameter.normal(0.0, -1.0), "sigma"),
        (lambda: Parameter.constant(()), "value"),
        (lambda: Parameter.constant(math.inf), "value"),
        (lambda: Parameter("gamma", low=0.0, high=1.0), "distribution"),  # type: ignore[arg-type]
        (lambda: Parameter("normal", mean=0.0), "sigma"),
        (lambda: Parameter("normal", mean=0.0, sigma=1.0, sigma_from="skin.noise_sigma_counts"), "sigma"),
    ],
)
def test_impossible_figures_are_refused(make, place):
    with pytest.raises(InputError) as caught:
        make()
    assert [problem.place for problem in caught.value.problems] == [f"parameter {place}"]


def test_lists_must_agree_in_length():
    with pytest.raises(InputError, match="lists of one length"):
        Parameter.uniform((0.0, 1.0), (1.0, 2.0, 3.0))


@pytest.mark.parametrize(
    ("parameter", "width"),
    [
        (Parameter.uniform(1.0, 3.0), 2.0),
        (Parameter.uniform((1.0, 2.0), (3.0, 5.0)), 3.0),
        (Parameter.uniform((-1.0, -2.0), 1.0), 3.0),
        (Parameter.log_uniform(1.0, 10.0), 9.0),
        (Parameter.normal(0.0, 0.5), 2.0),
        (Parameter.constant(7.0), 0.0),
    ],
)
def test_width(parameter, width):
    assert parameter.width() == pytest.approx(width)


def test_width_of_noise_whose_level_is_drawn_is_unknown():
    assert math.isnan(Parameter.normal(0.0, "skin.noise_sigma_counts").width())
