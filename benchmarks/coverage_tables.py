"""The tables of the coverage study, from the records of its sessions."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]
Record = dict[str, Any]

SHOWN_LEVELS = ("0.9", "0.95", "0.98", "0.99")


@dataclass(frozen=True)
class Scale:
    """Unit of a parameter in the tables, and the factor to it.

    E and S are told in per cent, as differences of their logarithm: what matters of them is their ratio.
    """

    unit: str
    factor: float
    log: bool = False

    def of(self, values: Floats) -> Floats:
        """Values in this unit."""
        if not self.log:
            return values * self.factor
        with np.errstate(divide="ignore", invalid="ignore"):
            # An interval without bounds goes from -inf to inf; its logarithm shall too.
            return np.where(values > 0, np.log(values), -np.inf) * self.factor


SCALES = {
    "across_m": Scale("mm", 1e3),
    "y_m": Scale("mm", 1e3),
    "alpha_rad": Scale("°", 180 / math.pi),
    "elasticity_pa_per_m": Scale("%", 100.0, log=True),
    "scale_per_n": Scale("%", 100.0, log=True),
}


def wilson(hits: int, count: int, z: float = 1.96) -> tuple[float, float]:
    """Interval of a proportion that holds it in 95 % of studies (Wilson 1927)."""
    if count == 0:
        return 0.0, 1.0
    share = hits / count
    middle = (share + z * z / (2 * count)) / (1 + z * z / count)
    half = z * math.sqrt(share * (1 - share) / count + (z / (2 * count)) ** 2) / (1 + z * z / count)
    return max(0.0, middle - half), min(1.0, middle + half)


def summary(records: Sequence[Record], level: float) -> Record:
    """Summarize the records for each law and, where there are several, for all together.

    Args:
        records: of the sessions.
        level: probability content that the intervals of the fits claim.
    """
    laws = list(dict.fromkeys(r["law"] for r in records))
    groups = {law: [r for r in records if r["law"] == law] for law in laws}
    if len(laws) > 1:
        groups["all"] = list(records)
    return {name: _group(group, level) for name, group in groups.items()}


def _group(records: Sequence[Record], level: float) -> Record:
    fits = [r for r in records if "failed" not in r]
    found: Record = {"sessions": len(records), "failed": len(records) - len(fits), "level": level}
    if not fits:
        return found
    seconds = [r["seconds"] for r in fits]
    found |= {
        "parameters": {name: _parameter(name, fits, [r["intervals"][name] for r in fits]) for name in SCALES},
        "levels": {
            shown: {name: _parameter(name, fits, [r["levels"][shown][name] for r in fits]) for name in SCALES}
            for shown in SHOWN_LEVELS
        },
        "median_mse_counts2": float(np.median([r["mse_counts2"] for r in fits])),
        "median_valley_mse_counts2": float(np.median([r["valley_mse_counts2"] for r in fits])),
        "median_seconds": float(np.median(seconds)),
        "max_seconds": float(max(seconds)),
        "least_effective_draws": float(min(r["effective_draws"] for r in fits)),
        "presses_used": [min(r["presses_used"] for r in fits), max(r["presses_used"] for r in fits)],
        "findings": dict(Counter(code for r in fits for code in r["findings"]).most_common()),
    }
    layers = [r for r in fits if r["law"] == "layer"]
    return found | ({"equivalent_elasticity": _equivalents(layers)} if layers else {})


def _parameter(name: str, fits: Sequence[Record], intervals: Sequence[Sequence[float]]) -> Record:
    """Coverage, widths and errors of one parameter, in the unit of ``SCALES``."""
    scale = SCALES[name]
    told, best = (scale.of(np.array([r[key][name] for r in fits])) for key in ("told", "best"))
    low, high = scale.of(np.array(intervals, dtype=np.float64)).T
    below, above = told < low, told > high
    hits = int(len(fits) - below.sum() - above.sum())
    bounded = np.isfinite(high - low)
    widths = (high - low)[bounded]
    mean = float(widths.mean()) if len(widths) else math.inf
    error = float(np.sqrt(np.mean((best - told) ** 2)))
    box = fits[0]["box"].get(name)
    searched = float(np.ptp(scale.of(np.array(box)))) if box else math.nan
    return {
        "unit": scale.unit,
        "coverage": hits / len(fits),
        "coverage_95": list(wilson(hits, len(fits))),
        "truth_below": int(below.sum()),
        "truth_above": int(above.sum()),
        "unbounded": int((~bounded).sum()),
        "median_width": float(np.median(high - low)),
        "mean_width": mean,
        "mean_width_of_range": mean / searched,
        "mean_width_of_rms_error": mean / error if error else math.inf,
        "rms_error": error,
        "mean_error": float((best - told).mean()),
    }


def _equivalents(layers: Sequence[Record]) -> list[Record]:
    """Fitted E over M/h of the layer, for thin and thick, more and less compressible layers."""
    thickness = np.array([r["truth"]["thickness_m"] for r in layers])
    poisson = np.array([r["truth"]["poisson"] for r in layers])
    ratio = np.array([r["best"]["elasticity_pa_per_m"] / r["truth"]["elasticity_pa_per_m"] for r in layers])
    held = np.array([lo <= r["truth"]["elasticity_pa_per_m"] <= hi
                     for r in layers for lo, hi in [r["intervals"]["elasticity_pa_per_m"]]])  # fmt: skip
    kinds = {"all layers": np.ones(len(layers), dtype=bool)}
    for softness, some in (("nu < 0.375", poisson < 0.375), ("nu > 0.375", poisson >= 0.375)):
        kinds[f"h < 1.75 mm, {softness}"] = some & (thickness < 1.75e-3)
        kinds[f"h > 1.75 mm, {softness}"] = some & (thickness >= 1.75e-3)
    return [
        {
            "layers": kind,
            "sessions": int(some.sum()),
            "ratio_quantiles": dict(
                zip(("0.1", "0.5", "0.9"), np.quantile(ratio[some], (0.1, 0.5, 0.9)), strict=True)
            ),
            "held": int(held[some].sum()),
        }
        for kind, some in kinds.items()
        if some.any()
    ]


def as_text(found: Record) -> str:
    """The summary as tables in Markdown."""
    return "\n\n".join(_group_text(name, group) for name, group in found.items())


def _group_text(name: str, group: Record) -> str:
    title = f"## {name}: {group['sessions']} sessions, {group['failed']} failed, level {group['level']:g}"
    if "parameters" not in group:
        return title
    few, many = group["presses_used"]
    findings = ", ".join(f"{code} {count}" for code, count in group["findings"].items()) or "none"
    facts = (
        f"{few} to {many} presses used; median loss {group['median_mse_counts2']:.3f} counts², median bound of the "
        f"valley {group['median_valley_mse_counts2']:.3f}; {group['median_seconds']:.0f} s a fit, at most "
        f"{group['max_seconds']:.0f} s; at least {group['least_effective_draws']:.0f} effective draws; "
        f"findings: {findings}."
    )
    tables = [_parameter_table(group["parameters"]), _level_table(group["levels"])]
    if "equivalent_elasticity" in group and name != "all":
        tables.append(_equivalent_table(group["equivalent_elasticity"]))
    return "\n\n".join([title, facts, *tables])


def _parameter_table(parameters: Record) -> str:
    rows = [
        [
            name,
            f"{100 * p['coverage']:.0f} %",
            "{:.0f} to {:.0f} %".format(*(100 * c for c in p["coverage_95"])),
            f"{p['truth_below']} / {p['truth_above']}",
            f"{p['median_width']:.3g} {p['unit']}",
            f"{p['mean_width']:.3g} {p['unit']}"
            + (f" ({p['unbounded']} unbounded)" if p["unbounded"] else ""),
            "" if math.isnan(p["mean_width_of_range"]) else f"{100 * p['mean_width_of_range']:.1f} %",
            f"{p['mean_width_of_rms_error']:.1f}",
            f"{p['rms_error']:.3g} {p['unit']}",
            f"{p['mean_error']:+.2g} {p['unit']}",
        ]
        for name, p in parameters.items()
    ]
    head = ["parameter", "held", "95 % of that", "truth below / above", "median width", "mean width",
            "of the range", "of the RMS error", "RMS error", "mean error"]  # fmt: skip
    return _table(head, rows)


def _level_table(levels: Record) -> str:
    names = list(SCALES)
    rows = [
        [
            level,
            *(
                f"{100 * by_name[n]['coverage']:.0f} %, {by_name[n]['mean_width']:.3g} {SCALES[n].unit}"
                for n in names
            ),
        ]
        for level, by_name in levels.items()
    ]
    return _table(["level: held, mean width", *names], rows)


def _equivalent_table(kinds: Sequence[Record]) -> str:
    rows = [
        [
            kind["layers"],
            str(kind["sessions"]),
            " / ".join(f"{q:.2f}" for q in kind["ratio_quantiles"].values()),
            f"{kind['held']} of {kind['sessions']}",
        ]
        for kind in kinds
    ]
    return _table(["layers", "sessions", "fitted E over M/h: 10 / 50 / 90 %", "interval holds M/h"], rows)


def _table(head: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    lines = [list(head), ["---"] * len(head), *(list(row) for row in rows)]
    return "\n".join(f"| {' | '.join(line)} |" for line in lines)
