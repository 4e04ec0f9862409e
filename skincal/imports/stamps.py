"""The clock of text files: stamps are read as numbers, dates or times of day, then repaired and checked."""

from __future__ import annotations

import re
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass
from datetime import datetime
from typing import Literal

import numpy as np

from skincal.dataset.findings import Findings, listed
from skincal.imports import clock, targets
from skincal.imports.mapping import Quantity
from skincal.imports.mapping_file import CsvFormat
from skincal.imports.recording import FloatArray, IntArray, runs
from skincal.imports.text_table import TextTable

Kind = Literal["number", "date", "day"]

TIME_OF_DAY = r"\d{1,2}:\d{2}:\d{2}(?:\.\d+)?"

DATE_MARKS = ("%d", "%j", "%x", "%c", "%D", "%F", "%s")
"""Directives of a format that give the date; without them it describes a time of day."""

DATE_FORMATS = (
    *((date + hours).strip()
    for date in ("", "%d.%m.%Y ", "%d/%m/%Y ", "%m/%d/%Y ", "%d-%m-%Y ", "%d %b %Y ", "%d-%b-%Y ", "%Y%m%d ")
    for hours in (
        "%H:%M:%S.%f", "%H:%M:%S", "%H:%M:%S:%f", "%I:%M:%S.%f %p", "%I:%M:%S %p", "%H-%M-%S.%f", "%H.%M.%S.%f",
        "%H:%M:%S,%f",
    )),
    "%M:%S.%f", "%M:%S,%f", "%M:%S",
)  # fmt: skip

COMMA = re.compile(r"^(\d{4}-\d\d-\d\d[T ]\d\d:\d\d:\d\d),(\d)")
"""A date of ISO 8601 with a comma before the fraction of a second."""

ALONE = 2
"""Stamps in succession that may be wrong although the clock was not set."""

HOUR_S = 3600.0

FASTEST_HZ, SLOWEST_HZ = 2e4, 0.1
"""Frame rates of a tactile sensor beyond which the unit of the stamps is wrong [Hz]."""

USUAL_STEP_S = 0.01
"""Of several units, the one whose usual step is nearest to this is proposed."""


@dataclass(frozen=True)
class Clock:
    """The clock of the files of one device: ascending times [s] of the rows of each file, and the order of the rows.

    ``kind`` is ``day`` for times of day, ``date`` for times since 1970, ``number`` for any others.
    """

    times_s: tuple[FloatArray, ...]
    rows: tuple[IntArray, ...]
    kind: Kind
    notes: tuple[str, ...] = ()


def read_clock(
    tables: Sequence[TextTable],
    time: Quantity | None,
    form: CsvFormat,
    findings: Findings,
    *,
    own_clocks: bool = False,
    slow: bool = False,
) -> Clock:
    """Return the clock of some files, in the order of the session.

    ``time`` is the source of the stamps, None for rows at ``rate_hz``. Unless each file has its own clock, a wrap may
    lie between two files; ``slow`` says that minutes may lie between two rows, as in a list of places.
    """
    sizes = [table.rows for table in tables]
    if time is None or not time.sources:
        counted = tuple(map(np.arange, sizes))
        if time is not None:
            fix = "Set rate_hz in [csv] instead."
            findings.error(time.place, "stamps", "the same time in every row", fix)
        return Clock(tuple(rows / (form.rate_hz or 1.0) for rows in counted), counted, "number")
    read = [_stamps(table, time) for table in tables]
    kinds = {kind for _, kind in read}
    if len(kinds) > 1:
        findings.error(time.place, "dates, or times of day, in all files", "both")
    kind = read[0][1]
    if kind == "number":
        _check_unit([stamps for stamps, _ in read], time, findings, slow=slow)
    groups = [[i] for i in range(len(tables))] if own_clocks else [[*range(len(tables))]]
    times: list[FloatArray] = []
    notes: list[str] = []
    for group in groups:
        stamps = np.concatenate([read[i][0] for i in group])
        ends = np.cumsum([sizes[i] for i in group])[:-1]
        mended, said = _mended(stamps, time, kind, findings)
        times += np.split(time.si(mended), ends)
        notes += said
    rows = [np.arange(size) for size in sizes]
    if form.order == "time":
        # Only a clock that runs on can be sorted: of one that wrapped, the end would come first.
        rows = [_by_time(table, part, time, findings) for table, part in zip(tables, times, strict=True)]
        times = [part[order] for part, order in zip(times, rows, strict=True)]
    for table, time_s in zip(tables, times, strict=True):
        _check_order(table, time_s, time, findings)
    if equal := sum(int((np.diff(part) == 0).sum()) for part in times):
        said = f"{equal} rows have the stamp of the previous row"
        notes.append(f"{time.place}: {said}; they were spread evenly up to the next stamp")
    times_s = tuple(clock.spread_equal(part) if len(part) else part for part in times)
    return Clock(times_s, tuple(rows), kind, tuple(dict.fromkeys(notes)))


