"""Tables with one row a press, as others write them."""

from __future__ import annotations

import re
import tomllib
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest

from skincal.calibrate.data_findings import order_finding
from skincal.dataset import Dataset, read_dataset
from skincal.errors import InputError
from skincal.fitting.wiring import TaxelOrder
from skincal.fitting.wiring_orders import mapping_of
from skincal.imports import import_csv, template
from tests.imports.foreign import (
    PRESS_ROWS,
    imported,
    mapping,
    press_table,
    refusals,
    write_mapping,
    write_press_table,
)  # fmt: skip

Session = Callable[..., Dataset]
BUNDLED = Path(__file__).parents[2] / "data" / "paper-like"


@pytest.fixture
def original() -> Dataset:
    return read_dataset(BUNDLED)


def bring(folder: Path, table: pd.DataFrame, content: dict[str, Any]) -> Dataset:
    return imported(folder, content, [write_press_table(folder / "p.csv", table)])[0]


def refused(folder: Path, table: pd.DataFrame, content: dict[str, Any] | None = None) -> list[str]:
    path = write_press_table(folder / "p.csv", table)
    return refusals(folder, mapping(PRESS_ROWS) if content is None else content, [path])


def same(one: Dataset, other: Dataset) -> None:
    np.testing.assert_array_equal(one.presses.press, other.presses.press)
    np.testing.assert_allclose(one.presses.position_m, other.presses.position_m, rtol=0, atol=1e-15)
    np.testing.assert_allclose(one.presses.force_n, other.presses.force_n, rtol=1e-15)
    np.testing.assert_allclose(one.presses.counts, other.presses.counts, rtol=0, atol=1e-13)
    assert list(one.presses.columns) == list(other.presses.columns)


def test_bundled_dataset_goes_out_and_comes_back(tmp_path: Path, original: Dataset):
    back = bring(tmp_path, press_table(original), mapping(PRESS_ROWS))
    same(back, original)
    for table in ("sensor", "surface", "indenter", "mount", "position"):
        assert getattr(back.meta, table) == getattr(original.meta, table)
    assert back.meta.assumed == ()


def test_template_works(tmp_path: Path, original: Dataset):
    names = {"X": "x [mm]", "Y": "y [mm]", "Z": "z [mm]", "Fz": "Fz [mN]"}
    path = write_press_table(tmp_path / "p.csv", press_table(original).rename(columns=names))
    (tmp_path / "m.toml").write_text(template("csv"), encoding="utf-8")
    import_csv(tmp_path / "m.toml", tmp_path / "out", [path])
    same(read_dataset(tmp_path / "out"), original)


def test_columns_in_si_need_no_conversion(tmp_path: Path, original: Dataset):
    content = mapping(
        csv={"rows": "presses"},
        columns={name: name for name in ("press", "x_m", "y_m", "z_m", "force_n")},
        taxels={"columns": "taxel_{r}_{c}"},
    )
    back, _ = imported(tmp_path, content, [BUNDLED / "presses.csv"])
    np.testing.assert_array_equal(back.presses.counts, original.presses.counts)
    np.testing.assert_array_equal(back.presses.position_m, original.presses.position_m)
    np.testing.assert_array_equal(back.presses.force_n, original.presses.force_n)


def test_file_of_latin_letters_comments_and_a_line_of_units(tmp_path: Path, original: Dataset):
    table = press_table(original)
    text = table.to_csv(sep="\t", index=False)
    head, rows = text.split("\n", 1)
    units = "\t".join(["[µ]"] * table.shape[1])
    content = f"Prüfstand 3\n\n# calibrated\n{head}\n{units}\n# first run\n\n{rows}# end\n"
    (tmp_path / "p.csv").write_bytes(content.replace("\n", "\r\n").encode("latin-1"))
    form = {"delimiter": "\t", "decimal": ".", "encoding": "latin-1", "comment": "#"}
    form |= {"skip_rows": 1, "skip_after_header": 1}
    back, done = imported(tmp_path, mapping(PRESS_ROWS, csv=form), [tmp_path / "p.csv"])
    assert done.read[0].rows == 60
    same(back, original)


