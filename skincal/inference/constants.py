"""Constants of the diagnosis that the data do not determine, each with its reason."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

LEVEL, WIDTH = 0.95, 1.96
"""Level of the intervals of effects and of the contact law, and half their width in standard deviations."""


@dataclass(frozen=True)
class Constants:
    """All of them. P: a prior; T: a tolerance; M: measured (docs/diagnose.md says how)."""

    image: float = (
        0.01  # P  relative error of an image, independent in each taxel: mounting, contact law, cells
    )
    force: float = 0.02  # P  relative error of a press's force
    equation: float = 0.2  # P  relative error of an effect's equation in each phase of a press
    parts: int = 4  # T  intervals of force, image and session with one factor of equation error each
    law_power: float = 0.22  # M  sd of the stress exponent less 1 over elastic layers
    law_blur: float = 0.2  # M  sd of the spreading beyond what goes with it [half of (0.25 mm)²]
    law_radius: float = 0.06  # M  sd of the relative radius of the indenter
    law_bare: float = (
        0.7  # P  sd of the part of unprojected pressure that taxels feel: 0 or 1, equally likely
    )
    law_scale: float = 0.012  # M  sd of the relative scale over elastic layers
    rest: float = 0.3  # P  sd of the common level at rest about idle frames [noise sd]
    huber: float = 8.0  # T  residual from which the loss is linear [noise sd]
    settled: float = 0.5  # T  gain of a step below which a fit has converged [twice nats]
    loose: float = 0.1  # T  increase of the loss that a step may cause [twice nats]
    own_steps: int = 2  # T  steps of each press after a joint one
    folds: int = 6  # T  folds of presses that are held out in turn
    clip: float = 3.0  # T  bound of a press's gain in its significance [nats]
    sure: float = 2.7  # T  significance that a gain needs [standard errors]
    few: int = 3  # T  best presses without which a gain must exceed its limit, unless significant
    null_sessions: int = 120  # T  simulated sessions with nothing hidden
    null_quantile: float = 0.99  # T  quantile of their gains that is an effect's limit
    limit_factor: float = 1.25  # M  factor on limits, for laws and errors that the null lacks
    few_steps: int = 3  # T  steps of a rough fit
    noise: float = 0.02  # P  relative error of the noise variance, tolerated in a misfit
    joint_steps: int = 5  # T  steps of a joint fit
    last_steps: int = 12  # T  steps of a final fit
    contend: float = 0.5  # T  part of the best gain, plain or clipped, that a joint fit needs
    contenders: int = 4  # T  joint fits in a round
    paths: int = 2  # T  paths followed with equivalent effects
    closes: float = 0.5  # T  part of the gap that named effects must close
    least_gain: float = 8.0  # T  least gain of a named effect, whatever the null [nats]
    alike: float = 2.0  # T  standard errors within which two effects are equivalent
    # T  largest number of effects; twice as many rounds, as one may be found taxel by taxel
    most: int = 4
    # T  scales of a first step
    scales: tuple[float, ...] = (1.0, 0.7, 0.5, 0.35, 0.25, 0.17, 0.1, 0.06, 1.5, 2.0, 3.0)
    # T  misfit of an outlier press, over the median
    wild: float = 5.0
    # T  image errors to choose from, over ``image``
    images: tuple[float, ...] = (1.0, 2.0, 3.0, 5.0, 7.0, 10.0)
    like_none: float = 2.5  # T  prior sds beyond which a contact law is implausible
    # T  changes of log E at which fits then restart
    softer: tuple[float, ...] = (0.7, 1.5)
    smooth: float = 0.5  # T  noise from which rounding errors are below 0.2 % of a step [steps]
    least_slope: float = 1e-3  # T  least slope of the converter, where it clips
    least_variance: float = 0.05  # T  least variance where it clips, over the usual one
    least_noise: float = 1e-4  # T  least noise, over the largest signal


CONSTANTS: Final = Constants()
