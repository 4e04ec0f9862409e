"""Whatever is wrong with a dataset is named with its file, column and row, all at once."""

from __future__ import annotations

import re
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from skincal.dataset import check_dataset, read_dataset, write_dataset
from skincal.errors import InputError

Edit = Callable[[pd.DataFrame], pd.DataFrame | None]


def errors(folder: Path) -> list[str]:
    """The errors of a dataset, without the folder that all of them name."""
    said = [str(problem) for problem in check_dataset(folder).errors]
    assert all(text.startswith(str(folder)) for text in said)
    return [text.removeprefix(f"{folder}/") for text in said]


def assert_said(folder: Path, said: list[str]) -> None:
    text = "\n".join(errors(folder))
    for words in said:
        assert words in text


def edit_toml(folder: Path, old: str, new: str) -> None:
    path = folder / "dataset.toml"
    text = path.read_text()
    assert old in text
    path.write_text(text.replace(old, new, 1))


def edit_table(folder: Path, name: str, edit: Edit) -> None:
    path = folder / name
    table = pd.read_csv(path).astype(object)
    changed = edit(table)
    (table if changed is None else changed).to_csv(path, index=False)


def put(column: str, row: int, value: object) -> Edit:
    def edit(table: pd.DataFrame) -> None:
        table.loc[row, column] = value

    return edit


def scale(factor: float, *columns: str) -> Edit:
    def edit(table: pd.DataFrame) -> None:
        for column in columns:
            table[column] = table[column].astype(float) * factor

    return edit


def test_the_session_of_these_tests_is_good(folder: Path) -> None:
    check = check_dataset(folder)
    assert not check.errors
    assert not [w for w in check.warnings if "created" not in w.place]


TOML = [
    ("alpha_deg = 0.0", "alpa_deg = 0.0", ["[mount] alpa_deg", 'Did you mean "alpha_deg"?']),
    ("[sensor]", "[sensr]", ["sensr", 'Did you mean "sensor"?']),
    ('kind = "cylinder"', 'kind = "cylindr"', ["[surface] kind", 'Did you mean "cylinder"?']),
    ("rows = 4", "rows = 4.5", ["[sensor] rows", "whole number", "4.5"]),
    ("rows = 4", "rows = 0", ["[sensor] rows", "1 to 16384"]),
    ("rows = 4", "rows = true", ["[sensor] rows", "true"]),
    ("rows = 4\n", "", ["[sensor] rows", "nothing", "Add rows"]),
    ("rows = 4", "rows = = 4", ["dataset.toml", "line 6"]),
    ("rows = 4", "rows = 4\nrows = 5", ["dataset.toml", "overwrite"]),
    ("integer = true", 'integer = "yes"', ["[sensor] integer", "true or false", '"yes"']),
    ("pitch_m = 0.004", "pitch_m = 4.0", ["[sensor] pitch_m", "looks like millimetres"]),
    ("pitch_m = 0.004", "pitch_m = 4e-6", ["[sensor] pitch_m", "multiply by 1000"]),
    ("pitch_m = 0.004", "pitch_m = 0.002", ["[sensor] pitch_m", "Taxels overlap"]),
    ("pitch_m = 0.004", "pitch_m = [0.004, 0.002]", ["along v", "Taxels overlap"]),
    ("pitch_m = 0.004", "pitch_m = [0.004]", ["[sensor] pitch_m", "[du, dv]"]),
    ("taxel_size_m = 0.0025", "taxel_size_m = 2.5", ["[sensor] taxel_size_m", "looks like millimetres"]),
    ("taxel_size_m = 0.0025", "taxel_size_m = nan", ["[sensor] taxel_size_m", "nan"]),
    ("value_max = 255", "value_max = 0", ["[sensor] value_max", "value_min"]),
    (
        "value_max = 255",
        'value_max = "255"',
        ["[sensor] value_max", "a number", '"255". Write it without quotes.'],
    ),
    ('baseline = "raw"', 'baseline = "row"', ["[sensor] baseline", 'Did you mean "raw"?']),
    ("radius_m = 0.0115", "radius_m = 11.5", ["[surface] radius_m", "looks like millimetres"]),
    ("radius_m = 0.006", "radius_m = 6", ["[indenter] radius_m", "looks like millimetres"]),
    ("radius_m = 0.006", "radius_m = 6e-6", ["[indenter] radius_m", "multiply by 1000"]),
    ("radius_m = 0.006", "radius_m = -0.006", ["[indenter] radius_m", "-0.006"]),
    ("y_m = 0.0235", "y_m = 23.5", ["[mount] y_m", "looks like millimetres"]),
    ("y_m = 0.0235", "y_m = 0.04", ["[mount] y_m", "within y_range_m"]),
    ("    0.0275,", "    0.0175,", ["[mount] y_range_m", "ascending"]),
    ("alpha_deg = 0.0", "alpha_deg = 0.0\nx_m = 0.0", ["[mount] x_m", "beta_deg"]),
    ("sigma_m = 0.001", "sigma_m = 1.0", ["[position] sigma_m", "looks like millimetres"]),
    ("slack_m = 0.002", "slack_m = -0.002", ["[position] slack_m", "0 or more"]),
    ("slack_m = 0.002", "slack_m = inf", ["[position] slack_m", "inf"]),
    ("skincal-dataset/1", "skincal-dataset/2", ["format", "skincal-dataset/1"]),
    ("skincal-dataset/1", "skincal-calibration/1", ["format", "skincal-calibration/1"]),
    ("assumed = []", 'assumed = "force_n"', ["assumed", "a list of texts"]),
    ("assumed = []", 'assumed = []\ncreated = "yesterday"', ["created", '"yesterday"']),
    ('kind = "sphere"', 'kind = "mesh"\nfile = "tool.stl"', ["[indenter] file", "tool.stl", "no such file"]),
    ("rows = 4", 'rows = 4\npositions = "t.csv"', ["[sensor] positions", "t.csv", "no such file"]),
    ("radius_m = 0.0115", "radius_m = 0.0015", ["[mount]", "taxels beyond the surface"]),
]