def test_columns_of_numbers_between_blanks_without_a_header(tmp_path: Path, original: Dataset):
    table = press_table(original)
    lines = ["  ".join(f"{cell:>22.17g}" for cell in row) for row in table.itertuples(index=False, name=None)]
    (tmp_path / "p.dat").write_text("\n".join(lines) + "\n")
    content = mapping(
        PRESS_ROWS,
        csv={"delimiter": "whitespace", "decimal": ".", "header": False},
        columns={"press": "1", "position": {"columns": ["2", "3", "4"]}, "force_n": {"column": "5"}},
        taxels={"columns": [str(j) for j in range(6, 22)], "first": None},
    )
    same(imported(tmp_path, content, [tmp_path / "p.dat"])[0], original)


IMAGE = np.arange(12).reshape(3, 4)
"""Our image of 3 rows and 4 columns, each taxel by its flat index."""


@pytest.mark.parametrize(
    ("taxels", "source"),
    [
        ({"columns": "t_{r}_{c}"}, IMAGE),
        ({"columns": "t_{r}_{c}", "transpose": True}, IMAGE.T),
        ({"columns": "t_{r}_{c}", "flip_rows": True}, IMAGE[::-1]),
        ({"columns": "t_{r}_{c}", "flip_cols": True}, IMAGE[:, ::-1]),
        ({"columns": "t_{r}_{c}", "transpose": True, "flip_rows": True}, IMAGE[::-1].T),
        ({"columns": "t_{r}_{c}", "transpose": True, "flip_cols": True}, IMAGE[:, ::-1].T),
    ],
)
def test_image_is_turned_as_the_mapping_says(
    tmp_path: Path, session: Session, taxels: dict, source: np.ndarray
):
    """A source image shows, at each place, the index of our taxel that lies there."""
    table, content = _of_images(session())
    for (r, c), j in np.ndenumerate(source):
        table[f"t_{r}_{c}"] = table[f"our{j}"]
    _check_image(tmp_path, table, mapping(content, taxels=taxels))


def _lines(flat: np.ndarray) -> dict[str, Any]:
    """The mapping that a fit names for a source whose position p holds our taxel ``flat[p]``."""
    return {"columns": "s{j}", **tomllib.loads(mapping_of(np.argsort(flat), 3, 4))}


@pytest.mark.parametrize(
    ("taxels", "flat"),
    [
        ({"columns": "s{j}"}, IMAGE.ravel()),
        ({"columns": "s{j}", "order": "columns"}, IMAGE.T.ravel()),
        ({"columns": "s{j}", "order": "columns", "transpose": True}, IMAGE.ravel()),
        ({"columns": "s{j}", "flip_rows": True}, IMAGE[::-1].ravel()),
        ({"columns": [f"s{j}" for j in range(12)]}, IMAGE.ravel()),
        ({"columns": [f"s{j}" for j in range(12)], "order": "columns"}, IMAGE.T.ravel()),
        ({"columns": [[f"s{4 * r + c}" for c in range(4)] for r in range(3)]}, IMAGE.ravel()),
        ({"columns": "s{j}", "order": [*range(10), 11, 10]}, np.array([*range(10), 11, 10])),
        (
            {"columns": "s{j}", "order": [*range(1, 12), 0], "flip_rows": True},
            np.roll(IMAGE[::-1].ravel(), 1),
        ),
        (_lines(IMAGE.T.ravel()), IMAGE.T.ravel()),
        (_lines(IMAGE[::-1, ::-1].ravel()), IMAGE[::-1, ::-1].ravel()),
        (_lines(IMAGE.ravel()[[3, 1, 2, 0, *range(4, 12)]]), IMAGE.ravel()[[3, 1, 2, 0, *range(4, 12)]]),
    ],
)
def test_flat_image_is_ordered_as_the_mapping_says(
    tmp_path: Path, session: Session, taxels: dict, flat: np.ndarray
):
    table, content = _of_images(session())
    for position, j in enumerate(flat):
        table[f"s{position}"] = table[f"our{j}"]
    _check_image(tmp_path, table, mapping(content, taxels=taxels))


