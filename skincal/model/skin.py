"""The skin: contacts in, tactile images out (paper, section II-A); its converter, and the spreading of loads."""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike

from skincal.model.arrays import FloatArray, IntArray, floats, positive
from skincal.model.contact import Contacts
from skincal.model.indenters import Indenter
from skincal.model.law import ContactLaw, StressLaw
from skincal.model.layout import TaxelLayout
from skincal.model.patch import Patch
from skincal.model.press.call import Entries, press
from skincal.model.response import Pressures, SkinResponse, Status, refuse


@dataclass(frozen=True)
class Converter:
    """The last stage of the skin: round, then clip (the paper's sensor: whole numbers from 0 to 255).

    Attributes:
        value_min: lowest value [counts]; ``None`` for no clipping below.
        value_max: highest value [counts]; ``None`` for no clipping above.
        integer: round to the nearest whole number (halves to the even one, as numpy does).
    """

    value_min: float | None = 0.0
    value_max: float | None = 255.0
    integer: bool = True

    def __post_init__(self) -> None:
        low = -np.inf if self.value_min is None else self.value_min
        high = np.inf if self.value_max is None else self.value_max
        if not low < high:
            raise ValueError(
                f"converter: expected value_min < value_max; got {self.value_min} and {self.value_max}"
            )

    @classmethod
    def none(cls) -> Converter:
        """Return a converter that changes nothing."""
        return cls(value_min=None, value_max=None, integer=False)

    def apply(self, values: ArrayLike) -> FloatArray:
        """Return counts for values of any shape [counts]; NaN stays NaN."""
        counts = np.array(values, dtype=np.float64)
        if self.integer:
            np.rint(counts, out=counts)
        if self.value_min is not None:
            np.maximum(counts, self.value_min, out=counts)
        return counts if self.value_max is None else np.minimum(counts, self.value_max, out=counts)


