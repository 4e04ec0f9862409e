"""Every number that the diagnosis does not find in the data: what it is, and why it is what it is."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final


@dataclass(frozen=True)
class Constants:
    """One table. P: a prior; T: a tolerance; M: measured (docs/diagnose.md says how)."""

    image: float = 0.01  # P  relative error of a press's image, taxel by taxel: mounting, contact law, cells
    force: float = 0.02  # P  relative error of a press's force
    equation: float = 0.2  # P  relative error of an effect's equation in each phase of a press
    parts: int = 4  # T  of force, image and session in which an equation errs by one factor each
    law_power: float = 0.22  # M  how far the exponent of the stress lies from 1 that fits elastic layers
    law_blur: float = 0.2  # M  the same of a spreading beyond that, in steps of 0.25 mm, squared
    law_radius: float = 0.06  # M  the same of the indenter's radius, relative
    law_bare: float = 0.7  # P  part of the pressure itself in what taxels feel: none or all, with equal odds
    law_scale: float = 0.012  # M  the same of the scale
    rest: float = 0.3  # P  how far the common level at rest is from what idle frames say, in noises
    huber: float = 8.0  # T  residuals beyond so many noises count in proportion
    settled: float = 0.5  # T  a step that gains less ends a fit [twice nats]
    loose: float = 0.1  # T  a step may leave so much more than the state before it [twice nats]
    own_steps: int = 2  # T  steps of presses by themselves after one of the whole
    folds: int = 6  # T  parts of the presses that are held out in turn
    clip: float = 3.0  # T  no press counts for more in the standard error of a gain
    sure: float = 2.7  # T  standard errors by which a gain must be there
    few: int = 3  # T  presses without which a gain must stay beyond its limit, or be sure as above
    null_sessions: int = 120  # T  simulated sessions with nothing hidden
    null_quantile: float = 0.99  # T  of their greatest gains: an effect's limit
    slack: float = 1.25  # M  what a limit is raised by for laws and errors that the null does not have
    few_steps: int = 3  # T  of a fit that only shows where it leads, as to another contact law
    noise: float = 0.02  # P  relative error of the noise's variance, so much may always be left
    joint_steps: int = 5  # T  of a joint fit
    last_steps: int = 12  # T  of that of the effect which is taken
    contend: float = 0.5  # T  of the best gain, whole or shared: what has less is not fitted in full
    contenders: int = 4  # T  that are fitted in full in a round
    paths: int = 2  # T  that are followed where effects are not told apart
    closes: float = 0.5  # T  part of the gap that what is named must be able to close
    least_gain: float = 8.0  # T  nats; less is never named, whatever the null
    alike: float = 2.0  # T  standard errors within which two effects are not told apart
    # T  effects that are named at most, in twice as many rounds: one may be found taxel by taxel
    most: int = 4
    # T  of a first step
    scales: tuple[float, ...] = (1.0, 0.7, 0.5, 0.35, 0.25, 0.17, 0.1, 0.06, 1.5, 2.0, 3.0)
    # T  of the same: a press that leaves more, whatever its place, is no press like the others
    wild: float = 5.0
    # T  errors of images that are tried, over ``image``
    images: tuple[float, ...] = (1.0, 2.0, 3.0, 5.0, 7.0, 10.0)
    like_none: float = 2.5  # T  standard deviations from which on a contact law is none of a layer
    # T  by how much logarithms of E are then less where a fit begins again, or more where it begins with an effect
    softer: tuple[float, ...] = (0.7, 1.5)
    smooth: float = 0.5  # T  of a step: noise from which on rounding leaves no more than 0.2 % of a step
    least_slope: float = 1e-3  # T  of the converter, where it clips
    least_variance: float = 0.05  # T  of the usual one, where it clips
    least_noise: float = 1e-4  # T  of the largest signal, where there is no noise


CONSTANTS: Final = Constants()
