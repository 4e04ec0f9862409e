"""Sessions of a coverage study that were fitted once, and are counted again as the fit makes its intervals today.

A session keeps the quantiles of its draws, for each contact law. That is enough to make its intervals anew, at any of
the kept levels, and with the scale S widened by another factor than it was.
"""

from __future__ import annotations

import gzip
import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from skincal.fitting.conclude import closed
from skincal.fitting.fit_options import SearchBox
from skincal.fitting.result import OPEN

Record = dict[str, Any]

DIGITS = 9
"""Digits that are kept of a number."""

_MADE_ANEW = ("intervals", "levels", "rank")
_SCALE = "scale_per_n"


def write_kept(path: Path, study: Record, records: Sequence[Record]) -> None:
    """Keeps the sessions of a study, a line each, compressed; what can be made anew is left out."""
    lines = [study, *({k: v for k, v in r.items() if k not in _MADE_ANEW} for r in records)]
    text = "".join(json.dumps(_rounded(line)) + "\n" for line in lines)
    path.write_bytes(gzip.compress(text.encode(), mtime=0))


def read_kept(path: Path) -> tuple[Record, list[Record]]:
    """The study that was kept, and its sessions.

    Raises:
        OSError: the file is not there, or not compressed.
    """
    study, *records = (json.loads(line) for line in gzip.decompress(path.read_bytes()).decode().splitlines())
    return study, records


def as_shipped(record: Record, quantiles: Sequence[float], levels: Sequence[float], level: float) -> Record:
    """A session with its intervals made as the fit makes them, from its kept quantiles.

    Args:
        record: of the session.
        quantiles: which quantiles of the draws it keeps.
        levels: probability contents to make intervals for.
        level: that of the fit.
    """
    # Sessions that were kept when the fit still widened its draws of S say by how much.
    widened = record.get("scale_widening", 1.0)
    if "failed" in record or ("levels" in record and widened == 1.0):
        return record
    clouds = dict(record["quantiles"])
    if _SCALE in clouds:
        factor = 1.0 / widened
        clouds[_SCALE] = [_widened(cloud, quantiles, factor) for cloud in clouds[_SCALE]]
    box = SearchBox(**{name: (low, high) for name, (low, high) in record["box"].items()})
    made = {
        str(one): {n: _interval(n, c, quantiles, record["best"][n], box, one) for n, c in clouds.items()}
        for one in (*levels, level)
    }
    if record["no_interval"]:
        made = {one: {name: list(OPEN) for name in intervals} for one, intervals in made.items()}
    anew = {"quantiles": clouds, "levels": made, "intervals": made[str(level)], "scale_widening": 1.0}
    return record | anew


def _widened(cloud: Sequence[float], quantiles: Sequence[float], factor: float) -> list[float]:
    """Quantiles of S, moved from the median by a factor in their logarithm."""
    logs = np.log(cloud)
    middle = np.interp(0.5, quantiles, logs)
    return np.exp(middle + factor * (logs - middle)).tolist()


def _interval(
    name: str,
    clouds: Sequence[Sequence[float]],
    quantiles: Sequence[float],
    best: float,
    box: SearchBox,
    level: float,
) -> list[float]:
    """Compute the interval as :func:`skincal.fitting.conclude.interval` does, from quantiles instead of draws."""
    tail = (1.0 - level) / 2
    ends = np.array([np.interp([tail, 1.0 - tail], quantiles, cloud) for cloud in clouds])
    return list(closed(name, min(float(ends[:, 0].min()), best), max(float(ends[:, 1].max()), best), box))


def _rounded(value: Any) -> Any:
    if isinstance(value, float):
        return float(f"{value:.{DIGITS}g}")
    if isinstance(value, dict):
        return {key: _rounded(item) for key, item in value.items()}
    return [_rounded(item) for item in value] if isinstance(value, list | tuple) else value