def _stamps(table: TextTable, time: Quantity) -> tuple[FloatArray, Kind]:
    """Return the stamps of a file in the source's numbers, or in seconds; NaN where missing."""
    name = time.sources[0]
    if time.unit.name != targets.DATETIME:
        # The second part adds less than the steps of the first: seconds and nanoseconds.
        factors = time.parts or (1.0,)
        columns = (table.numbers(name) for name in time.sources)
        stamps = sum((f * c for f, c in zip(factors, columns, strict=True)), np.zeros(table.rows))
        return np.where(np.isfinite(stamps), stamps, np.nan), "number"
    import pandas as pd

    parts = zip(*map(table.text, time.sources), strict=True)
    cells = pd.Series([" ".join(map(str.strip, row)).strip() for row in parts], dtype=object)
    given = cells.to_numpy() != ""
    day = cells.str.replace(",", ".").str.fullmatch(TIME_OF_DAY).to_numpy(dtype=bool)
    if not time.format and day.any() and (day | ~given).all():
        parsed = pd.to_timedelta(cells.where(given).str.replace(",", "."), errors="coerce")
        return np.asarray(parsed.dt.total_seconds(), dtype=np.float64), "day"
    # Stamps without a zone share one, which does not matter.
    form = time.format or "ISO8601"
    # ISO 8601 allows a comma before the fraction of a second; pandas does not.
    plain = cells if time.format else cells.str.replace(COMMA, r"\1.\2", regex=True)
    dates = pd.to_datetime(plain.where(given), errors="coerce", utc=True, format=form)
    wrong = given & dates.isna().to_numpy()
    expected, fix = f'a date and time like "{time.format}" (format)', ""
    if not time.format:
        expected = (
            "a date and time like 2026-11-20 12:00:00.250, or in all rows a time of day like 12:00:00.250"
        )
        fix = _format_hint(next((str(cell) for cell in cells.to_numpy()[wrong]), ""))
    table.sheet.bad_rows(name, wrong, cells.to_numpy(), expected, fix)
    if time.format and not any(mark in time.format for mark in DATE_MARKS):
        within = dates - dates.dt.normalize()
        return np.asarray(within.dt.total_seconds(), dtype=np.float64), "day"
    since = (dates - pd.Timestamp("1970-01-01", tz="UTC")).dt.total_seconds()
    return np.asarray(since, dtype=np.float64), "date"


def _format_hint(cell: str) -> str:
    """Return the advice for a date that is not in ISO 8601: its format, where only one fits."""
    fitting: list[str] = []
    for form in DATE_FORMATS:
        with suppress(ValueError):
            datetime.strptime(cell, form)
            fitting.append(form)
    if not fitting:
        return 'Dates of another form need a format, like "%d.%m.%Y %H:%M:%S.%f".'
    return "Set " + " or ".join(f'format = "{form}"' for form in fitting) + "."


