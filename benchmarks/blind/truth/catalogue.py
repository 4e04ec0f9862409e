"""The hidden effects by their names in the catalogue."""

from __future__ import annotations

from benchmarks.blind.truth import between, drift, inputs, memory, taxels, transfer
from benchmarks.blind.truth.effect import Effect

EFFECTS: dict[str, type[Effect]] = {
    kind.name: kind
    for kind in (
        memory.Hysteresis,
        memory.Creep,
        memory.Rate,
        memory.Latency,
        memory.FirstCycle,
        drift.BaselineDrift,
        drift.GainDrift,
        between.Spread,
        between.Crosstalk,
        between.Ghosting,
        transfer.Saturation,
        transfer.DeadBand,
        transfer.ResponseCurve,
        transfer.Stiffening,
        taxels.TaxelGain,
        taxels.TaxelOffset,
        taxels.DeadTaxel,
        inputs.Shear,
        inputs.ForceBias,
        inputs.ContactOffset,
        inputs.IndenterRadius,
        transfer.Cover,
    )
}
"""The catalogue."""