@pytest.mark.parametrize(("old", "new", "said"), TOML)
def test_mistakes_in_the_description(folder: Path, old: str, new: str, said: list[str]) -> None:
    edit_toml(folder, old, new)
    assert_said(folder, said)
    with pytest.raises(InputError, match=r"dataset\.toml"):
        read_dataset(folder)


PRESSES: list[tuple[Edit, list[str]]] = [
    (
        put("force_n", 3, np.nan),
        [
            "presses.csv, column force_n, row 4 (line 5)",
            "a number",
            "nan. Give the number, or leave the row out.",
        ],
    ),
    (put("force_n", 3, "inf"), ["column force_n, row 4 (line 5)", "inf"]),
    (
        put("force_n", 3, "2.5 N"),
        ["column force_n, row 4 (line 5)", "'2.5 N'. Write the number alone, in the column's unit."],
    ),
    (put("force_n", 3, "2,5"), ["column force_n, row 4", "decimal point"]),
    (put("x_m", 2, np.nan), ["column x_m, row 3"]),
    (put("press", 5, 4), ["column press, row 6", "each number once; got 4. Remove the copy"]),
    (put("press", 5, 4.5), ["column press, row 6", "whole number", "4.5"]),
    (put("press", 5, -1), ["column press, row 6", "-1"]),
    (put("taxel_1_2", 5, 255.5), ["column taxel_1_2, row 6", "[0, 255]", "255.5"]),
    (put("taxel_1_2", 5, -0.1), ["column taxel_1_2, row 6", "-0.1"]),
    (
        lambda t: t.assign(
            **{
                f"taxel_{r}_{c}": t[f"taxel_{r}_{c}"].mask(t.index % 3 == c % 3)
                for r in range(4)
                for c in range(4)
            }
        ),
        ["columns: taxel_0_0 row 1", "dead taxel"],
    ),
    (put("taxel_1_2", 5, "inf"), ["column taxel_1_2, row 6", "finite"]),
    (put("t_hold_s", 5, 0.0), ["column t_hold_s, row 6", "t_start_s"]),
    (put("branch", 0, "upward"), ["column branch, row 1", "'upward'"]),
    (put("cycle", 1, 0.5), ["column cycle, row 2", "whole number", "Correct it, or leave the cell empty"]),
    (put("speed_m_per_s", 1, -1), ["column speed_m_per_s, row 2", "0 or more"]),
    (put("indenter_radius_m", 1, 0), ["column indenter_radius_m, row 2", "above 0"]),
    (put("nx", 1, 1.0), ["the 2 columns ny, nz"]),
    (put("q_0", 1, "fast"), ["column q_0, row 2", "'fast'"]),
    (
        lambda t: t.drop(columns="force_n"),
        ["presses.csv", "the column force_n", "`skincal import`", "of E and S"],
    ),
    (lambda t: t.assign(force_n=np.nan), ["column force_n, rows 1, 2, 3", "only the product of E and S"]),
    (lambda t: t.rename(columns={"force_n": "forse_n"}), ['Does "forse_n" stand for force_n?']),
    (lambda t: t.rename(columns={"force_n": "Force_N"}), ['Does "Force_N" stand for force_n?']),
    (
        lambda t: t.drop(columns=["taxel_0_1", "taxel_3_3"]),
        ["the 2 columns taxel_0_1, taxel_3_3", "NaN throughout"],
    ),
    (lambda t: t.assign(taxel_4_0=0), ["column taxel_4_0", "[sensor] rows"]),
    (lambda t: t.iloc[:0], ["presses.csv", "at least one press"]),
    (scale(1000, "x_m", "y_m", "z_m"), ["columns x_m, y_m, z_m", "looks like millimetres"]),
    (scale(1000, "y_m"), ["column y_m: expected contact points", "looks like millimetres"]),
    (scale(1e-3, "x_m", "y_m", "z_m"), ["columns x_m, y_m, z_m", "multiply by 1000"]),
    (scale(1000, "force_n"), ["column force_n", "looks like millinewtons"]),
    (scale(1e-3, "force_n"), ["column force_n", "looks like kilonewtons"]),
    (scale(-1, "force_n"), ["column force_n", "positive normal forces"]),
    (lambda t: t.assign(indenter_radius_m=6.0), ["column indenter_radius_m", "looks like millimetres"]),
    (lambda t: t.assign(speed_m_per_s=2.0), ["column speed_m_per_s", "millimetres per second"]),
    (lambda t: t.assign(shear_u_n=300.0), ["column shear_u_n", "millinewtons"]),
    (lambda t: t.assign(target_force_n=2500.0), ["column target_force_n", "millinewtons"]),
    (
        lambda t: t.assign(target_x_m=t.x_m * 1000, target_y_m=t.y_m * 1000, target_z_m=t.z_m * 1000),
        ["columns target_x_m, target_y_m, target_z_m", "looks like millimetres"],
    ),
]