@pytest.mark.parametrize("columns", ["s{j}", [[f"s{4 * r + c}" for c in range(4)] for r in range(3)]])
@pytest.mark.parametrize(
    "wrong", [{}, {"order": "columns"}, {"flip_rows": True, "flip_cols": True}, {"order": [11, *range(11)]}]
)
@pytest.mark.parametrize("flat", [IMAGE.ravel(), IMAGE[::-1].ravel(), np.roll(IMAGE.ravel(), 3)])
def test_the_named_order_contains_that_of_the_mapping(
    tmp_path: Path, session: Session, columns: Any, wrong: dict[str, Any], flat: np.ndarray
):
    """A fit sees the images after the mapping has ordered them; its line takes the place of those of the mapping."""
    table, content = _of_images(session())
    for position, j in enumerate(flat):
        table[f"s{position}"] = table[f"our{j}"]
    data = bring(tmp_path, table, mapping(content, taxels={"columns": columns, **wrong}))
    ours = table[[f"our{j}" for j in range(12)]].to_numpy()
    order = np.array([int(np.flatnonzero(data.presses.counts[0] == value)[0]) for value in ours[0]])
    found = TaxelOrder(order, mapping_of(order, 3, 4), 2.0, 1.0, 20.0)
    lines = tomllib.loads(order_finding(found, data).mapping)
    (tmp_path / "b").mkdir()
    _check_image(tmp_path / "b", table, mapping(content, taxels={"columns": columns, **lines}))


def _of_images(dataset: Dataset) -> tuple[pd.DataFrame, dict[str, Any]]:
    table = press_table(dataset).drop(columns=[f"s{j + 1}" for j in range(16)])
    for j in range(12):
        table[f"our{j}"] = 10.0 + 3 * j + 0.25 * np.arange(len(table))
    content = mapping(PRESS_ROWS, sensor={"rows": 3}, taxels={"first": None, "falling_from": None})
    return table, content


def _check_image(folder: Path, table: pd.DataFrame, content: dict[str, Any]) -> None:
    expected = table[[f"our{j}" for j in range(12)]].to_numpy()
    back = bring(folder, table, content)
    np.testing.assert_array_equal(back.presses.counts, expected)


def test_frame_turns_and_shifts_positions_and_normals(tmp_path: Path, original: Dataset):
    rotation = np.array([[0.0, -1, 0], [1, 0, 0], [0, 0, 1]])  # 90° about z
    shift = np.array([0.01, -0.02, 0.03])
    table = press_table(original)
    points = (original.presses.position_m - shift) @ rotation  # the way back
    normals = original.surface().normal_at(original.presses.position_m)
    for i, name in enumerate("XYZ"):
        table[name] = points[:, i] * 1e3
        table[f"n{name}"] = -(normals @ rotation)[:, i]
    content = mapping(
        PRESS_ROWS,
        columns={"normal": {"columns": ["nX", "nY", "nZ"], "sign": -1}},
        frame={"rotation_deg": [0, 0, 90], "translation_m": shift.tolist()},
    )
    back = bring(tmp_path, table, content)
    np.testing.assert_allclose(back.presses.position_m, original.presses.position_m, rtol=0, atol=1e-15)
    assert back.presses.normals is not None
    np.testing.assert_allclose(back.presses.normals, normals, rtol=0, atol=1e-14)


@pytest.mark.parametrize(
    "frame",
    [
        {"quaternion_xyzw": [0.5, 0.5, 0.5, 0.5]},
        {"matrix": [[0, 0, 1], [1, 0, 0], [0, 1, 0]]},
        {"rotation_deg": [90, 0, 90]},
    ],
)
def test_three_ways_to_say_the_same_rotation(tmp_path: Path, original: Dataset, frame: dict):
    table = press_table(original)
    x, y, z = original.presses.position_m.T * 1e3
    # x of the source becomes our y, y our z, and z our x.
    table["X"], table["Y"], table["Z"] = y, z, x
    back = bring(tmp_path, table, mapping(PRESS_ROWS, frame=frame))
    np.testing.assert_allclose(back.presses.position_m, original.presses.position_m, rtol=0, atol=1e-14)


