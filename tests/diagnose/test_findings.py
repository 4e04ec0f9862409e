"""Findings say in words what was found, by the names and numbers of the dataset."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from skincal.calibration import Finding
from skincal.diagnose.diagnosis import NamedEffect
from skincal.diagnose.findings import (
    few_of_the_end,
    findings_of,
    of_noise,
    taxel_name,
    too_many_glitches,
    within_the_clocks,
)
from skincal.fit.observe import Readout
from skincal.gap.heldout import Gap
from skincal.gap.noise import LEFT_BY_FIT, assumed_floor
from skincal.gap.robust import Dead, Jump
from skincal.model import TaxelLayout
from skincal.model.arrays import IntArray

LAYOUT = TaxelLayout.grid(2, 3, taxel_size_m=0.0025, pitch_m=0.004)
PRESSES = np.array([100, 101, 107])


def found(
    glitches: tuple[int, ...] = (),
    jumps: tuple[Jump, ...] = (),
    dead: tuple[Dead, ...] = (),
    never: tuple[int, ...] = (),
    taxels: IntArray | None = None,
) -> tuple[Finding, ...]:
    seen = np.ones((5, 6 if taxels is None else len(taxels)), dtype=bool)
    seen[:, list(never)] = False
    return findings_of(LAYOUT, PRESSES, glitches, jumps, dead, seen, taxels)


def test_nothing_found_nothing_said():
    assert found() == ()


def test_taxels_are_named_by_row_and_column():
    assert [taxel_name(LAYOUT, t) for t in (0, 2, 3, 5)] == [
        "taxel_0_0",
        "taxel_0_2",
        "taxel_1_0",
        "taxel_1_2",
    ]


def test_glitches_are_told_by_the_number_of_the_press():
    (one,) = found(glitches=(0, 2))
    assert one.code == "glitch" and one.severity == "warning" and one.advice
    assert "press 100, 107:" in one.text and "left out" in one.text


def test_presses_that_may_be_an_effect_are_told_but_not_as_glitches():
    seen = np.ones((4, LAYOUT.taxels), dtype=bool)
    (one,) = findings_of(LAYOUT, PRESSES, [], [], [], seen, doubted=[0, 2])
    assert one.code == "kept_presses" and f"press {PRESSES[0]}, {PRESSES[2]}:" in one.text
    assert "so they were kept" in one.text


def test_without_a_clock_the_press_is_told_instead_of_a_time():
    seen = np.ones((4, LAYOUT.taxels), dtype=bool)
    dead, order = (Dead(1, 2.0, 3.0, 0.0),), np.array([0, 1, 2, 2])
    (one,) = findings_of(LAYOUT, PRESSES, [], [], dead, seen, order=order)
    assert one.text.startswith("taxel_0_1 does not answer from press 107 on")
    (timed,) = findings_of(LAYOUT, PRESSES, [], [], dead, seen)
    assert timed.text.startswith("taxel_0_1 does not answer from 2.0 s on")


def test_noisy_taxels_are_told_with_their_noise():
    seen = np.ones((4, LAYOUT.taxels), dtype=bool)
    (one,) = findings_of(LAYOUT, PRESSES, [], [], [], seen, noise=(1.0, (1.0, 4.5, 1.0, 6.0, 1.0, 1.0)))
    assert one.code == "noisy_taxel"
    assert one.text.startswith("taxel_1_0 (6.0), taxel_0_1 (4.5): a frame scatters by so many counts")
    assert "those of other taxels by 1.0" in one.text


def test_a_jump_says_which_taxels_when_and_how_much():
    (one,) = found(jumps=(Jump((1, 4), 61.25, (3.04, -2.0)),))
    assert one.code == "jump"
    assert (
        one.text
        == "taxel_0_1, taxel_1_1: the level at rest jumps at 61.2 s by +3.0, -2.0 counts; allowed for"
    )


def test_a_dead_taxel_is_dead_throughout_or_from_a_moment():
    always, later = found(dead=(Dead(0, 0.0, 0.0, 0.0), Dead(5, 90.0, 17.0, 0.0)))
    assert always.code == later.code == "dead_taxel"
    assert always.text == "taxel_0_0 does not answer throughout; it reads 0.0 counts"
    assert later.text == "taxel_1_2 does not answer from 90.0 s on; it reads 17.0 counts"


def test_a_taxel_that_was_never_read_is_said():
    (one,) = found(never=(2, 3))
    assert one.code == "never_read" and one.text.startswith("taxel_0_2, taxel_1_0:")


def test_of_a_few_taxels_of_a_large_sensor_the_names_are_those_of_the_sensor():
    told = found(
        jumps=(Jump((1,), 10.0, (2.0,)),),
        dead=(Dead(0, 0.0, 0.0, 0.0),),
        never=(2,),
        taxels=np.array([1, 3, 5]),
    )
    assert [one.text.split()[0].strip(":") for one in told] == ["taxel_1_0", "taxel_0_1", "taxel_1_2"]


def test_a_press_that_fits_best_with_another_force_is_told():
    seen = np.ones((4, LAYOUT.taxels), dtype=bool)
    (one,) = findings_of(LAYOUT, PRESSES, [], [], [], seen, pulled={0: 0.446, 2: -0.12})
    assert one.code == "force" and one.severity == "warning" and one.advice
    assert one.text.startswith("press 100 (+45 %), 107 (-12 %): fits best with a force so far from")
    (many,) = findings_of(
        LAYOUT, np.arange(9), [], [], [], seen, pulled={k: 0.1 + 0.01 * k for k in range(9)}
    )
    assert many.text.startswith("press 3 (+13 %), 4") and "8 (+18 %) and 3 more: fits" in many.text


@pytest.mark.parametrize(("presses", "words"), [(1, "1 press kept"), (3, "3 presses kept"), (4, None)])
def test_so_few_presses_of_the_end_that_they_say_nothing_are_told(presses: int, words: str | None):
    gap = Gap(2.0, 1.0, 0.9, 0.9, (0.8, 1.0), (-4.0, -2.0), presses, 50, 0.0, 0.0, np.zeros((presses, 4)))
    said = few_of_the_end(gap)
    assert [one.code for one in said] == ([] if words is None else ["few_of_the_end"])
    assert all(one.text.startswith(words or "") for one in said)


def latency(delay_s: float, filtered: float = 0.0) -> NamedEffect:
    return NamedEffect(
        "latency",
        ("latency",),
        0.01,
        {"delay_s": np.asarray(delay_s), "filtered": np.asarray(filtered)},
        {},
        "",
        1.0,
    )


@pytest.mark.parametrize(
    ("delay_s", "clock_sigma_s", "severity"),
    [(0.008, 0.005, "warning"), (0.03, 0.005, None), (0.03, 0.0, None), (0.03, None, "info")],
)
def test_a_latency_that_the_clocks_may_have_made_is_told(
    delay_s: float, clock_sigma_s: float | None, severity: str | None
):
    said = within_the_clocks([latency(delay_s)], clock_sigma_s)
    assert [one.severity for one in said] == ([] if severity is None else [severity])
    assert all(
        one.code == "clock" and f"{1e3 * delay_s:g} ms are a pure delay" in one.text and one.advice
        for one in said
    )
    assert (
        within_the_clocks([], clock_sigma_s) == within_the_clocks([latency(0.008, 1.0)], clock_sigma_s) == ()
    )


def test_what_the_data_do_not_say_of_the_noise_is_told():
    readout = Readout(0.0, 255.0, integer=True)
    nothing = assumed_floor(readout)
    noise, repeats = of_noise(nothing, frames=False, repeated=False)
    assert (noise.code, noise.severity, repeats.code) == ("noise_not_measured", "warning", "no_repeats")
    assert "assumed" in noise.text and "Record frames" in noise.advice and "twice" in repeats.advice
    left, _ = of_noise(nothing.of_means(2.5, (0.0, 2.5), LEFT_BY_FIT), frames=False, repeated=False)
    assert "2.50 counts" in left.text and "what the calibration's fit left" in left.text
    measured = replace(nothing, frame_from="hold frames", mean_from="hold frames", measured=True)
    bounded = measured.of_means(0.7, (0.4, 0.7), LEFT_BY_FIT)
    assert of_noise(bounded, frames=False, repeated=True) == ()
    (wide,) = of_noise(measured.of_means(2.5, (0.4, 2.5), LEFT_BY_FIT), frames=False, repeated=True)
    assert wide.severity == "info" and "2.50 counts, though untouched taxels scatter by 0.40" in wide.text
    assert of_noise(measured.of_means(2.5, (0.0, 2.5), LEFT_BY_FIT), frames=False, repeated=True) == ()
    (untold,) = of_noise(measured, frames=True, repeated=None)
    assert "targets were not recorded" in untold.text
    (only,) = of_noise(measured, frames=True, repeated=False)
    assert (only.code, only.severity) == ("no_repeats", "info") and "frames" in only.text
    assert of_noise(measured, frames=True, repeated=True) == ()
    assert of_noise(measured, frames=True, repeated=None, uniform=True) == ()
    (chamber,) = of_noise(nothing, frames=False, repeated=None, uniform=True)
    assert chamber.advice == "Record frames."


def test_presses_that_are_too_many_to_be_glitches_are_told():
    (one,) = too_many_glitches(PRESSES, np.array([0, 2]))
    assert one.code == "many_glitches" and "press 100, 107:" in one.text and "had their say" in one.text
    assert too_many_glitches(PRESSES, np.zeros(0, dtype=np.int64)) == ()


def test_taxels_that_were_not_looked_at_have_no_numbers_of_their_own():
    seen = np.ones((4, 3), dtype=bool)
    arguments = LAYOUT, PRESSES, [], [], [], seen, np.array([0, 2, 5])
    (one,), (alike,) = (findings_of(*arguments, all_taxels=6, of_single=own) for own in (["taxel_gain"], []))
    assert one.code == "some_taxels" and "of taxel_gain the new calibration has numbers of these" in one.text
    assert "new calibration" not in alike.text
