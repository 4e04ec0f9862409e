"""Laws of stress over local penetration that are not linear."""

from __future__ import annotations

from dataclasses import dataclass
from math import isfinite

from skincal.model.arrays import positive
from skincal.model.indenters import Indenter, Sphere


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


@dataclass(frozen=True)
class ContactLaw:
    """Difference of the contact of a real skin from the elastic foundation, in three small numbers.

    Stress grows as a power of the penetration, the pressure reaches taxels spread sideways (or sharper, where the
    variance is negative), and a ball presses as one of another radius does. To first order these are the ways in which
    images of an elastic layer differ from those of a foundation (Johnson, Contact Mechanics, 1985, 4.3 and 5.8).

    Attributes:
        exponent: n of the :class:`StressLaw`.
        spread_m2: variance of the spreading along each axis [m²].
        radius_scale: radius that a ball seems to have, over its own.
        reference_m: eps_0 of the :class:`StressLaw` [m].
    """

    exponent: float = 1.0
    spread_m2: float = 0.0
    radius_scale: float = 1.0
    reference_m: float = 5e-4

    def __post_init__(self) -> None:
        for name in ("exponent", "radius_scale", "reference_m"):
            object.__setattr__(self, name, positive(f"contact law {name}", getattr(self, name)))
        if not isfinite(self.spread_m2):
            raise ValueError(f"contact law spread_m2: expected a finite number; got {self.spread_m2}")

    def stress(self, law: StressLaw | None) -> StressLaw | None:
        """Return the law of stress, combined with that of an effect if there is one."""
        if self.exponent == 1.0:
            return law
        if law is None:
            return StressLaw(self.exponent, self.reference_m)
        return StressLaw(law.exponent + self.exponent - 1, law.reference_m)

    def pressed_by(self, indenter: Indenter) -> Indenter:
        """Return the indenter that presses on the foundation as this one does on the skin."""
        if self.radius_scale == 1.0 or not isinstance(indenter, Sphere):
            return indenter
        return Sphere(self.radius_scale * indenter.radius_m)
