"""Time series in text files, cut into presses."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest

from skincal.dataset import HOLD, IDLE, LOAD, PHASES, UNLOAD, Dataset, read_dataset
from skincal.imports import Imported
from tests.imports.foreign import SERIES, Recorded, imported, mapping, recorded, refusals, series_table

Session = Callable[..., Dataset]


@pytest.fixture
def recording(session: Session) -> Recorded:
    return recorded(session(8, frames_per_press=0))


def written(folder: Path, tables: list[pd.DataFrame]) -> list[Path]:
    paths = [folder / f"part{i}.csv" for i in range(len(tables))]
    for path, table in zip(paths, tables, strict=True):
        table.to_csv(path, index=False)
    return paths


def bring(folder: Path, tables: list[pd.DataFrame], content: dict[str, Any]) -> tuple[Dataset, Imported]:
    return imported(folder, content, written(folder, tables))


def refused(folder: Path, tables: list[pd.DataFrame], content: dict[str, Any]) -> str:
    return "\n".join(refusals(folder, content, written(folder, tables)))


def assert_found(back: Dataset, recording: Recorded, *, tolerance_n: float = 0.02) -> None:
    """The presses in a recording come back: force, image, position, and when they were held."""
    presses = back.presses
    assert len(presses) == len(recording.level_n)
    np.testing.assert_allclose(presses.force_n, recording.level_n, rtol=0.01)
    # Hardly any sample of a ramp is in the mean.
    np.testing.assert_allclose(presses.counts, recording.image, atol=2.0, rtol=0.01)
    np.testing.assert_allclose(presses.columns["t_hold_s"], recording.hold_s[:, 0], atol=0.03)
    np.testing.assert_allclose(presses.columns["t_release_s"], recording.hold_s[:, 1], atol=0.03)


def test_force_that_is_never_zero_is_named(tmp_path: Path, recording: Recorded):
    """The gauge was not set to zero, or pressed already: all is one contact."""
    table = series_table(recording)
    table["F"] += 0.8
    _, done = bring(tmp_path, [table], mapping(SERIES))
    (found,) = [warning for warning in done.warnings if warning.code == "zero_of_force"]
    assert "offset in [columns.force_n]" in str(found)
    (tmp_path / "b").mkdir()
    back, done = bring(tmp_path / "b", [table], mapping(SERIES, columns={"force_n": {"offset": -0.8}}))
    assert_found(back, recording)
    assert not [warning for warning in done.warnings if warning.code]


def test_readings_that_a_device_lost_are_left_out(tmp_path: Path, recording: Recorded):
    table = series_table(recording)
    table.iloc[::40, 7] = np.nan
    back, _ = bring(tmp_path, [table], mapping(SERIES))
    assert np.isfinite(back.presses.counts).all()
    assert_found(back, recording)


def test_contacts_become_presses(tmp_path: Path, recording: Recorded):
    back, done = bring(tmp_path, [series_table(recording)], mapping(SERIES))
    assert_found(back, recording)
    frames = back.frames
    assert frames is not None and len(frames) == done.frames == len(recording.time_s)
    assert frames.time_s[0] == 0.0
    np.testing.assert_allclose(frames.time_s, recording.time_s - 100, atol=1e-9)
    np.testing.assert_array_equal(frames.counts, recording.counts)
    touching = frames.phase != IDLE
    # A contact begins at 0.1 N; of the ramps below that nothing is taken for contact, and nothing at rest.
    assert not (touching & (recording.press < 0)).any()
    assert (touching == (recording.press >= 0)).mean() > 0.95
    np.testing.assert_array_equal(frames.press[touching], recording.press[touching])
    assert np.isnan(frames.position_m[~touching]).all()
    for k in range(len(back.presses)):
        order = frames.phase[frames.press == k]
        assert (np.diff(order) >= 0).all()
        assert set(order) == {LOAD, HOLD, UNLOAD}
    assert back.presses.press.tolist() == list(range(8))
    assert not done.dropped


def test_slow_ramps_do_not_lower_the_hold(tmp_path: Path, session: Session):
    """Ramps of 0.4 s beside a hold of 0.6 s lower the mean of the hold by less than half a percent."""
    recording = recorded(session(8, frames_per_press=0), noise_n=0.0)
    back, _ = bring(tmp_path, [series_table(recording)], mapping(SERIES))
    error = back.presses.force_n / recording.level_n - 1
    assert np.abs(error).max() < 0.005


def test_numbered_presses_and_named_phases(tmp_path: Path, recording: Recorded):
    table = series_table(recording)
    table["nr"] = np.where(recording.press < 0, np.nan, 10 + recording.press)
    words = np.array(["rest", "down", "keep", "up"])
    start = (recording.press[:, None] == np.arange(8)).argmax(axis=1)
    time = recording.time_s - 100
    hold = (time >= recording.hold_s[start, 0]) & (time <= recording.hold_s[start, 1])
    code = np.select([recording.press < 0, hold, time < recording.hold_s[start, 0]], [0, 2, 1], 3)
    table["what"] = words[code]
    columns = {
        "press": "nr",
        "phase": {
            "column": "what",
            "words": {"rest": "idle", "down": "load", "keep": "hold", "up": "unload"},
        },
    }
    back, _ = bring(tmp_path, [table], mapping(SERIES, columns=columns))
    assert back.presses.press.tolist() == list(range(10, 18))
    assert back.frames is not None
    np.testing.assert_array_equal(back.frames.phase, code)
    for k in range(8):
        rows = (recording.press == k) & (code == 2)
        assert back.presses.force_n[k] == pytest.approx(recording.force_n[rows].mean(), rel=1e-12)


def test_numbered_presses_without_phases(tmp_path: Path, recording: Recorded):
    """A press's rows begin before the touch; what has no force is rest."""
    table = series_table(recording)
    time = recording.time_s - 100
    table["nr"] = np.minimum(time // 1.8, 7).astype(int)
    back, _ = bring(tmp_path, [table], mapping(SERIES, columns={"press": "nr"}))
    assert_found(back, recording)
    assert back.frames is not None
    assert ((back.frames.phase == IDLE) == (back.frames.press < 0)).all()
    assert 0.2 < (back.frames.phase == IDLE).mean() < 0.4


def test_unknown_word_for_a_phase(tmp_path: Path, recording: Recorded):
    table = series_table(recording)
    table["nr"], table["what"] = recording.press, "Druck"
    content = mapping(SERIES, columns={"press": "nr", "phase": "what"})
    assert "part0.csv, phase: expected one of idle, load, hold, unload; got 'Druck'" in refused(
        tmp_path, [table], content
    )


def test_press_that_comes_again(tmp_path: Path, recording: Recorded):
    table = series_table(recording)
    table["nr"] = np.where(recording.press == 5, 2, recording.press)
    found = refused(tmp_path, [table], mapping(SERIES, columns={"press": "nr"}))
    assert "expected each press in one stretch of rows; got 2 again later" in found


def staircase(rate_hz: float = 50.0) -> tuple[np.ndarray, np.ndarray, list[float]]:
    """Up 1, 2, 3 N and down 2, 1 N, each held for 1 s with ramps of 0.5 s; rest before and after."""
    levels = [1.0, 2.0, 3.0, 2.0, 1.0]
    times, forces = [0.0, 1.0], [0.0, 0.0]
    for level in (*levels, 0.0):
        times += [times[-1] + 0.5, times[-1] + 1.5]
        forces += [level, level]
    time = np.arange(0, times[-1], 1 / rate_hz)
    return time, np.interp(time, times, forces), levels


def test_staircase_gives_a_press_a_plateau(tmp_path: Path, session: Session):
    time, force, levels = staircase()
    one = session(1, frames_per_press=0)
    table = pd.DataFrame({"t": time * 1e3, "F": force})
    for name, value in zip("XYZ", one.presses.position_m[0], strict=True):
        table[name] = value * 1e3
    image = one.presses.counts[0] / one.presses.force_n[0]
    for j in range(16):
        table[f"tax_{j // 4}_{j % 4}"] = np.rint(force * image[j]).astype(int)
    content = mapping(SERIES, series={"by": "plateaus", "slope_n_per_s": 0.2, "min_hold_s": 0.5})
    back, _ = bring(tmp_path, [table], content)
    np.testing.assert_allclose(back.presses.force_n, levels, atol=0.02)
    assert back.presses.columns["branch"].tolist() == ["up", "up", "up", "down", "down"]
    assert back.frames is not None
    down = back.frames.select((back.frames.press == 3) & (back.frames.phase != HOLD))
    assert set(down.phase) == {UNLOAD}
    up = back.frames.select((back.frames.press == 1) & (back.frames.phase != HOLD))
    assert set(up.phase) == {LOAD}


def test_real_staircase_comes_back(shared: Path, tmp_path: Path):
    """35 plateaus of a real pressure chamber, found by another hand, from its time series alone."""
    folder = shared / "real" / "insole"
    if not folder.is_dir():
        pytest.skip("no recording of the pressure chamber")
    truth = read_dataset(folder)
    assert truth.frames is not None
    meta = mapping(
        csv={"rows": "series"},
        columns={
            "time_s": "time_s",
            # 1 N/m² on the punch of 0.1 m radius that stands for the chamber.
            "force_n": {"column": "pressure_pa", "unit": "N", "scale": np.pi * 0.01},
            "position": {"value": [0, 0, 0], "unit": "m"},
        },
        taxels={"columns": "taxel_{r}_{c}"},
        series={
            "by": "plateaus", "on_n": 314.0, "off_n": 314.0, "slope_n_per_s": 0.025e5 * np.pi * 0.01,
            "min_hold_s": 3.0, "window_s": 2.0,
        },
        sensor={"rows": 28, "cols": 10, "taxel_size_m": 0.005692, "pitch_m": 0.005692},
        surface={"kind": "plane", "radius_m": None},
        indenter={"kind": "flat", "radius_m": 0.1},
        mount={
            "beta_deg": None, "beta_range_deg": None, "x_m": 0.0, "y_m": 0.0, "x_range_m": [-0.005, 0.005],
            "y_range_m": [-0.005, 0.005], "alpha_range_deg": [-5.0, 5.0],
        },
    )  # fmt: skip
    back, done = imported(tmp_path, meta, [folder / "frames.parquet"])
    assert done.assumed == ("position",)
    assert len(back.presses) == len(truth.presses) == 35
    middle = (truth.presses.columns["t_hold_s"] + truth.presses.columns["t_release_s"]) / 2
    assert (middle > back.presses.columns["t_hold_s"]).all()
    assert (middle < back.presses.columns["t_release_s"]).all()
    np.testing.assert_allclose(back.presses.force_n, truth.presses.force_n, rtol=0.002)
    assert back.presses.columns["branch"].tolist() == truth.presses.columns["branch"].tolist()


def test_contact_without_hold_is_left_out(tmp_path: Path, recording: Recorded):
    table = series_table(recording)
    table.loc[recording.press == 3, "F"] *= np.linspace(0.2, 1, int((recording.press == 3).sum())) ** 3
    back, done = bring(tmp_path, [table], mapping(SERIES, series={"min_hold_s": 0.3}))
    assert len(back.presses) == 7
    lost = int((recording.press == 3).sum())
    assert done.dropped[0].count == 1 and "no hold of 0.3 s (min_hold_s)" in done.dropped[0].why
    assert 0.7 * lost < done.dropped[1].count <= lost
    assert back.frames is not None
    assert len(back.frames) == len(recording.time_s) - done.dropped[1].count


def test_settling_counts_as_loading(tmp_path: Path, recording: Recorded):
    back, _ = bring(tmp_path, [series_table(recording)], mapping(SERIES, series={"settle_s": 0.2}))
    np.testing.assert_allclose(back.presses.columns["t_hold_s"], recording.hold_s[:, 0] + 0.2, atol=0.03)


def test_a_file_a_press_each_with_its_own_clock(tmp_path: Path, recording: Recorded):
    table = series_table(recording)
    files = np.minimum((recording.time_s - 100) // 1.8, 7)
    tables = [table[files == k].assign(t=lambda part: part["t"] - part["t"].iloc[0]) for k in range(8)]
    assert "Set own_clocks = true" in refused(tmp_path, tables, mapping(SERIES))
    back, done = bring(tmp_path, tables, mapping(SERIES, series={"own_clocks": True, "gap_s": 2.0}))
    assert len(done.read) == 8
    np.testing.assert_allclose(back.presses.force_n, recording.level_n, rtol=0.01)
    steps = np.diff(back.presses.columns["t_hold_s"])
    np.testing.assert_allclose(steps, 1.8 + 2.0 - 0.01, atol=0.05)


def test_dates_are_times(tmp_path: Path, recording: Recorded):
    table = series_table(recording)
    moments = pd.Timestamp("2026-11-20 12:00:00") + pd.to_timedelta(recording.time_s, unit="s")
    table["t"] = [moment.isoformat(sep=" ") for moment in moments]
    back, _ = bring(tmp_path, [table], mapping(SERIES, columns={"time_s": {"unit": "datetime"}}))
    assert back.frames is not None
    np.testing.assert_allclose(back.frames.time_s, recording.time_s - 100, atol=1e-6)


def test_times_that_go_back(tmp_path: Path, recording: Recorded):
    table = series_table(recording)
    table.loc[50, "t"] = table.loc[20, "t"]
    found = refused(tmp_path, [table], mapping(SERIES))
    assert found.startswith('part0.csv, column "t", row 51 (line 52): expected times in order')
    assert "empty their cells" in found


def test_force_that_is_missing(tmp_path: Path, recording: Recorded):
    table = series_table(recording)
    table.loc[[7, 8], "F"] = np.nan
    found = refused(tmp_path, [table], mapping(SERIES))
    assert 'part0.csv, column "F", rows 8 (line 9), 9 (line 10): expected a number' in found


@pytest.mark.parametrize("numbered", [False, True])
def test_position_that_is_missing_in_contact(tmp_path: Path, recording: Recorded, numbered: bool):
    """The rows of the source are named, also where they were sorted; those at rest need no position."""
    table, late = series_table(recording), np.arange(len(recording.time_s))
    middle = [int(row) for row in np.flatnonzero(recording.press == 1)[[60, 61]]]
    table.loc[middle, "Y"] = np.nan
    table.loc[recording.force_n < 0.05, ["X", "Y", "Z"]] = np.nan
    table["nr"] = np.where(recording.press < 0, np.nan, recording.press)
    late[[100, 101]] = late[[101, 100]]
    files = [table[: middle[0] - 100], table[middle[0] - 100 :].iloc[late[: len(table) - middle[0] + 100]]]
    content = mapping(SERIES, csv={"order": "time"}, columns={"press": "nr"} if numbered else {})
    found = refused(tmp_path, files, content)
    assert found.startswith(
        'part1.csv, column "X, Y, Z", rows 101 (line 102), 102 (line 103): expected a position'
    )
    assert "drop_incomplete = true" in found
    content["csv"]["drop_incomplete"] = True
    back, done = bring(tmp_path, files, content)
    assert [str(dropped) for dropped in done.dropped] == ["2 rows: no position, in a contact"]
    assert_found(back, recording)
    assert back.frames is not None
    assert len(back.frames) == len(recording.time_s) - 2


def test_contact_without_a_position(tmp_path: Path, recording: Recorded):
    table = series_table(recording)
    table.loc[recording.press == 3, ["X", "Y", "Z"]] = np.nan
    back, done = bring(tmp_path, [table], mapping(SERIES, csv={"drop_incomplete": True}))
    assert len(back.presses) == 7
    assert "1 contact: no position in its hold" in [str(dropped) for dropped in done.dropped]
    np.testing.assert_allclose(back.presses.force_n, np.delete(recording.level_n, 3), rtol=0.01)


def test_times_in_a_wrong_unit(tmp_path: Path, recording: Recorded):
    content = mapping(SERIES, columns={"time_s": {"unit": "s"}})
    found = refused(tmp_path, [series_table(recording)], content)
    assert "It looks like milliseconds" in found
    assert '[columns.time_s], unit "s"' in found


def test_no_contact_at_all(tmp_path: Path, recording: Recorded):
    content = mapping(SERIES, series={"on_n": 50.0, "off_n": 20.0})
    found = refused(tmp_path, [series_table(recording)], content)
    assert "expected at least one press; got none (forces from -0" in found
    assert "on_n = 50, off_n = 20" in found


def test_words_of_phases_are_those_of_the_dataset():
    assert PHASES == ("idle", "load", "hold", "unload")
