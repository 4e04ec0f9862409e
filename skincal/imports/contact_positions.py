"""Rows in contact that lack a position: refused, or left out where incomplete rows may go."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from skincal.covariates import POSITION
from skincal.dataset import IDLE
from skincal.dataset.findings import Findings
from skincal.imports.cutting import phases
from skincal.imports.mapping import Mapping
from skincal.imports.mapping_file import DROP_INCOMPLETE, CsvSource
from skincal.imports.recording import Cut, Recording, Rejected, Series, Span
from skincal.imports.text_table import SourceSheet


def with_positions(
    recording: Recording, series: Series, found: Cut, mapping: Mapping, findings: Findings
) -> tuple[Recording, Series, Cut]:
    """Return a cut series without the rows in contact that lack a required position; refuse them unless they may go.

    Only the cut tells them from rows at rest, which need no position.
    """
    own = [
        q for q in mapping.quantities if q.target in mapping.required and q.target in POSITION and not q.topic
    ]
    touching = phases(series, found.spans) != IDLE
    for one in found.rejected:
        touching[one.start : one.stop] = False
    lacking = touching & np.isnan([recording.columns[q.target] for q in own]).any(axis=0)
    if not lacking.any():
        return recording, series, found
    if not (isinstance(mapping.source, CsvSource) and mapping.source.drop_incomplete):
        name = ", ".join(dict.fromkeys(source for q in own for source in q.sources))
        for part, file in enumerate(recording.files):
            rows = np.sort(recording.row[lacking & (recording.part == part)])
            if rows.size:
                place = SourceSheet(findings, file.file, file.lines).rows(name, rows)
                findings.error(place, "a position in every row of a contact", "none", DROP_INCOMPLETE)
        return recording, series, found
    kept = ~lacking
    at = np.concatenate([[0], np.cumsum(kept)]).tolist()
    spans: list[Span] = []
    rejected = [replace(one, start=at[one.start], stop=at[one.stop]) for one in found.rejected]
    for one in found.spans:
        start, hold, end, stop = at[one.start], at[one.hold], at[one.hold_stop], at[one.stop]
        if hold < end:
            spans.append(replace(one, start=start, hold=hold, hold_stop=end, stop=stop))
        else:
            rejected.append(Rejected(start, stop, "no position in its hold"))
    recording = recording.without("row", {"no position, in a contact": lacking})
    return recording, series.select(kept), Cut(tuple(spans), tuple(rejected))
