"""A taxel leaks along its row and column, and a little everywhere.

    y_j = x_j + r (sum of x_i over the rest of the row) + c (sum of x_i over the rest of the column)
              + d (sum of x_i over taxels that share neither)

In an array whose taxels share row and column wires, currents find parallel paths. To first order in the resistance of
wires and multiplexers, a taxel gets a part of all taxels that share a wire with it. Taxels that conduct when unloaded
also connect wires with each other, so that a part of the load reaches every taxel.
"""

from __future__ import annotations

from skincal.effects.effect import SignalEffect, Stage
from skincal.effects.parameter import EffectParameter, Values
from skincal.effects.samples import Samples
from skincal.effects.setting import Setting
from skincal.effects.starts import Scene, Start, start
from skincal.model.arrays import FloatArray


class Ghosting(SignalEffect):
    """The effect ``ghosting``, with the equation of the module."""

    name = "ghosting"
    stage = Stage.CROSSTALK
    meaning = "a taxel leaks along its row and column, and a little everywhere"
    parameters = (
        EffectParameter(
            "row_leak", "-", 0.0, -0.2, 0.5, "r: part that each taxel of the row gets", typical=0.06
        ),
        EffectParameter(
            "column_leak", "-", 0.0, -0.2, 0.5, "c: part that each taxel of the column gets", typical=0.06
        ),
        EffectParameter(
            "array_leak",
            "-",
            0.0,
            -0.1,
            0.2,
            "d: part that each taxel in other rows and columns gets",
            typical=0.015,
        ),
    )
    shows = "places"
    source = (
        "Parallel paths in resistive arrays: Hidalgo-López et al., J. Sensors 2018, Improving Accuracy in the "
        "Readout of Resistive Sensor Arrays; Wu et al., Sensors 14 (2014) 12816."
    )

    def starts(self, scene: Scene) -> tuple[Start, ...]:
        """See :meth:`Effect.starts`."""
        del scene
        one = ({"row_leak": 0.03}, {"column_leak": 0.03}, {"array_leak": 0.01})
        return (start(*one), start(*one[:2]))

    def apply(self, signal: FloatArray, samples: Samples, values: Values, setting: Setting) -> FloatArray:
        """See :meth:`SignalEffect.apply`."""
        del samples
        leaks = values["row_leak"] * setting.same_row + values["column_leak"] * setting.same_column
        return signal + signal @ (leaks + values["array_leak"] * setting.elsewhere)
