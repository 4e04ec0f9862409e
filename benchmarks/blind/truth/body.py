"""The sensor of a session: its pose, its scale and its law of contact, all drawn by chance; and its base model."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from benchmarks.blind.truth.contact import Foundation, Hardening, Layer
from benchmarks.blind.truth.half_space import HalfSpace
from benchmarks.blind.truth.images import ContactKind, ImageStore, Law
from benchmarks.blind.truth.rig import FINGER_RADIUS_M, SPHERES_M, Floats, Ints, centres_m

LARGEST_N, ALIKE_N = 8.0, 2.5
LAWS = ("foundation", "layer")
"""Of the suites but `third`, whose law is ``half_space``."""


@dataclass(frozen=True)
class Body:
    """Base model of a session.

    Attributes:
        y_m, beta_deg, alpha_deg: pose of the patch.
        elasticity_pa_per_m: E; of a layer that of the foundation which sinks in as far under 2.5 N.
        scale_per_n: S.
        constant_m: constant error of measured positions, round and along the finger [m].
        sigma_m: random error of measured positions in each direction [m].
        noise_counts: of a sample.
        images: fields of pressure of the contact law, kept.
    """

    y_m: float
    beta_deg: float
    alpha_deg: float
    elasticity_pa_per_m: float
    scale_per_n: float
    constant_m: tuple[float, float]
    sigma_m: float
    noise_counts: float
    images: ImageStore

    @property
    def centres_m(self) -> Floats:
        """Centres of the taxels (J, 2) [m]."""
        return centres_m(self.y_m, self.beta_deg, self.alpha_deg)

    def depth_m(self, sphere_m: float, force_n: Floats) -> Floats:
        """Return the penetration of a sphere [m]."""
        fields = self.images.fields(ContactKind(sphere_m))
        return np.interp(np.sqrt(force_n / self.elasticity_pa_per_m), fields.root, fields.depth_m)

    def plain(self) -> dict[str, float]:
        """The parameters of the base model, by the names of a calibration."""
        names = ("y_m", "beta_deg", "alpha_deg", "elasticity_pa_per_m", "scale_per_n")
        return {name: float(getattr(self, name)) for name in names}

    def as_positions_tell(self) -> dict[str, float]:
        """Pose with the constant error of the positions put into it: what a fit can find."""
        arc, along = self.constant_m
        turn = float(np.degrees(arc / FINGER_RADIUS_M))
        return {"y_m": self.y_m + along, "beta_deg": self.beta_deg + turn}


@dataclass(frozen=True)
class ContactChange:
    """Change of the contact by hidden effects."""

    hardening: Hardening | None = None
    sheet_m: float = 0.0
    sphere_added_m: tuple[float, ...] = (0.0,) * len(SPHERES_M)


@dataclass(frozen=True, eq=False)
class Touches:
    """Contacts at a number of samples.

    Attributes:
        force_n: (K,) normal force that the skin feels [N].
        arc_m, along_m: (K,) true contact point [m].
        sphere: (K,) row of the indenter in SPHERES_M.
    """

    force_n: Floats
    arc_m: Floats
    along_m: Floats
    sphere: Ints

    def moved(self, arc_m: Floats | float, along_m: Floats | float) -> Touches:
        """The same, elsewhere."""
        return replace(self, arc_m=self.arc_m + arc_m, along_m=self.along_m + along_m)


def values(
    body: Body, touches: Touches, change: ContactChange | None = None, moves_m: Floats | None = None
) -> Floats:
    """Compute the base model's readings (K, J) [counts] before noise, rounding and clipping.

    Args:
        body: the sensor.
        touches: what touches where (K,).
        change: what is another in the contact.
        moves_m: how far each taxel has moved round and along the finger (K, J, 2) [m].
    """
    change = change or ContactChange()
    elasticity, centres = body.elasticity_pa_per_m, body.centres_m
    found = np.zeros((len(touches.force_n), len(centres)))
    for row, radius in enumerate(SPHERES_M):
        at = np.flatnonzero((touches.sphere == row) & (touches.force_n > 0))
        if len(at):
            kind = ContactKind(radius + change.sphere_added_m[row], change.hardening, change.sheet_m)
            place = centres[None] if moves_m is None else centres + moves_m[at]
            arc = place[:, :, 0] - touches.arc_m[at, None]
            along = place[:, :, 1] - touches.along_m[at, None]
            force = touches.force_n[at, None] / elasticity
            found[at] = body.images.images(kind, body.alpha_deg).loads(force, arc, along)
    return body.scale_per_n * elasticity * found


def image_store(law: Law, elasticity_pa_per_m: float) -> ImageStore:
    """Fields of a law; one that is no foundation is as stiff as a foundation at usual forces."""
    alike = None if isinstance(law, Foundation) else ALIKE_N / elasticity_pa_per_m
    return ImageStore(law, LARGEST_N / elasticity_pa_per_m, alike)


def draw_body(rng: np.random.Generator, law: str) -> Body:
    """A body; ``law`` is ``foundation``, ``layer`` or ``half_space``."""
    elasticity = float(np.exp(rng.uniform(*np.log([2.4e8, 8e8]))))
    return Body(
        y_m=rng.uniform(22e-3, 25e-3),
        beta_deg=rng.uniform(0.0, 5.0),
        alpha_deg=rng.uniform(-12.0, 8.0),
        elasticity_pa_per_m=elasticity,
        scale_per_n=rng.uniform(60.0, 75.0),
        constant_m=(rng.uniform(-0.5e-3, 0.5e-3), rng.uniform(-0.4e-3, 0.4e-3)),
        sigma_m=rng.uniform(0.4e-3, 0.6e-3),
        noise_counts=1.0,
        images=image_store(_draw_law(rng, law), elasticity),
    )


def _draw_law(rng: np.random.Generator, law: str) -> Law:
    """A foundation, a half space, or a layer, thin and compressible to thick, half of the thick under a coat."""
    if law == "foundation":
        return Foundation()
    if law == "half_space":
        return HalfSpace()
    if rng.uniform() < 0.5:
        return Layer(rng.uniform(1e-3, 2.5e-3), rng.uniform(0.3, 0.48))
    return Layer(rng.uniform(3e-3, 8e-3), rng.uniform(0.42, 0.48), coat=rng.uniform(0.0, 0.6))
