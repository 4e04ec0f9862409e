"""How stress grows with local penetration, where it does not grow in proportion."""

from __future__ import annotations

from dataclasses import dataclass

from skincal.model.arrays import positive


@dataclass(frozen=True)
class StressLaw:
    """A power law: sigma = E eps_0 (eps / eps_0)^n.

    With n = 1 the paper's elastic foundation (equation 3); n > 1 stiffens, as a foam or a rubber that is nearly
    pressed through (Johnson, Contact Mechanics, 1985, section 4.3, on the foundation; the power law is the usual
    first step beyond it).

    Attributes:
        exponent: n.
        reference_m: eps_0, the penetration at which the stress is that of the linear law [m].
    """

    exponent: float
    reference_m: float

    def __post_init__(self) -> None:
        object.__setattr__(self, "exponent", positive("law exponent", self.exponent))
        object.__setattr__(self, "reference_m", positive("law reference_m", self.reference_m))
