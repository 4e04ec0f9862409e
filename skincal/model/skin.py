"""The skin: contacts in, tactile images out (paper, section II-A)."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np

from skincal.model.arrays import FloatArray, floats, positive
from skincal.model.contact import Contacts
from skincal.model.converter import Converter
from skincal.model.indenters import Indenter
from skincal.model.law import ContactLaw, StressLaw
from skincal.model.patch import Patch
from skincal.model.press.status import Status
from skincal.model.pressures import Pressures, pressures
from skincal.model.response import SkinResponse, loads, respond
from skincal.model.spreading import little_spread


@dataclass(frozen=True, eq=False)
class SkinParameters:
    """What the calibration finds.

    Attributes:
        elasticity_pa_per_m: E, stress per local penetration [Pa/m].
        scale_per_n: S, counts per newton on a taxel [1/N]: one number, or one for each taxel (J,).
    """

    elasticity_pa_per_m: float
    scale_per_n: float | FloatArray

    def __post_init__(self) -> None:
        elasticity = positive("elasticity_pa_per_m", self.elasticity_pa_per_m)
        object.__setattr__(self, "elasticity_pa_per_m", elasticity)
        scale = np.asarray(self.scale_per_n, dtype=np.float64)
        checked = floats("scale_per_n", scale, (None,) * min(scale.ndim, 1))
        object.__setattr__(self, "scale_per_n", float(checked) if scale.ndim == 0 else checked)


@dataclass(frozen=True, eq=False)
class Skin:
    """A patch of skin with its parameters and converter.

    Attributes:
        patch: the tactile points.
        parameters: E and S.
        converter: what happens after the scale.
        law: how stress grows with penetration; None: in proportion, which is the paper's.
        contact: how the contact differs from the elastic foundation beside; None: not at all.
    """

    patch: Patch
    parameters: SkinParameters
    converter: Converter = field(default_factory=Converter)
    law: StressLaw | None = None
    contact: ContactLaw | None = None

    def __post_init__(self) -> None:
        scale = np.asarray(self.parameters.scale_per_n)
        if scale.ndim and len(scale) != self.patch.layout.taxels:
            raise ValueError(
                f"scale_per_n: expected one number or {self.patch.layout.taxels}; got {len(scale)}"
            )

    def respond(self, indenter: Indenter, contacts: Contacts) -> SkinResponse:
        """Loads, penetration and force of every contact.

        A force of zero or less, and a press that touches no point, give no load; a force that is NaN or
        infinite, or a place with NaN, gives NaN; :attr:`SkinResponse.status` says which. A press that reaches the
        border of the patch or lies outside it, but touches it, is carried by the points it touches.

        Args:
            indenter: what presses.
            contacts: K contacts.
        """
        found = respond(self.patch, self.parameters.elasticity_pa_per_m, *self._pressed(indenter, contacts))
        if self.spreading is None:
            return found
        return replace(found, loads_n=self.pressures(indenter, contacts).loads(self.spreading))

    def prepare(self, indenter: Indenter) -> None:
        """Compiles what a press needs, or loads it from the cache, so that the first press of a session is not late.

        Args:
            indenter: what will press.
        """
        self.respond(indenter, Contacts(self.patch.points_m[:1], self.patch.normals[:1], np.ones(1)))

    def loads(self, indenter: Indenter, contacts: Contacts) -> FloatArray:
        """Loads on the taxels (K, J) [N], before the scale.

        The sum over T_j of E eps_i a_i max(n_c . n_t,i, 0) max(-n_s,i . n_c, 0) (paper, equation 4). A press that
        goes through the finger has the loads of the formula; ask :meth:`respond` for its status, or :meth:`image`.

        Raises:
            ValueError: an indenter that falls between the tactile points.
        """
        return self._loads(indenter, contacts, (Status.FINER_THAN_POINTS,))

    @cached_property
    def spreading(self) -> FloatArray | None:
        """Weights (N, J) of points in taxels by the contact law; None: each counts where it lies."""
        variance = 0.0 if self.contact is None else self.contact.spread_m2
        return little_spread(self.patch, variance) if variance else None

    def _pressed(self, indenter: Indenter, contacts: Contacts) -> tuple[Indenter, Contacts, StressLaw | None]:
        """What presses how, by the contact law."""
        if self.contact is None:
            return indenter, contacts, self.law
        return self.contact.pressed_by(indenter), contacts, self.contact.stress(self.law)

    def _loads(self, indenter: Indenter, contacts: Contacts, refuse: tuple[Status, ...]) -> FloatArray:
        elasticity, pressed = self.parameters.elasticity_pa_per_m, self._pressed(indenter, contacts)
        found = loads(self.patch, elasticity, *pressed, refuse=refuse)
        return found if self.spreading is None else self.pressures(indenter, contacts).loads(self.spreading)

    def pressures(self, indenter: Indenter, contacts: Contacts) -> Pressures:
        """Where each contact presses how hard, tactile point by tactile point: the terms of the sums of :meth:`loads`.

        Args:
            indenter: what presses.
            contacts: K contacts.
        """
        return pressures(self.patch, self.parameters.elasticity_pa_per_m, *self._pressed(indenter, contacts))

    def values(self, indenter: Indenter, contacts: Contacts) -> FloatArray:
        """Taxel values T_j (K, J) = S_j times the load [counts], neither rounded nor clipped."""
        return self.loads(indenter, contacts) * self.parameters.scale_per_n

    def image(self, indenter: Indenter, contacts: Contacts) -> FloatArray:
        """Tactile images (K, J) [counts], through the converter. Reshape to (K, rows, cols) to look at them.

        Raises:
            ValueError: an indenter that falls between the tactile points, or a force that pushes it through the finger.
        """
        refuse = (Status.FINER_THAN_POINTS, Status.THROUGH_FINGER)
        return self.converter.apply(self._loads(indenter, contacts, refuse) * self.parameters.scale_per_n)
