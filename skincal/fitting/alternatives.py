"""Uncertainty of the contact law, and its effect on the parameters.

The model is an elastic foundation: the stress at a point follows from the penetration at the same point. A
real skin is a layer, which also spreads pressure sideways, by a fraction of its thickness. Images of a
stiffer foundation with some spread and of a softer one without are nearly the same, so E is uncertain by the
uncertainty of the spread. The fit is therefore repeated with the pressure spread by Gaussians of a few
widths, and each width is weighted by its evidence. Taxels may also differ from the paper's, which feel the
pressure times two projections: taxels that feel the pressure itself read some percent more of a deep contact.
They are a further candidate law. Half of the draws are those of the foundation; the other half are moved by
the parameter shifts of such laws. Intervals cover both halves, so that they contain E and S of whichever of
these laws the skin has.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from scipy.special import expit

from skincal.fitting.posterior import Peak
from skincal.fitting.problem import NO_DENSITY, FitError
from skincal.fitting.types import Floats


@dataclass(frozen=True, eq=False)
class LawSpread:
    """Posterior of the contact law, and its effect on the macro variables.

    Attributes:
        widths_m: (N,) fine grid of spread widths [m].
        density: (N,) their posterior, summing to one.
        shift: (N, 5) of the macro variables relative to no spread.
        unprojected: probability that taxels feel the pressure itself.
        unprojected_shift: (5,) of the macro variables if they do.
    """

    widths_m: Floats
    density: Floats
    shift: Floats
    unprojected: float = 0.0
    unprojected_shift: Floats = field(default_factory=lambda: np.zeros(5))

    @property
    def best_m(self) -> float:
        """The most probable width [m]."""
        return float(self.widths_m[np.argmax(self.density)])

    @property
    def rise(self) -> float:
        """Log evidence of the widest spread over that of none; 0 unless it is the best of all."""
        if len(self.density) == 1 or np.argmax(self.density) < len(self.density) - 1:
            return 0.0
        return float(np.log(self.density[-1]) - np.log(max(self.density[0], np.finfo(float).tiny)))

    def shifted(self, draws: Floats, rng: np.random.Generator) -> Floats:
        """Return draws (W, 5) of the macro variables, each shifted by a law drawn at random."""
        moved = draws + self.shift[rng.choice(len(self.widths_m), len(draws), p=self.density)]
        return moved + (rng.random(len(draws)) < self.unprojected)[:, None] * self.unprojected_shift

    def with_unprojected(self, projected: Peak, unprojected: Peak) -> LawSpread:
        """Return the same with the evidence of taxels that feel the pressure itself.

        Args:
            projected: peak with taxels that feel the projected pressure.
            unprojected: peak with taxels that feel the pressure itself.
        """
        if not (np.isfinite(unprojected.log_evidence) and np.isfinite(unprojected.macro).all()):
            return self
        rise = unprojected.log_evidence - projected.log_evidence
        # Like a spread, it has no direction, so it cannot move or turn the sensor.
        shift = np.where(np.arange(5) < 3, 0.0, unprojected.macro - projected.macro)
        return replace(self, unprojected=float(expit(rise)), unprojected_shift=shift)


def weigh_laws(spreads_m: Floats, peaks: Sequence[Peak]) -> LawSpread:
    """Weigh contact laws by their evidence, with a flat prior over the widths.

    If the presses have no density under a law, that law and all wider spreads are excluded.

    Args:
        spreads_m: (L,) widths, growing from zero [m].
        peaks: the peak of the posterior at each.

    Raises:
        FitError: the presses have no density under the foundation either.
    """
    possible = [bool(np.isfinite(p.log_evidence) and np.isfinite(p.macro).all()) for p in peaks]
    if not possible[0]:
        raise FitError(NO_DENSITY)
    count = possible.index(False) if False in possible else len(possible)
    spreads_m, peaks = spreads_m[:count], peaks[:count]
    if len(spreads_m) == 1:
        return LawSpread(np.zeros(1), np.ones(1), np.zeros((1, 5)))
    from scipy.interpolate import PchipInterpolator  # slow to import; workers have it

    widths = np.linspace(0.0, float(spreads_m[-1]), 161)
    evidence = PchipInterpolator(spreads_m, [p.log_evidence for p in peaks])(widths)
    macro = np.stack([p.macro for p in peaks])
    # A spread has no direction, so it cannot move or turn the sensor; differences there are numerical
    # noise of the search.
    macro[:, :3] = macro[0, :3]
    # A Gaussian of small width acts by its variance: shifts start quadratically.
    shift = PchipInterpolator(spreads_m**2, macro - macro[0])(widths**2)
    density = np.exp(evidence - evidence.max())
    return LawSpread(widths, density / density.sum(), shift)
