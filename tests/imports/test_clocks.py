"""Stamps of devices: counters that wrap, times of day, epochs, equal and missing stamps, and none at all."""

from __future__ import annotations

import re
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest
from hypothesis import given
from hypothesis import strategies as st

from skincal.dataset import Dataset
from skincal.errors import InputError
from skincal.imports import Imported
from skincal.imports.clock import find_wraps, in_order, spread_equal, unwrapped, with_missing, wraps_of
from tests.imports.devices import ONE_FILE, PLANE, contacts, whole_table
from tests.imports.foreign import imported, mapping

RATE_HZ = 50.0
EPOCH_S = 1_763_683_170
FOUND = contacts()
TIME = np.arange(0, FOUND.end_s, 1 / RATE_HZ)
TABLE = whole_table(FOUND, TIME).drop(columns="t")


def bring(
    folder: Path, stamps: Any, time: dict[str, Any] | None, rows: Any = slice(None), **changes: Any
) -> tuple[Dataset, Imported]:
    """Import the recording with these stamps in a column ``t``, or in several columns, its rows written so."""
    columns = {} if stamps is None else stamps if isinstance(stamps, dict) else {"t": stamps}
    TABLE.assign(**columns).iloc[rows].to_csv(folder / "a.csv", index=False)
    content = mapping(PLANE, ONE_FILE, columns={"time_s": None}, **changes)
    if time is not None:
        content["columns"]["time_s"] = time if "columns" in time else {"column": "t", **time}
    return imported(folder, content, [folder / "a.csv"])


def assert_same(back: Dataset, *, tolerance_s: float = 1e-3) -> None:
    assert back.frames is not None
    np.testing.assert_allclose(back.frames.time_s, TIME, atol=tolerance_s)
    np.testing.assert_allclose(back.presses.force_n, FOUND.force_n, rtol=0.02)
    np.testing.assert_allclose(back.presses.columns["t_start_s"], FOUND.start_s, atol=0.1)


@pytest.mark.parametrize(
    ("bits", "unit", "per_s"), [(16, "ms", 1e3), (24, "us", 1e6), (32, "us", 1e6), (32, "ms", 1e3)]
)
def test_counter_that_wraps_goes_on(tmp_path: Path, bits: int, unit: str, per_s: float):
    ticks = np.rint(TIME * per_s).astype(np.int64) + 2**bits - int(10 * per_s)
    back, done = bring(tmp_path, ticks % 2**bits, {"unit": unit})
    assert_same(back)
    (note,) = [problem for problem in done.warnings if problem.code == "counter_wrapped"]
    assert note.severity == "note" and f"wraps at {2**bits} (a counter of {bits} bits)" in note.got
    assert note.details["mapping"] == f"wraps_at = {2**bits}" and note.details["mapping"] in note.fix


@pytest.mark.parametrize(("digits", "unit", "per_s"), [(6, "us", 1e6), (6, "ms", 1e3), (7, "us", 1e6)])
def test_decimal_counter_goes_on(tmp_path: Path, digits: int, unit: str, per_s: float):
    ticks = np.rint(TIME * per_s).astype(np.int64) + 10**digits - int(0.4 * per_s)
    back, done = bring(tmp_path, ticks % 10**digits, {"unit": unit})
    assert_same(back)
    said = [problem.details["mapping"] for problem in done.warnings if problem.code == "counter_wrapped"]
    assert said == [f"wraps_at = {10**digits}"]


def test_signed_counter_and_given_period(tmp_path: Path):
    ticks = (np.rint(TIME * 1e6).astype(np.int64) + 2**31 - 10**7 + 2**31) % 2**32 - 2**31
    back, _ = bring(tmp_path, ticks, {"unit": "us"})
    assert_same(back)
    # No period that skincal knows.
    (tmp_path / "b").mkdir()
    back, _ = bring(tmp_path / "b", np.rint(TIME * 1000).astype(int) % 7919, {"unit": "ms", "wraps_at": 7919})
    assert_same(back)