def test_centres_of_the_indenter_go_onto_the_surface(tmp_path: Path, original: Dataset):
    table = press_table(original)
    surface = original.surface()
    on_it = surface.project(original.presses.position_m)
    centres = on_it + 0.006 * surface.normal_at(on_it)
    for i, name in enumerate("XYZ"):
        table[name] = centres[:, i] * 1e3
    back = bring(tmp_path, table, mapping(PRESS_ROWS, frame={"project": True}))
    np.testing.assert_allclose(back.presses.position_m, on_it, rtol=0, atol=1e-12)
    assert back.meta.assumed == ("position.depth",)


def test_covariates_constants_words_and_vectors(tmp_path: Path, original: Dataset):
    table = press_table(original)
    table["T"] = 300.0
    table["joint"] = np.linspace(-90, 90, 60)
    table["torque"] = 20.0
    table["way"] = ["loading", "unloading"] * 30
    table["humidity"] = 0.4
    table["Fx"], table["Fy"], table["Fn"] = 0.6 * -table["Fz"], 0.0, 0.8 * -table["Fz"]
    content = mapping(
        PRESS_ROWS,
        columns={
            "temperature_c": {"column": "T", "unit": "K"},
            "q_0": {"column": "joint", "unit": "deg"},
            "tau_0": {"column": "torque", "unit": "mNm"},
            "branch": {"column": "way", "words": {"loading": "up", "unloading": "down"}},
            "pose": {"value": "A"},
            "indenter_radius_m": {"value": 6, "unit": "mm"},
            "humidity": "humidity",
            "force_n": {"column": None, "columns": ["Fx", "Fy", "Fn"], "sign": None},
        },
    )
    back = bring(tmp_path, table, content)
    columns = back.presses.columns
    np.testing.assert_allclose(columns["temperature_c"], 26.85)
    np.testing.assert_allclose(columns["q_0"], np.linspace(-np.pi / 2, np.pi / 2, 60))
    np.testing.assert_allclose(columns["tau_0"], 0.02)
    assert columns["branch"][:2].tolist() == ["up", "down"]
    assert set(columns["pose"]) == {"A"}
    np.testing.assert_allclose(columns["indenter_radius_m"], 0.006)
    np.testing.assert_allclose(columns["humidity"], 0.4)
    np.testing.assert_allclose(back.presses.force_n, original.presses.force_n, rtol=1e-12)
    assert back.meta.assumed == ("indenter_radius_m",)


def test_volts_become_newtons_by_scale_and_offset(tmp_path: Path, original: Dataset):
    table = press_table(original)
    table["V"] = (original.presses.force_n + 1.5) / 2.0
    force = {"column": "V", "unit": "N", "sign": None, "scale": 2.0, "offset": -1.5}
    back = bring(tmp_path, table, mapping(PRESS_ROWS, columns={"force_n": force}))
    np.testing.assert_allclose(back.presses.force_n, original.presses.force_n, rtol=1e-12)


def test_other_columns_have_the_unit_that_their_name_ends_in(tmp_path: Path, original: Dataset):
    table = press_table(original).assign(depth=0.8, drive=3.0)
    columns = {"depth_m": {"column": "depth", "unit": "mm"}, "drive_m": {"column": "drive"}}
    back = bring(tmp_path, table, mapping(PRESS_ROWS, columns=columns))
    assert set(back.presses.columns["depth_m"]) == {8e-4} and set(back.presses.columns["drive_m"]) == {3.0}


def test_unknown_positions_need_no_columns(tmp_path: Path, original: Dataset):
    content = mapping(
        PRESS_ROWS,
        columns={"position": None},
        position={"sigma_m": float("inf"), "slack_m": float("inf")},
        indenter={"kind": "flat", "radius_m": 0.1},
        taxels={"falling_from": 255},
    )
    table = press_table(original)
    table["Fz"] *= 100  # a pressure all over the patch
    back = bring(tmp_path, table, content)
    assert np.isnan(back.presses.position_m).all()