@pytest.mark.parametrize(("edit", "said"), PRESSES)
def test_mistakes_in_the_presses(folder: Path, edit: Edit, said: list[str]) -> None:
    (folder / "frames.csv").unlink()
    edit_table(folder, "presses.csv", edit)
    assert_said(folder, said)


def renumbered(table: pd.DataFrame) -> pd.DataFrame:
    """Each press has the number of the one after it; rest is rest."""
    press = table.press.astype(int)
    return table.assign(press=np.where(press < 0, press, (press + 1) % (press.max() + 1)))


FRAMES: list[tuple[Edit, list[str]]] = [
    (put("time_s", 20, 0.0), ["frames.csv, column time_s, row 21 (line 22)", "ordered in time"]),
    (put("time_s", 20, np.nan), ["column time_s, row 21"]),
    (put("press", 20, 99), ["column press, row 21", "table of presses", "99"]),
    (put("press", 20, -2), ["column press, row 21", "-2"]),
    (put("press", 21, -1), ["column phase, row 22", '"idle"']),
    (put("phase", 20, "holt"), ["column phase, row 21", "idle, load, hold, unload", "'holt'"]),
    (put("force_n", 20, np.nan), ["column force_n, row 21"]),
    (put("x_m", 21, np.nan), ["column x_m, row 22"]),
    (put("taxel_0_0", 20, 0.5), ["column taxel_0_0, row 21", "whole numbers", "0.5"]),
    (put("taxel_0_0", 20, 256), ["column taxel_0_0, row 21", "[0, 255]"]),
    (lambda t: t.drop(columns="phase"), ["frames.csv", "the column phase"]),
    (lambda t: t.iloc[:0], ["frames.csv", "at least one frame"]),
    (scale(1000, "force_n"), ["frames.csv, column force_n", "millinewtons"]),
    (scale(1000, "x_m", "y_m", "z_m"), ["frames.csv, columns x_m, y_m, z_m", "looks like millimetres"]),
    (scale(1000, "time_s"), ["frames.csv, column time_s", "session clock", "milliseconds"]),
    (scale(0.0, "force_n"), ["frames.csv, column force_n", "got 0 times", "Was the force recorded?"]),
    (renumbered, ["frames.csv, column press", "of the presses of the table", "numbered equally"]),
]


