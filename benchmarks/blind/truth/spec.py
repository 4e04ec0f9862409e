"""Specification of a session."""

from __future__ import annotations

from dataclasses import dataclass, field


@dataclass(frozen=True)
class Spec:
    """Specification of a session; the rest is drawn from the seed.

    Attributes:
        suite: which part of the test it belongs to.
        number: within the suite.
        seed: of the test; session and seed together say everything.
        law: ``foundation``, ``layer`` or ``half_space``.
        protocol: ``full``, ``raster`` or ``static``.
        effects: names of the catalogue with the strength g that is wanted.
        outside: kind and g of an effect that the catalogue does not have.
        decoy: what is there to mislead, without being an effect.
        rest_counts: level at rest; above a few counts nothing clips there.
        step_counts: of the converter.
        noise_grows: part of a value that is added to its noise, in quadrature.
    """

    suite: str
    number: int
    seed: int
    law: str = "layer"
    protocol: str = "full"
    effects: tuple[tuple[str, float], ...] = field(default=())
    outside: tuple[str, float] | None = None
    decoy: str | None = None
    rest_counts: float = 0.0
    step_counts: int = 1
    noise_grows: float = 0.0

    @property
    def name(self) -> str:
        """Name of the session; it does not reveal what is hidden."""
        return f"{self.suite}-{self.number:03d}"