def _mended(
    stamps: FloatArray, time: Quantity, kind: Kind, findings: Findings
) -> tuple[FloatArray, list[str]]:
    """Return the stamps without wraps and gaps, and a report of the repairs."""
    notes: list[str] = []
    wraps = None
    if time.wraps_at is not None:
        wraps = clock.wraps_of(stamps, time.wraps_at)
    elif kind != "date":
        wraps = clock.find_wraps(stamps, 1.0 if kind == "day" else abs(time.scale) * time.unit.factor)
    if wraps is not None and wraps.rows.size:
        stamps = clock.unwrapped(stamps, wraps)
        times = "once" if wraps.rows.size == 1 else f"{wraps.rows.size} times"
        where = listed(wraps.rows[:3] + 1, wraps.rows.size)
        period = f"{wraps.period:.12g}"
        got = f"wraps at {period}{f' ({wraps.words})' if wraps.words else ''} {times}, before row {where}"
        if wraps.words and kind == "number":
            findings.note(
                time.place, "a clock that runs on", f"one that {got}",
                f"It was unwrapped. To set the period: wraps_at = {period} there.",
                code="counter_wrapped", mapping=f"wraps_at = {period}",
            )  # fmt: skip
        else:
            notes.append(f"{time.place}: the clock {got}; it was unwrapped")
    missing = int(np.isnan(stamps).sum())
    if 0 < missing < len(stamps):
        said = f"{missing} rows have no stamp; they were placed evenly between their neighbours"
        notes.append(f"{time.place}: {said}")
        stamps = clock.with_missing(stamps)
    return stamps, notes


def _check_unit(stamps: Sequence[FloatArray], time: Quantity, findings: Findings, *, slow: bool) -> None:
    """Check the unit of stamps by the steps between rows, and by their magnitude if they count from 1970."""
    stamps = [part for part in stamps if np.isfinite(part).any()]
    if not stamps:  # reported with the order of the rows
        return
    together = np.concatenate(stamps) * abs(time.scale)
    known = {name: targets.FACTORS[targets.TIME][name] for name in ("s", "ms", "us", "ns")}
    factor = time.unit.factor
    raw = max((clock.usual_step(part) for part in stamps), default=0.0) * abs(time.scale)
    if raw == 0 and np.nanmin(together) == np.nanmax(together):
        got = f"{np.nanmedian(together):.10g} in every row"
        fix = "Single precision does not hold seconds since 1970. Set rate_hz in [csv] instead."
        findings.error(time.place, "stamps that grow from row to row", got, fix)
        return
    if any(_clock_digits(part) for part in stamps):
        expected, got = f'times in "{time.unit.name}"', "times of day written as HHMMSS"
        fix = 'Set unit = "datetime" and format = "%H%M%S.%f" (without .%f if they have no decimals).'
        findings.error(f"{time.place} unit", expected, got, fix)
        return
    each = [clock.epoch_unit(part * abs(time.scale), known) for part in stamps]
    if None not in each and len(set(each)) > 1:
        got = "files in " + ", ".join(f'"{name}"' for name in each)
        fix = "As times since 1970 they are in these units. Convert the files to one unit."
        findings.error(f"{time.place} unit", "stamps in one unit", got, fix)
        return
    found, middle = clock.epoch_unit(together, known), float(np.nanmedian(together))
    wrong = 0 < raw * factor < 1 / FASTEST_HZ or (raw * factor > 1 / SLOWEST_HZ and not slow)
    if found not in (None, time.unit.name) and (wrong or middle * factor > clock.DAY_S * 365 * 130):
        got, fix = f"stamps of about {middle:.0f}", f'As times since 1970 they are in "{found}".'
    elif wrong and found in (None, time.unit.name) and time.unit.name in known:
        likely = min(known, key=lambda name: abs(np.log(raw * known[name] / USUAL_STEP_S)))
        got, fix = f"steps of {raw * factor:.3g} s", f'They seem to be in "{likely}".'
    else:
        return
    findings.error(f"{time.place} unit", "the unit of the stamps", f'"{time.unit.name}", and {got}', fix)