def test_forces_of_zero(folder: Path) -> None:
    for file in ("presses.csv", "frames.csv"):
        edit_table(folder, file, scale(0, "force_n"))
    assert_said(folder, ["column force_n", "positive normal forces", "a median of 0 N"])


@pytest.mark.parametrize("differs", [False, True])
def test_an_assumed_constant_force(folder: Path, differs: bool) -> None:
    def edit(table: pd.DataFrame) -> None:
        taxels = [name for name in map(str, table) if name.startswith("taxel_")]
        size = np.geomspace(1, 6, len(table)) if differs else np.ones(len(table))
        shares = np.resize(np.eye(len(taxels)), (len(table), len(taxels)))
        table["force_n"], table[taxels] = 2.0, np.rint(30 * size[:, None] * shares)

    (folder / "frames.csv").unlink()
    edit_toml(folder, "assumed = []", 'assumed = ["force_n"]')
    edit_table(folder, "presses.csv", edit)
    assert any(one.code == "assumed_force" for one in check_dataset(folder).warnings) == differs


def test_a_force_of_zero_is_not_good(folder: Path) -> None:
    (folder / "frames.csv").unlink()
    edit_table(folder, "presses.csv", put("force_n", 3, 0.0))
    (found,) = (one for one in check_dataset(folder).warnings if one.code == "force_not_positive")
    assert "row 4" in found.place


@pytest.mark.parametrize(("edit", "said"), FRAMES)
def test_mistakes_in_the_frames(folder: Path, edit: Edit, said: list[str]) -> None:
    edit_table(folder, "frames.csv", edit)
    assert_said(folder, said)


@pytest.mark.parametrize(
    ("edit", "place"),
    [
        (put("press", 5, 0.5), "column press, row 6 (line 7)"),
        (put("taxel_1_2", 5, "much"), "column taxel_1_2, row 6 (line 7)"),
    ],
)
def test_a_wrong_cell_is_one_mistake(folder: Path, edit: Edit, place: str) -> None:
    (folder / "frames.csv").unlink()
    edit_table(folder, "presses.csv", edit)
    (said,) = errors(folder)
    assert said.startswith(f"presses.csv, {place}")


def test_where_the_size_of_the_sensor_is_wrong_no_taxel_is(folder: Path) -> None:
    edit_toml(folder, "rows = 4", 'rows = "four"')
    (said,) = errors(folder)
    assert said.startswith("dataset.toml, [sensor] rows")


def test_everything_wrong_is_said_at_once(folder: Path) -> None:
    edit_toml(folder, "radius_m = 0.006", "radius_m = 6")
    edit_table(folder, "presses.csv", put("force_n", 3, np.nan))
    edit_table(folder, "presses.csv", scale(1000, "x_m", "y_m", "z_m"))
    edit_table(folder, "frames.csv", put("time_s", 20, 0.0))
    with pytest.raises(InputError) as raised:
        read_dataset(folder)
    places = [problem.place for problem in raised.value.problems]
    assert places == [
        str(folder / place)
        for place in (
            "dataset.toml, [indenter] radius_m",
            "presses.csv, column force_n, row 4 (line 5)",
            "frames.csv, column time_s, row 21 (line 22)",
            "presses.csv, columns x_m, y_m, z_m",
        )
    ]