@pytest.mark.parametrize("comma", [False, True])
def test_time_of_day_goes_over_midnight(tmp_path: Path, comma: bool):
    moments = pd.Timestamp("2026-11-20 23:59:50") + pd.to_timedelta(TIME, unit="s")
    words = moments.strftime("%H:%M:%S.%f").str[:-3]
    back, done = bring(tmp_path, words.str.replace(".", ",") if comma else words, {"unit": "datetime"})
    assert_same(back)
    assert "a clock of 24 h" in done.notes[0]


@pytest.mark.parametrize(("unit", "per_s"), [("s", 1), ("ms", 10**3), ("us", 10**6)])
def test_epochs(tmp_path: Path, unit: str, per_s: int):
    stamps = (1_763_683_170 + TIME) * per_s
    back, _ = bring(tmp_path, stamps if unit == "s" else np.rint(stamps).astype(np.int64), {"unit": unit})
    assert_same(back, tolerance_s=1.1e-3)


def test_epoch_in_another_unit_is_named(tmp_path: Path):
    with pytest.raises(InputError, match=r'As times since 1970 they are in "ms"'):
        bring(tmp_path, np.rint((1_763_683_170 + TIME) * 1000).astype(np.int64), {"unit": "s"})


def test_epochs_of_two_units_are_named(tmp_path: Path):
    paths = [tmp_path / "a.csv", tmp_path / "b.csv"]
    half, stamps = len(TABLE) // 2, EPOCH_S + TIME
    TABLE[:half].assign(t=np.rint(1000 * stamps[:half])).to_csv(paths[0], index=False)
    TABLE[half:].assign(t=stamps[half:]).to_csv(paths[1], index=False)
    content = mapping(PLANE, ONE_FILE, columns={"time_s": {"column": "t", "unit": "ms"}})
    with pytest.raises(InputError, match='got files in "ms", "s"'):
        imported(tmp_path, content, paths)


def test_hour_of_daylight_saving_time(tmp_path: Path):
    moments = pd.Timestamp("2026-10-25 02:59:50") + pd.to_timedelta(TIME - 3600.0 * (TIME >= 10), unit="s")
    with pytest.raises(InputError, match="set wraps_at = 3600"):
        bring(tmp_path, moments.astype(str), {"unit": "datetime"})
    (tmp_path / "b").mkdir()
    back, _ = bring(tmp_path / "b", moments.astype(str), {"unit": "datetime", "wraps_at": 3600})
    assert_same(back)


def test_hour_that_the_clock_was_set_forward(tmp_path: Path):
    for folder, step, told in (("a", 3600.0, True), ("b", 3000.0, False)):
        (tmp_path / folder).mkdir()
        _, done = bring(tmp_path / folder, TIME + step * (TIME >= 10), {"unit": "s"})
        said = [p.got for p in done.warnings if p.expected == "a clock that runs on"]
        assert said == (["a step of 3600 s"] if told else [])


def test_dates_of_a_format(tmp_path: Path):
    form = "%d.%m.%Y %H:%M:%S.%f"
    words = (pd.Timestamp("2026-11-20 12:00:00") + pd.to_timedelta(TIME, unit="s")).strftime(form)
    back, _ = bring(tmp_path, words, {"unit": "datetime", "format": form})
    assert_same(back)


@pytest.mark.parametrize(
    "form", ["%d.%m.%Y %H:%M:%S.%f", "%d.%m.%Y %H:%M:%S,%f", "%Y%m%d %H:%M:%S,%f", "%M:%S.%f", "%M:%S,%f"]
)
def test_format_of_dates_is_proposed_and_fits(tmp_path: Path, form: str):
    words = (pd.Timestamp("2026-11-20 12:59:50") + pd.to_timedelta(TIME, unit="s")).strftime(form)
    csv = {"delimiter": "|", "decimal": "," if "," in form else "."}
    TABLE.assign(t=words).to_csv(tmp_path / "a.csv", index=False, sep="|", decimal=csv["decimal"])
    content = mapping(PLANE, ONE_FILE, columns={"time_s": {"column": "t", "unit": "datetime"}}, csv=csv)
    with pytest.raises(InputError, match=re.escape(f'Set format = "{form}".')):
        imported(tmp_path, content, [tmp_path / "a.csv"])
    content["columns"]["time_s"]["format"] = form
    assert_same(imported(tmp_path, content, [tmp_path / "a.csv"])[0])