def _clock_digits(stamps: FloatArray) -> bool:
    """Return whether stamps are times of day written as one number, HHMMSS: they jump by 40 at full minutes."""
    given = stamps[np.isfinite(stamps)]
    steps = np.diff(given)
    over = np.where(steps > 4000, steps - 4000, steps) - 40  # a full hour, or a full minute
    largest = 1 + clock.LARGEST_STEP * clock.usual_step(stamps)
    at = np.flatnonzero(((over > 0) & (over < largest)) | (steps < -235900))
    digits = (given % 100 < 60).all() and (given // 100 % 100 < 60).all() and given.max() < 240000
    return bool(at.size and digits and (given[at] % 100 > 55).all() and (given[at + 1] % 100 < 5).all())


def _by_time(table: TextTable, time_s: FloatArray, time: Quantity, findings: Findings) -> IntArray:
    """Return the order of rows by their times; warn where it moves rows farther than if they were written late."""
    rows = np.argsort(time_s, kind="stable")
    moved, steps = np.abs(rows - np.arange(len(rows))), np.diff(time_s)
    if (moved > clock.DISPLACED).any() and (steps > 0).any():  # not where the last row is the first event
        back, largest = int(np.argmin(steps)), float(np.diff(time_s[rows]).max())
        findings.warn(
            table.sheet.rows(time.sources[0], [back + 1]),
            f'rows at most {clock.DISPLACED} places from the order of their stamps, for order = "time"',
            f"{-steps[back]:.6g} s back: {(moved > clock.DISPLACED).sum()} rows were moved farther, by "
            f"{moved.max()} at most; the largest step is now {largest:.6g} s",
            "If the clock was set, restarted or wrapped there, these rows are now in the wrong order: remove order, "
            "and follow the advice on that row. If a stamp is wrong, empty its cell.",
        )  # fmt: skip
    return rows


def _check_order(table: TextTable, time_s: FloatArray, time: Quantity, findings: Findings) -> None:
    """Check that times follow the order of rows; a step back without a wrap is an error with its likely cause."""
    if not np.isfinite(time_s).all():
        if not findings.errors:
            findings.error(f"{table.sheet.file}, {time.place}", "stamps", "none in any row")
        return
    back = np.flatnonzero(np.diff(time_s) < 0) + 1
    if not back.size:
        steps, usual = np.diff(time_s), clock.LARGEST_STEP * clock.usual_step(time_s)
        whole = np.abs(steps - HOUR_S * np.rint(steps / HOUR_S)) < min(usual, HOUR_S / 1000)
        if (ahead := np.flatnonzero(whole & (steps > max(usual, HOUR_S / 2))) + 1).size:
            got = f"a step of {HOUR_S * np.rint(steps[ahead[0] - 1] / HOUR_S):g} s"
            fix = "If the clock was set forward there, take that off the stamps from this row on."
            findings.note(table.sheet.rows(time.sources[0], ahead), "a clock that runs on", got, fix)
        return
    wrong = ~clock.in_order(time_s)
    row = int(back[0])
    largest = float((time_s[back - 1] - time_s[back]).max())
    moved = np.abs(np.argsort(np.argsort(time_s, kind="stable")) - np.arange(len(time_s))).max()
    single = max(stop - start for start, stop in runs(wrong)) <= ALONE and moved > clock.DISPLACED
    top = float(time_s.max()) / (abs(time.scale) * time.unit.factor)
    bits = next((bits for bits in clock.BITS if 2.0**bits / 4 < top < 2.0**bits), None)
    limit = "" if bits is None else f" ({2**bits} for {bits} bits)"
    counts = "" if time.wraps_at is not None else f"give wraps_at if it counts to a limit{limit}, or "
    hour_off = abs(float(time_s[row - 1] - time_s[row]) - HOUR_S)
    fix = (
        f"The clock went back by an hour, as at the end of daylight saving time: set wraps_at = {HOUR_S:g}."
        if back.size == 1
        and time.unit.name == targets.DATETIME
        and hour_off < clock.LARGEST_STEP * clock.usual_step(time_s)
        else 'The last row is the first event: set order = "time".'
        if back.size == len(time_s) - 1
        else "These stamps alone are wrong: empty their cells; they are then placed between their neighbours."
        if single
        else 'If rows were written late and their stamps are right, set order = "time".'
        if moved <= clock.DISPLACED
        else "The clock was set or restarted, and the order of the rows is that of the events: "
        f"{counts}split the file there and set own_clocks = true in [series]."
    )
    more = f", and {back.size - 1} more steps back, of {largest:.3g} s at most" if back.size > 1 else ""
    got = f"{time_s[row]:.6g} s after {time_s[row - 1]:.6g} s{more}"
    rows = np.flatnonzero(wrong) if single else back
    findings.error(table.sheet.rows(time.sources[0], rows), "times in order", got, fix)