def test_several_files_follow_each_other(tmp_path: Path, original: Dataset):
    table = press_table(original)
    paths = [
        write_press_table(tmp_path / f"{i}.csv", part) for i, part in enumerate((table[:20], table[20:]))
    ]
    back, done = imported(tmp_path, mapping(PRESS_ROWS), paths)
    assert [(file.file, file.rows) for file in done.read] == [("0.csv", 20), ("1.csv", 40)]
    same(back, original)


def test_incomplete_rows_are_left_out_where_asked(tmp_path: Path, original: Dataset):
    table = press_table(original)
    table.loc[[3, 7], "Fz"] = np.nan
    path = write_press_table(tmp_path / "p.csv", table)
    back, done = imported(tmp_path, mapping(PRESS_ROWS, csv={"drop_incomplete": True}), [path])
    assert [str(dropped) for dropped in done.dropped] == ["2 rows: no value in a required column (force_n)"]
    assert back.presses.press.tolist() == [k for k in range(60) if k not in (3, 7)]


def test_missing_columns(tmp_path: Path, original: Dataset):
    found = refused(tmp_path, press_table(original).rename(columns={"Fz": "fz", "s3": "q3"}))
    assert len(found) == 2
    assert 'p.csv: expected a column "Fz"; got the columns "no", "X"' in found[0]
    assert 'Did you mean "fz"?' in found[0]
    assert 'expected a column "s3"' in found[1]


def test_wrong_delimiter_is_named(tmp_path: Path, original: Dataset):
    found = refused(
        tmp_path, press_table(original), mapping(PRESS_ROWS, csv={"delimiter": ",", "decimal": "."})
    )
    assert any('set delimiter = ";"' in text for text in found)


def test_every_bad_cell_is_named_at_once(tmp_path: Path, original: Dataset):
    table = press_table(original).astype(object)  # such columns are written with a point
    table.loc[4, "X"] = "left"
    table.loc[5, "Fz"] = np.nan
    table.loc[6, "s2"] = "?"
    found = refused(tmp_path, table, mapping(PRESS_ROWS, csv={"decimal": "."}))
    assert found[0].startswith("p.csv, column \"X\", row 5 (line 6): expected a number; got 'left'")
    assert any(
        'column "Fz", row 6 (line 7): expected a number (force_n is required' in text for text in found
    )
    assert any("column \"s2\", row 7 (line 8): expected a number; got '?'" in text for text in found)
    assert len(found) == 3


def test_wrong_decimal_mark_is_named(tmp_path: Path, original: Dataset):
    found = refused(tmp_path, press_table(original), mapping(PRESS_ROWS, csv={"decimal": "."}))
    assert any('Set decimal = "," in [csv]' in text for text in found)


@pytest.mark.parametrize("word", ["null", "-", "N/A", "#N/A", "1.#QNAN"])
def test_word_for_no_value_is_named(tmp_path: Path, original: Dataset, word: str):
    table = press_table(original).astype(object)  # such columns are written with a point
    table.loc[3, "s2"] = word
    (found,) = refused(tmp_path, table, mapping(PRESS_ROWS, csv={"decimal": "."}))
    words = ["NaN", "nan", "NA", word]
    assert f"set missing = {words} in [csv]".replace("'", '"') in found
    back = bring(tmp_path, table, mapping(PRESS_ROWS, csv={"decimal": ".", "missing": words}))
    assert np.isnan(back.presses.counts).sum() == 1