@pytest.mark.parametrize(
    ("period", "unit", "per_s"),
    [(2**31, "us", 1e6), (2**30, "us", 1e6), (10**6, "us", 1e6), (60_000, "ms", 1e3), (604_800, "s", 1)],
)
def test_rare_clocks_that_wrap(tmp_path: Path, period: int, unit: str, per_s: float):
    back, done = bring(tmp_path, (TIME - 10) * per_s % period, {"unit": unit})
    assert_same(back)
    assert any(f"wraps at {period}" in problem.got for problem in done.warnings)


def test_wrap_in_a_pause(tmp_path: Path):
    """Nothing was recorded for minutes, here and elsewhere: the counter came round meanwhile."""
    stamps = TIME + 900.0 * (np.arange(len(TIME)) // 300)
    counter = (stamps * 1e6 - stamps[900] * 1e6 + 3e8) % 2**32
    wraps = find_wraps(counter, 1e-6)
    assert wraps is not None and wraps.period == 2**32 and wraps.rows.tolist() == [900]
    # The second half lies among the values of the first: sorted, their samples would be mixed.
    assert counter[900:].max() > counter[:900].min()


def test_seconds_and_nanoseconds(tmp_path: Path):
    stamps = {"sec": np.floor(EPOCH_S + TIME), "nsec": np.rint(TIME % 1 * 1e9)}
    time: dict[str, Any] = {"columns": [*stamps]}
    with pytest.raises(InputError, match=r'a unit for each column, like \["s", "ns"\]'):
        bring(tmp_path, stamps, {**time, "unit": "s"})
    assert_same(bring(tmp_path, stamps, {**time, "unit": ["s", "ns"]})[0])


def test_date_and_time_of_day_in_two_columns(tmp_path: Path):
    moments = pd.Timestamp("2026-11-20 23:59:50") + pd.to_timedelta(TIME, unit="s")
    stamps = {"date": moments.strftime("%d.%m.%Y"), "clock": moments.strftime("%H:%M:%S.%f")}
    time = {"columns": [*stamps], "unit": "datetime", "format": "%d.%m.%Y %H:%M:%S.%f"}
    assert_same(bring(tmp_path, stamps, time)[0])


@pytest.mark.parametrize(
    ("stamps", "unit", "text"),
    [
        (TIME, "ms", 'They seem to be in "s"'),
        (TIME * 1e6, "s", 'They seem to be in "us"'),
        (np.float32(EPOCH_S) + 0 * TIME, "s", "stamps that grow from row to row"),
        (TIME[::-1], "s", 'The last row is the first event: set order = "time"'),
        (115950.0 + TIME + 4040 * (TIME >= 10), "s", 'format = "%H%M%S.%f"'),
    ],
)
def test_stamps_that_are_not_what_they_are_said_to_be(
    tmp_path: Path, stamps: np.ndarray, unit: str, text: str
):
    with pytest.raises(InputError, match=re.escape(text)):
        bring(tmp_path, stamps, {"unit": unit})


@pytest.mark.usefixtures("in_process")
@pytest.mark.parametrize(
    ("nothing", "said"),
    [
        (np.nan, "expected stamps; got none in any row"),
        *((x, f"expected a finite number; got {x}") for x in (np.inf, -np.inf)),
    ],
)
def test_no_finite_stamp(tmp_path: Path, nothing: float, said: str):
    """In a table of numbers, which may hold what no text is read as."""
    TABLE.assign(t=nothing).to_parquet(tmp_path / "a.parquet")
    content = mapping(PLANE, ONE_FILE, columns={"time_s": {"column": "t", "unit": "s"}})
    with pytest.raises(InputError, match=said):
        imported(tmp_path, content, [tmp_path / "a.parquet"])


def test_missing_stamps_are_filled(tmp_path: Path):
    stamps = pd.Series(TIME.copy())  # pandas before 3 writes into what it was made of
    stamps[[0, 100, 101, 102, 700]] = np.nan
    back, done = bring(tmp_path, stamps, {"unit": "s"}, series={"start_at_zero": False})
    assert_same(back)
    assert "5 rows have no stamp" in done.notes[0]


def test_equal_stamps_are_spread(tmp_path: Path):
    """Stamps of whole tenths: five rows each."""
    back, done = bring(tmp_path, np.floor(TIME * 10 + 1e-6) / 10, {"unit": "s"})
    assert_same(back)
    assert "have the stamp of the previous row" in done.notes[0]


def test_rate_in_the_place_of_stamps(tmp_path: Path):
    back, _ = bring(tmp_path, None, None, csv={"rate_hz": RATE_HZ})
    assert_same(back)


def test_neither_stamps_nor_rate(tmp_path: Path):
    with pytest.raises(InputError, match="or rate_hz in"):
        bring(tmp_path, None, None)


def test_order_of_events_is_not_sorted(tmp_path: Path):
    """A clock that is set back: the file's order counts, and nobody is told to sort."""
    stamps = TIME.copy()
    stamps[900:] -= 7.3
    with pytest.raises(InputError, match="the order of the rows is that of the events") as caught:
        bring(tmp_path, stamps, {"unit": "s"})
    assert "row 901 (line 902)" in str(caught.value)
    assert "ort the rows" not in str(caught.value)


def test_rows_written_late(tmp_path: Path):
    order = np.arange(len(TIME))
    order[[500, 501, 502]] = [502, 500, 501]
    TABLE.assign(t=TIME).iloc[order].to_csv(tmp_path / "a.csv", index=False)
    content = mapping(PLANE, ONE_FILE)
    with pytest.raises(InputError, match='set order = "time"'):
        imported(tmp_path, content, [tmp_path / "a.csv"])
    content["csv"]["order"] = "time"
    back, _ = imported(tmp_path, content, [tmp_path / "a.csv"])
    assert_same(back)
    np.testing.assert_array_equal(back.frames.counts, TABLE.to_numpy()[:, 3:])


WRAPPED = (np.rint(TIME * 1e3).astype(np.int64) + 2**16 - 10_000) % 2**16
"""A counter of 16 bits in ms that wraps after ten seconds, before row 500."""


@pytest.mark.parametrize("given", [{}, {"wraps_at": 2**16}])
def test_rows_written_late_around_a_wrap(tmp_path: Path, given: dict[str, int]):
    order = np.arange(len(TIME))
    for late in (100, 498, 499, 502, 700):
        order[[late, late + 1]] = order[[late + 1, late]]
    with pytest.raises(InputError, match='set order = "time"'):
        bring(tmp_path, WRAPPED, {"unit": "ms", **given}, order)
    back, done = bring(tmp_path, WRAPPED, {"unit": "ms", **given}, order, csv={"order": "time"})
    assert_same(back)
    said = [*done.notes, *(problem.got for problem in done.warnings)]
    assert sum("wraps at 65536" in text and "once" in text for text in said) == 1
    assert not any("moved farther" in text for text in said)


@pytest.mark.parametrize("given", [{}, {"wraps_at": 2**16}])
def test_wrong_stamps_of_a_counter_that_wraps(tmp_path: Path, given: dict[str, int]):
    """The rows named are those of the wrong stamps; with their cells empty, time is right."""
    wrong = [480, 700, 900]
    stamps = pd.Series(WRAPPED.astype(float))
    stamps[wrong] = 0.0
    with pytest.raises(InputError, match="empty their cells") as caught:
        bring(tmp_path, stamps, {"unit": "ms", **given})
    assert "rows 481 (line 482), 701 (line 702), 901 (line 902): " in str(caught.value)
    stamps[wrong] = np.nan
    assert_same(bring(tmp_path, stamps, {"unit": "ms", **given})[0])


def test_a_wrap_is_removed_before_rows_are_sorted(tmp_path: Path):
    back, _ = bring(tmp_path, WRAPPED, {"unit": "ms"}, csv={"order": "time"})
    assert_same(back)


def test_sorting_that_moves_blocks_is_reported(tmp_path: Path):
    restarted = np.where(np.arange(len(TIME)) < 600, TIME + 100, TIME - TIME[600])
    _, done = bring(tmp_path, restarted, {"unit": "s"}, csv={"order": "time"})
    (told,) = [problem for problem in done.warnings if "moved farther" in problem.got]
    assert told.severity == "warning" and "row 601 (line 602)" in told.place
    assert told.got.startswith("111.98 s back") and f"{len(TIME)} rows were moved farther" in told.got
    (tmp_path / "b").mkdir()
    back, done = bring(tmp_path / "b", TIME, {"unit": "s"}, slice(None, None, -1), csv={"order": "time"})
    assert_same(back)
    assert not any("moved farther" in problem.got for problem in done.warnings)


def test_a_rise_far_from_a_wrap_is_a_pause():
    stamps = np.concatenate(
        [np.arange(0, 60, 0.5), np.arange(0, 15, 0.5), np.arange(45, 60, 0.5), [np.nan, 0.0]]
    )
    assert wraps_of(stamps, 60.0).rows.tolist() == [120, 181]
    assert wraps_of(stamps[:160], 60.0).turns[-1] == 1


@given(st.floats(0.1, 0.9), st.lists(st.integers(0, 398), max_size=12))
def test_unwrapping_keeps_rows_that_were_written_late(phase: float, late: list[int]):
    true = np.arange(400.0) + 1000 - np.floor(phase * 400)
    for row in late:
        true[[row, row + 1]] = true[[row + 1, row]]
    stamps = true % 1000
    np.testing.assert_array_equal(np.diff(unwrapped(stamps, wraps_of(stamps, 1000.0))), np.diff(true))


@given(st.lists(st.integers(0, 9), min_size=1, max_size=12))
def test_the_longest_part_in_order_is_found(stamps: list[int]):
    kept = in_order(np.array(stamps, dtype=float))
    longest = max(
        sum(chosen)
        for chosen in product([False, True], repeat=len(stamps))
        if (np.diff(np.array(stamps)[np.array(chosen)]) >= 0).all()
    )
    assert kept.sum() == longest and (np.diff(np.array(stamps)[kept]) >= 0).all()


@given(
    st.sampled_from([(16, 1e-3), (24, 1e-6), (32, 1e-6), (32, 1e-3)]),
    st.floats(0.0, 1.0),
    st.floats(1e-3, 0.02),
)
def test_wraps_are_found_wherever_they_lie(clock: tuple[int, float], phase: float, step_s: float):
    bits, unit_s = clock
    true = np.floor((np.arange(400) * step_s) / unit_s + 2**bits - phase * 400 * step_s / unit_s)
    stamps = true % 2**bits
    wraps = find_wraps(stamps, unit_s)
    if (np.diff(stamps) < 0).any():
        assert wraps is not None and wraps.period == 2**bits
        np.testing.assert_array_equal(np.diff(unwrapped(stamps, wraps)), np.diff(true))
    else:
        assert wraps is None


def test_restart_is_no_wrap():
    stamps = np.concatenate([np.arange(0, 21.7, 0.02), np.arange(0, 9, 0.02)])
    assert find_wraps(stamps, 1.0) is None


def test_mended_stamps_ascend():
    time = spread_equal(np.array([0.0, 0.0, 0.1, 0.1, 0.1, 0.5]))
    assert (np.diff(time) > 0).all() and time[0] == 0.0 and time[-1] == 0.5
    np.testing.assert_allclose(
        with_missing(np.array([np.nan, 1.0, np.nan, 3.0, 4.0, np.nan])), np.arange(6.0)
    )
