"""Taxels in one file, force and place in another with a clock of its own."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest
from typer.testing import CliRunner

from skincal.cli.main import app
from skincal.dataset import Dataset
from skincal.errors import InputError
from skincal.imports import Imported
from skincal.imports.alignment import NoOffsetError, estimate_offset
from skincal.imports.place_alignment import estimate_offset_by_place
from tests.imports.devices import (
    GRID_M,
    ONE_FILE,
    PLANE,
    TWO_FILES,
    Contacts,
    contacts,
    gauge_table,
    taxel_table,
)
from tests.imports.foreign import imported, mapping

FOUND = contacts(14)
TAXELS_S = np.arange(0, FOUND.end_s, 0.0125)
GAUGE_S = np.arange(-0.4, FOUND.end_s + 0.3, 0.1) + 0.03
EPOCH_S = 1_763_683_200.0  # midnight


def recorded(
    folder: Path, taxel_stamps: Any, gauge_stamps: Any, content: dict[str, Any], found: Contacts = FOUND
) -> tuple[Dataset, Imported]:
    taxel_table(found, TAXELS_S).assign(t=taxel_stamps).to_csv(folder / "sensor.csv", index=False)
    gauge_table(found, GAUGE_S).assign(t=gauge_stamps).to_csv(folder / "gauge.csv", index=False)
    return imported(folder, content, [folder / "sensor.csv", folder / "gauge.csv"])


def assert_joined(back: Dataset) -> None:
    np.testing.assert_allclose(back.presses.force_n, FOUND.force_n, rtol=0.01)
    np.testing.assert_allclose(back.presses.position_m[:, :2], FOUND.place_m, atol=1e-5)
    # The images are those of the same moments: a taxel's load is the force's.
    ratio = (back.presses.counts.max(axis=1) - 20) / (40 * back.presses.force_n)
    away = np.linalg.norm(FOUND.place_m[:, None] - GRID_M, axis=2).min(axis=1)
    np.testing.assert_allclose(ratio, np.exp(-((away / 0.003) ** 2)), atol=0.03)


POSES_S = np.arange(-0.6, FOUND.end_s + 0.3, 0.05)


@pytest.mark.parametrize(
    ("zeros", "gauge", "poses"),
    [
        ((0.0, 0.0, 77.0), {}, {"offset_s": "estimate"}),
        ((5.0, 0.0, 0.0), {"offset_s": "estimate"}, {"clock": "gauge"}),
        ((5.0, 0.0, 0.0), {"offset_s": "estimate"}, {"offset_s": "estimate"}),
        ((5.0, 0.0, 77.0), {"offset_s": "estimate"}, {"offset_s": "estimate"}),
    ],
)
def test_three_files(
    tmp_path: Path, zeros: tuple[float, float, float], gauge: dict[str, Any], poses: dict[str, Any]
):
    """Positions on a third clock, or on that of the gauge; they do not follow the force."""
    content = mapping(PLANE, TWO_FILES, files={"gauge": gauge})
    content["files"]["poses"] = {"file": "poses.csv", "time": {"column": "t", "unit": "s"}} | poses
    for name in ("x_m", "y_m"):
        content["columns"][name]["file"] = "poses"
    both = gauge_table(FOUND, POSES_S).assign(t=zeros[2] + POSES_S)
    both[["t", "px", "py"]].to_csv(tmp_path / "poses.csv", index=False)
    back, done = recorded(tmp_path, zeros[0] + TAXELS_S, zeros[1] + GAUGE_S, content)
    assert_joined(back)
    offsets = {clock.name: clock.offset_s for clock in done.clocks}
    # An indenter that is in place before it touches tells its clock to that.
    assert offsets["poses"] == pytest.approx(zeros[0] - zeros[2], abs=0.6)
    sigma = 0.0 if back.meta.clock is None else back.meta.clock.sigma_s
    assert sigma < 0.01


def test_places_that_do_not_go_with_images():
    rng = np.random.default_rng(0)
    columns = {"x_m": np.repeat(rng.normal(size=60), 30), "y_m": np.repeat(rng.normal(size=60), 30)}
    images, time = FOUND.images(TAXELS_S), np.arange(0.0, 90.0, 0.05)
    with pytest.raises(NoOffsetError, match="x_m, y_m go with where the images lie"):
        estimate_offset_by_place("poses", TAXELS_S, images, GRID_M, time, columns)


def test_clocks_that_agree(tmp_path: Path):
    back, done = recorded(tmp_path, EPOCH_S + TAXELS_S, EPOCH_S + GAUGE_S, mapping(PLANE, TWO_FILES))
    assert_joined(back)
    assert done.assumed == ("z_m",)
    assert not [p for p in done.warnings if "offset_s" in p.place]


def test_time_of_day_and_epoch_over_midnight(tmp_path: Path):
    start = EPOCH_S - 20
    words = pd.to_datetime(start + TAXELS_S, unit="s").strftime("%H:%M:%S.%f").str[:-3]
    content = mapping(PLANE, TWO_FILES, columns={"time_s": {"unit": "datetime"}})
    back, _ = recorded(tmp_path, words, start + GAUGE_S, content)
    assert_joined(back)


@pytest.mark.parametrize("unit", ["s", "ms"])
def test_offset_is_estimated(tmp_path: Path, unit: str):
    """A counter since power-on against an epoch."""
    per_s = {"s": 1.0, "ms": 1e3}[unit]
    content = mapping(PLANE, TWO_FILES, files={"gauge": {"offset_s": "estimate"}}, series={"start_at_zero": False},
                      columns={"time_s": {"unit": unit}})  # fmt: skip
    back, done = recorded(tmp_path, (12.345 + TAXELS_S) * per_s, EPOCH_S + GAUGE_S, content)
    (clock,) = done.clocks
    assert clock.estimated and abs(clock.offset_s - (12.345 - EPOCH_S)) < 0.01
    assert 0 < clock.sigma_s < 0.01
    assert back.meta.clock is not None and back.meta.clock.sigma_s == pytest.approx(clock.sigma_s)
    assert_joined(back)


@pytest.mark.parametrize(
    ("presses", "faster", "rel"), [(40, 1.004, 0.05), (100, 1.01, 0.01), (100, 0.97, 0.01)]
)
def test_clocks_of_different_rates(presses: int, faster: float, rel: float):
    found = contacts(presses)
    taxels, gauge = np.arange(0, found.end_s, 0.02), np.arange(0.1, found.end_s, 0.05)
    times, columns = 500 + gauge * faster, {"force_n": found.force(gauge)}
    clock = estimate_offset("gauge", taxels, found.images(taxels), times, columns)
    assert clock.rate == pytest.approx(1 / faster - 1, rel=rel)
    np.testing.assert_allclose(clock.onto(times), gauge, atol=0.02)


def test_offset_that_cannot_be_reported():
    time = np.arange(0, 60, 0.02)
    load = ((time % 3) > 1.5).astype(float)
    with pytest.raises(NoOffsetError, match="are equally good"):
        estimate_offset("gauge", time, load[:, None], time[100:-100], {"force_n": load[100:-100]})
    clock = estimate_offset(
        "gauge", time, load[:, None], time[100:-100], {"force_n": load[100:-100]}, within_s=1.0
    )
    assert abs(clock.offset_s) < 0.01
    noise = np.random.default_rng(0).normal(size=(2, len(time)))
    with pytest.raises(NoOffsetError, match="no lag at which force_n correlates"):
        estimate_offset("gauge", time, noise[:1].T, time, {"force_n": noise[1]})


def test_clocks_that_do_not_meet(tmp_path: Path):
    with pytest.raises(InputError, match='set offset_s = "estimate"'):
        recorded(tmp_path, TAXELS_S, EPOCH_S + GAUGE_S, mapping(PLANE, TWO_FILES))


def test_time_zone_is_named(tmp_path: Path):
    words = pd.to_datetime(EPOCH_S + 7200 + 3600 + TAXELS_S, unit="s").strftime("%I:%M:%S.%f %p")
    time = {"unit": "datetime", "format": "%I:%M:%S.%f %p"}
    content = mapping(PLANE, TWO_FILES, columns={"time_s": time})
    with pytest.raises(InputError, match=r"for a time zone, 3600"):
        recorded(tmp_path, words, EPOCH_S + 7200 + GAUGE_S, content)
    content["files"]["gauge"]["offset_s"] = 3600.0
    assert_joined(recorded(tmp_path, words, EPOCH_S + 7200 + GAUGE_S, content)[0])


def test_gauge_that_starts_after_midnight(tmp_path: Path):
    start = EPOCH_S - 2.0
    words = [
        pd.to_datetime(start + time, unit="s").strftime("%H:%M:%S.%f").str[:-3]
        for time in (TAXELS_S, GAUGE_S + 2.5)
    ]
    content = mapping(PLANE, TWO_FILES, columns={"time_s": {"unit": "datetime"}},
                      files={"gauge": {"time": {"unit": "datetime"}, "offset_s": -2.5}})  # fmt: skip
    assert_joined(recorded(tmp_path, *words, content)[0])


@pytest.mark.parametrize(
    ("zero_s", "gauge_s", "got", "fix"),
    [
        (EPOCH_S, EPOCH_S + GAUGE_S + 1, "", "offset_s = -1"),
        (EPOCH_S, EPOCH_S + GAUGE_S + 7, "", "offset_s = -7"),
        (0.0, 1.03 * GAUGE_S, "at the end", 'offset_s = "estimate"'),
    ],
)
def test_clocks_that_are_said_to_agree_and_do_not(
    tmp_path: Path, zero_s: float, gauge_s: np.ndarray, got: str, fix: str
):
    _, done = recorded(tmp_path, zero_s + TAXELS_S, gauge_s, mapping(PLANE, TWO_FILES))
    (warning,) = [p for p in done.warnings if "offset_s" in p.place]
    assert got in warning.got and fix in warning.fix


def test_files_named_one_after_the_other(tmp_path: Path):
    """The columns stand in the other file: said with the lines that mend it."""
    with pytest.raises(InputError) as caught:
        recorded(tmp_path, TAXELS_S, GAUGE_S, mapping(PLANE, ONE_FILE))
    text = str(caught.value)
    assert len(text.splitlines()) == 1
    assert '[files.gauge] with file = "gauge.csv"' in text
    assert "[columns.force_n], [columns.x_m], [columns.y_m]" in text


def test_single_stretches_of_two_devices(tmp_path: Path):
    """Each stretch has two files, whose clocks begin anew."""
    table, gauge = taxel_table(FOUND, TAXELS_S), gauge_table(FOUND, GAUGE_S)
    border = float(FOUND.start_s[7] - 0.3)
    for k, (mine, theirs) in enumerate(
        ((border > TAXELS_S, border > GAUGE_S), (border <= TAXELS_S, border - 0.1 <= GAUGE_S))
    ):
        zero = TAXELS_S[mine][0]
        table[mine].assign(t=TAXELS_S[mine] - zero).to_csv(tmp_path / f"sensor{k}.csv", index=False)
        gauge[theirs].assign(t=GAUGE_S[theirs] - zero).to_csv(tmp_path / f"gauge{k}.csv", index=False)
    content = mapping(PLANE, TWO_FILES, files={"gauge": {"file": "gauge*.csv"}}, series={"own_clocks": True})
    paths = [tmp_path / f"{name}{k}.csv" for name in ("sensor", "gauge") for k in (0, 1)]
    assert_joined(imported(tmp_path, content, paths)[0])


@pytest.mark.parametrize(
    ("change", "text"),
    [
        ({"columns": {"force_n": {"file": "guage"}}}, 'Did you mean "gauge"?'),
        ({"files": {"gauge": {"time": None}}}, "Add time, or rate_hz"),
        ({"files": {"gauge": {"offset_s": "guess"}}}, 'a time [s], or "estimate"'),
        ({"files": {"other": {"file": "b.csv", "rate_hz": 10.0}}}, 'Write file = "other" there'),
        ({"files": {"gauge": {"clock": "other"}}}, "a clock of its own (there is none)"),
        ({"files": {"gauge": {"offset": 1.0}}}, 'Did you mean "offset_s"?'),
    ],
)
def test_wrong_tables_of_files(tmp_path: Path, change: dict[str, Any], text: str):
    with pytest.raises(InputError) as caught:
        recorded(tmp_path, TAXELS_S, GAUGE_S, mapping(PLANE, TWO_FILES, **change))
    assert text in str(caught.value)


def test_command_says_and_draws_the_offset(tmp_path: Path):
    content = mapping(PLANE, TWO_FILES, files={"gauge": {"offset_s": "estimate"}})
    recorded(tmp_path, 5 + TAXELS_S, EPOCH_S + GAUGE_S, content)
    arguments = ["import", "csv", str(tmp_path / "map.toml"), str(tmp_path / "sensor.csv"), "--out",
                 str(tmp_path / "again"), "--json"]  # fmt: skip
    done = CliRunner().invoke(app, arguments)
    assert done.exit_code == 0, done.output
    (clock,) = json.loads(done.stdout)["clocks"]
    assert clock["file"] == "gauge" and clock["by"] == "force_n" and clock["sigma_s"] < 0.01
    assert "by the correlation of force_n with the taxels" in done.stderr
    assert (tmp_path / "again" / "clocks.png").stat().st_size > 10_000