def test_the_folder_is_named_however_it_was_given(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    # A folder whose name a file's name begins with, given relative to another one.
    folder = folder.rename(folder.with_name("presses"))
    edit_table(folder, "presses.csv", put("force_n", 3, np.nan))
    monkeypatch.chdir(folder.parent)
    (place,) = (problem.place for problem in check_dataset("presses").errors)
    assert place == "presses/presses.csv, column force_n, row 4 (line 5)"
    monkeypatch.chdir(folder)
    (place,) = (problem.place for problem in check_dataset(".").errors)
    assert place == "presses.csv, column force_n, row 4 (line 5)"


def test_repeats_of_one_mistake_are_counted_not_listed(folder: Path) -> None:
    def edit(table: pd.DataFrame) -> None:
        table.loc[2:8, "force_n"] = np.nan

    edit_table(folder, "presses.csv", edit)
    said = [text for text in errors(folder) if text.startswith("presses.csv")]
    assert said == [
        "presses.csv, column force_n, rows 3, 4, 5 and 4 more: expected a number; got nan, nan, nan, … "
        "Give the number, or leave the row out."
    ]


def test_one_image_without_values_is_one_mistake(folder: Path) -> None:
    def edit(table: pd.DataFrame) -> None:
        table.loc[4, [name for name in table.columns if name.startswith("taxel")]] = np.nan

    edit_table(folder, "presses.csv", edit)
    (said,) = errors(folder)
    assert said.startswith(
        "presses.csv, 16 columns: taxel_0_0 row 5, taxel_0_1 row 5, taxel_0_2 row 5 and 13 more"
    )


@pytest.mark.parametrize("keep", [0, 10, 0.5, 0.95])
def test_a_truncated_parquet_file(folder: Path, session: Callable, tmp_path: Path, keep: float) -> None:
    write_dataset(session(40), tmp_path / "p", presses_as="parquet")
    for name in ("presses.parquet", "frames.parquet"):
        path = tmp_path / "p" / name
        content = path.read_bytes()
        path.write_bytes(content[: int(keep if keep > 1 else keep * len(content))])
    said = errors(tmp_path / "p")
    assert [text.split(":")[0] for text in said] == ["presses.parquet", "frames.parquet"]
    assert all("a whole Parquet file" in text and ".." not in text for text in said)


def test_a_parquet_file_damaged_inside(session: Callable, tmp_path: Path) -> None:
    write_dataset(session(40), tmp_path / "p", presses_as="parquet")
    path = tmp_path / "p" / "presses.parquet"
    content = bytearray(path.read_bytes())
    content[4:400] = bytes(396)
    path.write_bytes(content)
    (said,) = errors(tmp_path / "p")
    assert said.startswith("presses.parquet: expected a whole Parquet file")


def test_a_truncated_csv_file(folder: Path) -> None:
    path = folder / "presses.csv"
    text = path.read_text()
    path.write_text(text[: len(text) - 60])
    (said,) = errors(folder)[:1]
    assert said.startswith("presses.csv, line 13: expected 26 cells as in the header")
    assert "cut short" in said


def test_an_empty_csv_file(folder: Path) -> None:
    (folder / "presses.csv").write_text("")
    assert errors(folder)[0] == (
        "presses.csv: expected a header line and rows; got an empty file. Write it again."
    )


def test_semicolons_between_cells(folder: Path) -> None:
    path = folder / "presses.csv"
    path.write_text(path.read_text().replace(",", ";"))
    assert "separated by semicolons" in "\n".join(errors(folder))


def test_a_column_twice(folder: Path) -> None:
    path = folder / "presses.csv"
    path.write_text(path.read_text().replace("taxel_0_1", "taxel_0_0", 1))
    said = "presses.csv, column taxel_0_0: expected each column once; got 2 of that name. Rename or remove the others."
    assert said in errors(folder)


def test_binary_rubbish_for_a_description(folder: Path) -> None:
    (folder / "dataset.toml").write_bytes(b"\xff\xfe\x00\x01")
    assert errors(folder)[0].startswith("dataset.toml: expected a readable text file")


def test_binary_rubbish_for_presses(folder: Path, capfd: pytest.CaptureFixture[str]) -> None:
    (folder / "presses.csv").write_bytes(b"a,b,c\n\xd3\x00,1\n\xff\xfe\n" * 50)
    assert errors(folder)[0].startswith("presses.csv, line 2: expected text in UTF-8")
    assert "Traceback" not in capfd.readouterr().err


@pytest.mark.parametrize("odd", [b",\xe4", b",\xc3"], ids=["in the middle", "at the end"])
def test_other_bytes_far_down(folder: Path, capfd: pytest.CaptureFixture[str], odd: bytes) -> None:
    """In a row of other length, whose text the CSV reader asks for."""
    header, row, *_ = (folder / "presses.csv").read_bytes().splitlines()
    lines = [header, *[row] * (1 + (1 << 21) // len(row)), row + odd]
    after = [row] if odd == b",\xe4" else []
    (folder / "presses.csv").write_bytes(b"\n".join([*lines, *after]))
    text = f"presses.csv, line {len(lines)}: expected text in UTF-8; got other bytes"
    assert errors(folder)[0].startswith(text)
    assert capfd.readouterr().err == ""


def test_both_kinds_of_a_table(folder: Path) -> None:
    (folder / "presses.parquet").write_bytes(b"")
    assert "presses.csv and presses.parquet" in errors(folder)[0]


def test_no_folder_no_description_no_presses(folder: Path, tmp_path: Path) -> None:
    assert "no such folder" in errors(tmp_path / "nothing")[0]
    assert "a file" in errors(folder / "presses.csv")[0]
    (folder / "presses.csv").unlink()
    assert "presses.csv or presses.parquet" in errors(folder)[0]
    (folder / "dataset.toml").unlink()
    assert "no such file" in errors(folder)[0]


def test_what_cannot_be_used_but_is_well_formed_is_a_warning(folder: Path) -> None:
    (folder / "frames.csv").unlink()
    edit_table(folder, "presses.csv", scale(0.0, *[f"taxel_{r}_{c}" for r in range(4) for c in range(4)]))
    check = check_dataset(folder)
    assert not check.errors
    assert any("none in any press" in str(w) for w in check.warnings)


@pytest.mark.parametrize(
    ("wrong", "said"),
    [
        ("slack_m = 2e-6", "slack_m: expected more than sigma_m"),
        ("sigma_m = 1e-6", "sigma_m: expected a good part of slack_m"),
    ],
)
def test_an_inconsistent_slack_and_sigma_are_a_warning(folder: Path, wrong: str, said: str) -> None:
    path, key = folder / "dataset.toml", wrong.split()[0]
    path.write_text(re.sub(rf"(?m)^{key} = .*$", wrong, path.read_text()))
    check = check_dataset(folder)
    assert not check.errors
    assert any(said in str(w) for w in check.warnings)


WARNED: list[tuple[Edit, str]] = [
    (put("force_n", 2, -0.5), "column force_n, row 3"),
    (lambda t: t.assign(taxel_0_0=255), "nearly always 255 from taxel_0_0"),
    (lambda t: t.assign(temperature_c=295.0), "Kelvin"),
    (
        lambda t: t.assign(q_0=0.3, q_1=-42.0),
        "column q_1: expected angles [rad]; got a median of 42. Degrees?",
    ),
    (lambda t: t.assign(t_relese_s=1.0).drop(columns="t_release_s"), 'Did you mean "t_release_s"?'),
    (lambda t: pd.concat([t, t.tail(1).assign(press=77)]), "Was a press copied?"),
    (lambda t: t.assign(nx=0.0, ny=0.0, nz=-1.0), "the direction of the force"),
    (lambda t: t.assign(x_m=t.x_m * 2, z_m=t.z_m * 2), "Is the surface in dataset.toml the right one"),
]


@pytest.mark.parametrize(("edit", "said"), WARNED)
def test_what_a_person_should_know(folder: Path, edit: Edit, said: str) -> None:
    (folder / "frames.csv").unlink()
    edit_table(folder, "presses.csv", edit)
    check = check_dataset(folder)
    assert not check.errors
    assert said in "\n".join(str(w) for w in check.warnings)
    assert read_dataset(folder).warnings == check.warnings


def test_forces_that_drop_out_are_reported(folder: Path) -> None:
    def dropped(table: pd.DataFrame) -> None:
        held = np.flatnonzero(table.phase == "hold")
        table.loc[held[::10], "force_n"] = 0.0

    edit_table(folder, "frames.csv", dropped)
    check = check_dataset(folder)
    assert not check.errors
    (said,) = [str(w) for w in check.warnings if "force_n" in w.place]
    assert "less than a third of it" in said and "drop out" in said


def test_one_press_with_the_frames_of_another_is_reported(folder: Path) -> None:
    def swapped(table: pd.DataFrame) -> None:
        first, last = (np.flatnonzero(table.press == p) for p in (0, int(table.press.max())))
        count = min(len(first), len(last))
        columns = [
            c for c in table.columns if c.startswith("taxel_") or c in ("x_m", "y_m", "z_m", "force_n")
        ]
        table.loc[first[:count], columns] = table.loc[last[:count], columns].to_numpy()

    edit_table(folder, "frames.csv", swapped)
    said = [str(w) for w in check_dataset(folder).warnings if "numbered equally" in str(w)]
    assert len(said) == 1 and "1 of" in said[0] and "(press 0)" in said[0]