@dataclass(frozen=True, eq=False)
class SkinParameters:
    """Parameters that a calibration estimates.

    Attributes:
        elasticity_pa_per_m: E, stress per local penetration [Pa/m].
        scale_per_n: S, counts per newton on a taxel [1/N]: one number, or one per taxel (J,).
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
        converter: stage after the scale.
        law: stress as a function of penetration; None: proportional, as in the paper.
        contact: deviation of the contact from an elastic foundation; None: no deviation.
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
        """Return loads, penetration and force of every contact.

        The load is zero for a force of zero or less and for a press that touches no point. It is NaN for a force that
        is NaN or infinite and for a position with NaN. :attr:`SkinResponse.status` distinguishes these cases. If a
        press reaches beyond the border of the patch, the points that it touches carry the whole force.
        """
        loads, info = self._press(indenter, contacts)
        points, status = info[:, 5:7].astype(np.int64).T
        return SkinResponse(
            self._spread(loads, indenter, contacts), info[:, 0], info[:, 1], info[:, 2:5], points, status
        )

    def prepare(self, indenter: Indenter) -> None:
        """Compile the routine for an indenter, or load it from the cache, so that the first press is not delayed."""
        self.respond(indenter, Contacts(self.patch.points_m[:1], self.patch.normals[:1], np.ones(1)))

    def loads(self, indenter: Indenter, contacts: Contacts) -> FloatArray:
        """Return the loads on the taxels (K, J) [N], before the scale.

        The load is the sum over T_j of E eps_i a_i max(n_c . n_t,i, 0) max(-n_s,i . n_c, 0) (paper, equation 4). This
        also holds for a press that goes through the finger: :meth:`respond` reports it, and :meth:`image` refuses it.

        Raises:
            ValueError: an indenter falls between the tactile points.
        """
        return self._loads(indenter, contacts, Status.FINER_THAN_POINTS)

    def values(self, indenter: Indenter, contacts: Contacts) -> FloatArray:
        """Return taxel values T_j (K, J) = S_j times the load [counts], neither rounded nor clipped."""
        return self.loads(indenter, contacts) * self.parameters.scale_per_n

    def image(self, indenter: Indenter, contacts: Contacts) -> FloatArray:
        """Return tactile images (K, J) [counts], through the converter. Reshape to (K, rows, cols) to plot them.

        Raises:
            ValueError: an indenter falls between the tactile points, or is pushed through the finger.
        """
        loads = self._loads(indenter, contacts, Status.FINER_THAN_POINTS, Status.THROUGH_FINGER)
        return self.converter.apply(loads * self.parameters.scale_per_n)

    def pressures(self, indenter: Indenter, contacts: Contacts) -> Pressures:
        """Return the load of each contact on each tactile point: the terms of the sums of :meth:`loads`."""
        # The first pass counts the points in contact, the second fills the arrays.
        _, info = self._press(indenter, contacts)
        starts = np.cumsum(np.append(0, info[:, 5])).astype(np.int64)
        points, load_n = np.zeros(starts[-1], dtype=np.int64), np.zeros(starts[-1])
        self._press(indenter, contacts, (starts[:-1].copy(), points, load_n))
        known = info[:, 6] != Status.UNKNOWN
        return Pressures(starts, self.patch.tiled.index[points], load_n, known, len(self.patch))

    @cached_property
    def spreading(self) -> FloatArray | None:
        """Weights (N, J) of points in taxels by the contact law; None without spreading."""
        variance = 0.0 if self.contact is None else self.contact.spread_m2
        return spread_weights(self.patch, variance) if variance else None

    def _press(
        self, indenter: Indenter, contacts: Contacts, entries: Entries | None = None
    ) -> tuple[FloatArray, FloatArray]:
        """Press under the contact law; see :func:`skincal.model.press.call.press`."""
        law, elasticity = self.law, self.parameters.elasticity_pa_per_m
        if self.contact is not None:
            elasticity *= self.contact.stiffness(indenter, law)
            indenter, law = self.contact.equivalent_indenter(indenter), self.contact.stress(law)
        return press(self.patch, elasticity, indenter, contacts, law, entries)

    def _loads(self, indenter: Indenter, contacts: Contacts, *refused: Status) -> FloatArray:
        loads, info = self._press(indenter, contacts)
        refuse(indenter, contacts, info, *refused)
        return self._spread(loads, indenter, contacts)

    def _spread(self, loads: FloatArray, indenter: Indenter, contacts: Contacts) -> FloatArray:
        if self.contact is None or self.spreading is None:
            return loads
        return self.pressures(indenter, contacts).loads(self.spreading)


_WIDTH_M = 3e-4
"""Standard deviation of the Gaussian for the finite difference [m]: about a cell, so that the points resolve it."""


def spread_weights(patch: Patch, variance_m2: float) -> FloatArray:
    """Return weights (N, J) of points in taxels for a spreading of small variance, linearised in the variance.

    The weights are extrapolated from no spreading and one Gaussian of fixed width; a negative variance sharpens.

    Args:
        patch: the tactile points.
        variance_m2: variance along each axis [m²].

    Raises:
        ValueError: the patch lacks the coordinates of its points.
    """
    if patch.uv_m is None:
        raise ValueError("spreading: expected a patch cut from a surface; got one without uv_m")
    own = np.zeros((len(patch), patch.layout.taxels))
    sensed = patch.taxel >= 0
    own[sensed, patch.taxel[sensed]] = 1.0
    widths = np.array([np.sqrt(2.0) * _WIDTH_M])
    (across, column), (along, row) = (gaussian_parts(patch.uv_m, patch.layout, widths, k) for k in (0, 1))
    return own + variance_m2 / _WIDTH_M**2 * (across[0][column] * along[0][row] - own)


def gaussian_parts(
    uv: FloatArray, layout: TaxelLayout, widths: FloatArray, axis: int
) -> tuple[FloatArray, IntArray]:
    """Return the fractions of Gaussians around points that lie on taxels, along one axis.

    Points of a patch lie in rows and columns, so that the error functions are computed once per row or column.

    Args:
        uv: (N, 2) points in patch coordinates [m].
        layout: the taxels.
        widths: (m,) root of twice the variance of each Gaussian [m].
        axis: 0 across, 1 along.

    Returns:
        Fractions (m, n, J) for m widths at the n distinct coordinates, and the index (N,) of each point's coordinate.
    """
    from scipy.special import erf  # slow import, and few skins have a cover

    places, which = np.unique(uv[:, axis], return_inverse=True)
    half = layout.sizes_m[:, axis] / 2
    lower, upper = (
        np.asarray(
            erf((layout.centres_m[:, axis] + side * half - places[:, None]) / widths[:, None, None]),
            dtype=np.float64,
        )
        for side in (-1, 1)
    )
    return (upper - lower) / 2, np.asarray(which, dtype=np.int64)
