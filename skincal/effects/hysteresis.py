"""At the same force the signal differs between loading and unloading.

    y = x + h (mean of z_k - x),    z_k <- min(max(z_k, x), (1 + w_k) x),    w_k = w k / n,  k = 1 ... n

A Prandtl-Ishlinskii sum of n generalised play operators whose two curves, x and (1 + w_k) x, both pass through the
origin: while the load x rises, all z_k follow it and the signal is the base model's; when it falls, each z_k stays
until the load has fallen by the part w_k / (1 + w_k). The loop is wide between the ends and closes at the peak and at
rest, does not depend on speed, and grows in proportion to the load.
"""

from __future__ import annotations

import numpy as np

from skincal.effects.effect import MemoryEffect, State
from skincal.effects.parameter import Values, form, start, strength
from skincal.effects.recursion import Loop
from skincal.effects.samples import Samples
from skincal.model.arrays import FloatArray

_OPERATORS = 6
"""Number of play operators that approximate the continuum."""


class Hysteresis(MemoryEffect):
    name = "hysteresis"
    # The base model may be the middle of the loop as well as its lower curve, and a press has little of the other one.
    zero_error = 2.0
    meaning = "at the same force the signal differs between loading and unloading"
    parameters = (
        strength("height", "-", 0.0, -0.8, 1.5, "h: weight of what lags behind", typical=0.45),
        form("width", "-", 1.5, 0.05, 8.0, "w: how far the unloading curves reach", scale="log"),
    )
    search_from = tuple(start({"height": 0.2, "width": w}) for w in (0.5, 1.5, 4.0))
    asks = ("unloading",)
    shows = "loop"
    source = (
        "Visintin, Differential Models of Hysteresis, 1994 (generalised play); on tactile sensors: "
        "Sánchez-Durán et al., Sensors 15 (2015) 26170, doi 10.3390/s151026170."
    )

    def prepare(self) -> None:
        _PLAY.prepare()

    def run(
        self, loads_n: FloatArray, samples: Samples, values: Values, state: State
    ) -> tuple[FloatArray, State]:
        widths = values.number("width") * np.arange(1, _OPERATORS + 1) / _OPERATORS
        lagging, state = _played(loads_n, 1.0 + widths, state)
        return loads_n + values["height"] * (lagging - loads_n), state


def _played(x: FloatArray, upper: FloatArray, state: FloatArray | None) -> tuple[FloatArray, FloatArray]:
    """Return the mean of play operators (K, J) over loads (K, J) >= 0, and the operators (n, J) after the last."""
    z = np.zeros((len(upper), x.shape[1])) if state is None else state.copy()
    mean = np.zeros(x.shape)
    _PLAY(np.array(x), np.array(upper), z, mean)
    return mean, z


def _play(
    x: FloatArray, upper: FloatArray, z: FloatArray, mean: FloatArray
) -> None:  # pragma: no cover - compiled
    for k in range(len(x)):
        for n in range(len(upper)):
            for j in range(x.shape[1]):
                z[n, j] = min(max(z[n, j], x[k, j]), upper[n] * x[k, j])
                mean[k, j] += z[n, j]
        for j in range(x.shape[1]):
            mean[k, j] /= len(upper)


_PLAY = Loop(_play, "void(f8[:, ::1], f8[::1], f8[:, ::1], f8[:, ::1])")
