"""A taxel leaks along its row and column, and a little everywhere.

    y_j = x_j + r (sum of x_i over the rest of the row) + c (sum of x_i over the rest of the column)
              + d (sum of x_i over taxels that share neither)

In an array whose taxels share row and column wires, currents find parallel paths. To first order in the resistance of
wires and multiplexers, a taxel gets a part of all taxels that share a wire with it. Taxels that conduct when unloaded
also connect wires with each other, so that a part of the load reaches every taxel.
"""

from __future__ import annotations

from skincal.effects.effect import SignalEffect, Stage
from skincal.effects.parameter import Values, start, strength
from skincal.effects.samples import Samples, Setting
from skincal.model.arrays import FloatArray


class Ghosting(SignalEffect):
    name = "ghosting"
    stage = Stage.CROSSTALK
    errs_over = "place"
    meaning = "a taxel leaks along its row and column, and a little everywhere"
    parameters = (
        strength("row_leak", "-", 0.0, -0.2, 0.5, "r: part of each taxel in the row", typical=0.06),
        strength("column_leak", "-", 0.0, -0.2, 0.5, "c: part of each taxel in the column", typical=0.06),
        strength(
            "array_leak", "-", 0.0, -0.1, 0.2, "d: part of each taxel that shares neither", typical=0.015
        ),
    )
    search_from = (
        start({"row_leak": 0.03}, {"column_leak": 0.03}, {"array_leak": 0.01}),
        start({"row_leak": 0.03}, {"column_leak": 0.03}),
    )
    shows = "places"
    source = (
        "Parallel paths in resistive arrays: Hidalgo-López et al., J. Sensors 2018, Improving Accuracy in the "
        "Readout of Resistive Sensor Arrays; Wu et al., Sensors 14 (2014) 12816."
    )

    def apply(self, signal: FloatArray, samples: Samples, values: Values, setting: Setting) -> FloatArray:
        row, column, elsewhere = setting.wires
        leaks = values["row_leak"] * row + values["column_leak"] * column
        return signal + signal @ (leaks + values["array_leak"] * elsewhere)
