"""Uncertainty of the contact law, and its effect on the parameters.

The model is an elastic foundation: stress follows from the penetration of the same point. A real skin is a layer, and
a layer also spreads pressure sideways, by a fraction of its thickness. Images of a stiffer foundation with some spread
and of a softer one without are nearly the same, so E cannot be known better than the spread. The fit is therefore
repeated with the pressure spread by a Gaussian of a few widths; each width counts as much as the data support it (its
evidence). Nor does everybody's taxel feel what the paper's does, the pressure times two projections: one that feels
the pressure itself reads some percent more of a deep contact. So that is tried, too. Half of the draws are those of the
foundation, half are moved by the shift of the parameters that goes with such laws, and intervals cover both: whichever
law the skin has, its E and S are inside.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from scipy.special import expit

from skincal.fitting.posterior import Peak
from skincal.fitting.problem import NOWHERE, FitError
from skincal.fitting.types import Floats


@dataclass(frozen=True, eq=False)
class LawSpread:
    """Likelihood of each width of spread, and its effect on the macro variables.

    Attributes:
        widths_m: (N,) fine scale of widths [m].
        density: (N,) their posterior, summing to one.
        shift: (N, 5) of the macro variables against no spread.
        bare: chance that taxels feel the pressure itself.
        bare_shift: (5,) of the macro variables where they do.
    """

    widths_m: Floats
    density: Floats
    shift: Floats
    bare: float = 0.0
    bare_shift: Floats = field(default_factory=lambda: np.zeros(5))

    @property
    def best_m(self) -> float:
        """The most probable width [m]."""
        return float(self.widths_m[np.argmax(self.density)])

    @property
    def rise(self) -> float:
        """Return the log evidence of the widest spread over that of none; 0 unless it is the best of all."""
        if len(self.density) == 1 or np.argmax(self.density) < len(self.density) - 1:
            return 0.0
        return float(np.log(self.density[-1]) - np.log(max(self.density[0], np.finfo(float).tiny)))

    def shifted(self, draws: Floats, rng: np.random.Generator) -> Floats:
        """Draws (W, 5) of the macro variables, each moved as a law of its own asks for."""
        moved = draws + self.shift[rng.choice(len(self.widths_m), len(draws), p=self.density)]
        return moved + (rng.random(len(draws)) < self.bare)[:, None] * self.bare_shift

    def with_bare(self, projected: Peak, bare: Peak) -> LawSpread:
        """The same with what the peaks of taxels that feel the projected pressure, and the pressure itself, say."""
        if not (np.isfinite(bare.log_evidence) and np.isfinite(bare.macro).all()):
            return self
        rise = bare.log_evidence - projected.log_evidence
        # Like a spread, it has no direction.
        shift = np.where(np.arange(5) < 3, 0.0, bare.macro - projected.macro)
        return replace(self, bare=float(expit(rise)), bare_shift=shift)


def weigh_laws(spreads_m: Floats, peaks: Sequence[Peak]) -> LawSpread:
    """Weighs contact laws against each other, flat prior over the widths.

    A law under which the presses have no density is ruled out, and so are those that spread pressure further.

    Args:
        spreads_m: (L,) widths, growing from zero [m].
        peaks: the peak of the posterior at each.

    Raises:
        FitError: the presses have no density under the foundation either.
    """
    told = [bool(np.isfinite(p.log_evidence) and np.isfinite(p.macro).all()) for p in peaks]
    if not told[0]:
        raise FitError(NOWHERE)
    held = told.index(False) if False in told else len(told)
    spreads_m, peaks = spreads_m[:held], peaks[:held]
    if len(spreads_m) == 1:
        return LawSpread(np.zeros(1), np.ones(1), np.zeros((1, 5)))
    from scipy.interpolate import PchipInterpolator  # takes a moment, and a worker has it

    widths = np.linspace(0.0, float(spreads_m[-1]), 161)
    evidence = PchipInterpolator(spreads_m, [p.log_evidence for p in peaks])(widths)
    macro = np.stack([p.macro for p in peaks])
    # Spread has no direction, so it cannot move or turn the sensor; what differs there is the noise of the search.
    macro[:, :3] = macro[0, :3]
    # A Gaussian of small width acts by its variance: shifts start quadratically.
    shift = PchipInterpolator(spreads_m**2, macro - macro[0])(widths**2)
    density = np.exp(evidence - evidence.max())
    return LawSpread(widths, density / density.sum(), shift)
