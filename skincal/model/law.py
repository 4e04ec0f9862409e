"""Nonlinear laws of stress over local penetration."""

from __future__ import annotations

from dataclasses import dataclass
from math import isfinite

from skincal.model.arrays import positive
from skincal.model.indenters import Indenter, Sphere


@dataclass(frozen=True)
class StressLaw:
    """A power law: sigma = E eps_0 (eps / eps_0)^n.

    n = 1 is the paper's elastic foundation (equation 3; Johnson, Contact Mechanics, 1985, section 4.3). n > 1 stiffens,
    like a foam or rubber near full compression. The power law is the usual first extension of the foundation.

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
    """Deviation of a real skin's contact from the elastic foundation, in three parameters.

    Stress is a power of the penetration; the pressure is spread sideways before it reaches the taxels (or sharpened,
    with a negative variance); and a ball acts like one of another radius. These are the ways in which images of an
    elastic layer differ from those of a foundation (Johnson, Contact Mechanics, 1985, 4.3 and 5.8).

    The stiffness of a layer depends on the contact radius a as a^(2 (n - 1)): it is constant for a thin layer (n = 1)
    and proportional to 1 / a for a half-space (n = 1/2, Hertz). a² is proportional to penetration times radius, so
    stress also scales with the radius of the ball to the power n - 1.

    Attributes:
        exponent: n of the :class:`StressLaw`.
        spread_m2: variance of the spreading along each axis [m²].
        radius_scale: effective radius of a ball over its true radius.
        reference_m: eps_0 of the :class:`StressLaw` [m].
        reference_radius_m: radius of the ball for which E holds [m]; 0: stress does not depend on the radius.
    """

    exponent: float = 1.0
    spread_m2: float = 0.0
    radius_scale: float = 1.0
    reference_m: float = 5e-4
    reference_radius_m: float = 0.0

    def __post_init__(self) -> None:
        for name in ("exponent", "radius_scale", "reference_m"):
            object.__setattr__(self, name, positive(f"contact law {name}", getattr(self, name)))
        if not (isfinite(self.reference_radius_m) and self.reference_radius_m >= 0):
            raise ValueError(
                f"contact law reference_radius_m: expected 0 or a radius [m]; got {self.reference_radius_m}"
            )
        if not isfinite(self.spread_m2):
            raise ValueError(f"contact law spread_m2: expected a finite number; got {self.spread_m2}")

    def stress(self, law: StressLaw | None) -> StressLaw | None:
        """Return the stress law, combined with that of an effect if there is one.

        If stress is a power m of strain, and strain a power n of penetration, the exponents multiply.
        """
        if self.exponent == 1.0:
            return law
        if law is None:
            return StressLaw(self.exponent, self.reference_m)
        return StressLaw(law.exponent * self.exponent, law.reference_m)

    def stiffness(self, indenter: Indenter, law: StressLaw | None = None) -> float:
        """Return E for an indenter over E for the reference ball, given the stress law of an effect."""
        if not self.reference_radius_m or not isinstance(indenter, Sphere):
            return 1.0
        power = (self.exponent - 1) * (1.0 if law is None else law.exponent)
        return (indenter.radius_m / self.reference_radius_m) ** power

    def equivalent_indenter(self, indenter: Indenter) -> Indenter:
        """Return the indenter that acts on the foundation as the given one does on the skin."""
        if self.radius_scale == 1.0 or not isinstance(indenter, Sphere):
            return indenter
        return Sphere(self.radius_scale * indenter.radius_m)