@pytest.mark.parametrize(
    ("mark", "decimal", "fix"),
    [
        (".", ",", 'Set thousands = "."'),
        ("'", ",", 'Set thousands = "\'"'),
        ("\u202f", ",", 'Set thousands = " "'),
        (",", ".", 'Set thousands = ","'),
        (".", ".", 'Set decimal = "," and thousands = "."'),
    ],
)
def test_mark_of_thousands_is_named(tmp_path: Path, original: Dataset, mark: str, decimal: str, fix: str):
    table, written = press_table(original), "," if decimal == mark else decimal
    numbers = table.drop(columns="no").map(lambda value: f"{value:,.6f}")
    marks = str.maketrans({",": mark, ".": written})
    table = numbers.map(lambda text: text.translate(marks)).assign(no=table["no"])
    found = refused(tmp_path, table, mapping(PRESS_ROWS, csv={"decimal": decimal}))
    assert any('column "Fz"' in text and fix in text for text in found)
    thousands = " " if mark.isspace() else mark
    back = bring(tmp_path, table, mapping(PRESS_ROWS, csv={"decimal": written, "thousands": thousands}))
    np.testing.assert_allclose(back.presses.force_n, original.presses.force_n, rtol=0, atol=1e-9)


@pytest.mark.parametrize(
    ("columns", "place", "fix"),
    [
        (
            {"force_n": {"unit": "N"}},
            'column force_n (map.toml, [columns.force_n], unit "N")',
            "divide by 1000",
        ),
        ({"position": {"unit": "m"}}, 'unit "m"', "divide by 1000"),
        ({"position": {"unit": "um"}}, 'unit "um"', ""),
    ],
)
def test_unit_off_by_a_thousand(tmp_path: Path, original: Dataset, columns: dict, place: str, fix: str):
    table = press_table(original)
    table["Fz"] *= 20  # forces that no unit but millinewtons makes plausible
    found = refused(tmp_path, table, mapping(PRESS_ROWS, columns=columns))
    assert any(place in text and fix in text and "imported presses.csv" in text for text in found), found


def test_wrong_sign_is_refused(tmp_path: Path, original: Dataset):
    found = refused(tmp_path, press_table(original), mapping(PRESS_ROWS, columns={"force_n": {"sign": 1}}))
    assert any("positive normal forces" in text and "[columns.force_n]" in text for text in found)


def test_doubled_press(tmp_path: Path, original: Dataset):
    table = press_table(original)
    table.loc[9, "no"] = 4
    assert refused(tmp_path, table) == [
        "p.csv, row 10, press: expected each number once; got 4 again. "
        "The same press twice? Without [columns.press] presses are counted."
    ]


def test_file_cut_short(tmp_path: Path, original: Dataset):
    path = write_press_table(tmp_path / "p.csv", press_table(original))
    text = path.read_text()
    path.write_text(text[: len(text) - 60])
    said = "\n".join(refusals(tmp_path, mapping(PRESS_ROWS), [path]))
    assert re.search(r"p.csv, line 61: expected 21 cells as in the header; got \d+ cells", said)


def test_wrong_encoding(tmp_path: Path):
    (tmp_path / "p.csv").write_bytes("no;µ\n1;2\n".encode("latin-1"))
    said = "\n".join(refusals(tmp_path, mapping(PRESS_ROWS), [tmp_path / "p.csv"]))
    assert "p.csv: expected text in utf-8; got byte 3" in said


def test_no_files(tmp_path: Path):
    path = write_mapping(tmp_path, mapping(PRESS_ROWS))
    with pytest.raises(InputError, match="Name them on the command line"):
        import_csv(path, tmp_path / "out")
    with pytest.raises(InputError, match=r"nowhere\.csv: expected a CSV file to read; got no such file"):
        import_csv(path, tmp_path / "out", ["nowhere.csv"])


def test_existing_output_is_kept(tmp_path: Path, original: Dataset):
    bring(tmp_path, press_table(original), mapping(PRESS_ROWS))
    with pytest.raises(InputError, match="--force"):
        bring(tmp_path, press_table(original)[:30], mapping(PRESS_ROWS))
    assert len(read_dataset(tmp_path / "out").presses) == 60
    import_csv(tmp_path / "map.toml", tmp_path / "out", [tmp_path / "p.csv"], force=True)
    assert len(read_dataset(tmp_path / "out").presses) == 30
