"""Text that is no table, and files of arrays: read, or refused with their kind."""

from __future__ import annotations

import gzip
import io
import json
import pickle
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest

from skincal.dataset import Dataset
from skincal.errors import WorkError
from skincal.imports import import_rosbag, layout_hints
from skincal.imports.array_files import read_hdf5
from skincal.imports.frame_text import NAMED, PAIR
from skincal.imports.mapping_file import CsvFormat
from tests.imports.devices import ONE_FILE, PLANE, contacts, gauge_table, whole_table
from tests.imports.foreign import imported, mapping, refusals
from tests.imports.ros import BAG

pytestmark = pytest.mark.usefixtures("in_process")

FOUND = contacts()
TIME = np.arange(0, FOUND.end_s, 0.02)
IMAGES = FOUND.images(TIME).astype(int)
GAUGE = gauge_table(FOUND, TIME)

WEIGHTS: dict[str, Any] = {
    "csv": {"rows": "series", "header": False},
    "columns": {"force_n": {"value": 2.0, "unit": "N"}},
    "taxels": {"columns": "{j}", "first": 1},
    "position": {"sigma_m": float("inf"), "slack_m": 0.001},
}
"""A mapping of frames alone: known weights that were laid on by hand."""


def bring(folder: Path, file: Path, content: dict[str, Any]) -> Dataset:
    return imported(folder, content, [file])[0]


def refused(folder: Path, file: Path, content: dict[str, Any]) -> str:
    (said,) = refusals(folder, content, [file])
    assert len(said.splitlines()) == 1
    return said


def moved(content: dict[str, Any], before: str, taxels: str) -> dict[str, Any]:
    """The mapping of a file whose columns lie in a structure, with other names of the taxels."""
    content["taxels"]["columns"] = taxels
    for entry in content["columns"].values():
        if "column" in entry:
            entry["column"] = before + entry["column"]
    return content


def assert_weights(back: Dataset) -> None:
    """Contacts are told by the taxels; the weight lies on the skin in them, and nowhere else."""
    assert back.frames is not None
    assert len(back.presses) == len(FOUND.force_n)
    np.testing.assert_allclose(back.presses.columns["t_start_s"], FOUND.start_s, atol=0.15)
    assert (back.presses.force_n == 2.0).all()
    assert (back.frames.force_n[back.frames.press < 0] == 0.0).all()
    np.testing.assert_array_equal(back.frames.counts, IMAGES)


def frames_text(*, label: str = "Frame {n}", name: str = "", gap: bool = True, mark: str = ",") -> str:
    lines = ["DATA_TYPE MOVIE", "ROWS 3", "COLS 3", "ASCII_DATA @@", ""]
    for n, image in enumerate(IMAGES):
        lines += [label.format(n=n + 1, t=0.02 * n)] if label else []
        for r, row in enumerate(image.reshape(3, 3)):
            before = [name.format(R="ABC"[r])] if name else []
            lines.append(mark.join([*before, *map(str, row)]))
        lines += [""] if gap else []
    return "\n".join(lines)


def test_flat_frames_with_a_rate(tmp_path: Path):
    file = tmp_path / "flat.csv"
    file.write_text("shape,3,3\n" + pd.DataFrame(IMAGES).to_csv(index=False, header=False))
    content = mapping(PLANE, WEIGHTS, csv={"rate_hz": 50.0})
    assert "Line 1 gives the shape of flat frames" in refused(tmp_path, file, content)
    content["csv"]["skip_rows"] = 1
    assert_weights(bring(tmp_path, file, content))


def test_blocks_are_named_and_read(tmp_path: Path):
    file = tmp_path / "movie.asf"
    file.write_text(frames_text())
    content = mapping(PLANE, WEIGHTS, csv={"rate_hz": 50.0, "skip_rows": 4})
    found = refused(tmp_path, file, content)
    assert "blocks of 3 rows of 3 cells" in found and 'layout = "blocks"' in found
    content["csv"]["layout"] = "blocks"
    assert_weights(bring(tmp_path, file, content))


@pytest.mark.parametrize(
    "text",
    [
        {"mark": " ", "label": "# {n}"},
        {"mark": " ", "name": "p{R}", "label": ""},
        {"mark": ",", "name": "{R}", "label": "", "gap": False},
        {"mark": ", ", "name": "{R}:", "gap": False},
        {"mark": "\t"},
    ],
)
def test_blocks_of_many_kinds(tmp_path: Path, text: dict[str, Any]):
    file = tmp_path / "log.txt"
    file.write_text(frames_text(**text))
    content = mapping(PLANE, WEIGHTS, csv={"rate_hz": 50.0, "layout": "blocks", "skip_rows": 5})
    assert_weights(bring(tmp_path, file, content))


def test_blocks_with_the_time_above_them(tmp_path: Path):
    file = tmp_path / "movie.txt"
    file.write_text(frames_text(label="Frame {n}, t = {t:.2f}"))
    content = mapping(
        PLANE, WEIGHTS, csv={"layout": "blocks"}, columns={"time_s": {"column": "t", "unit": "s"}}
    )
    assert_weights(bring(tmp_path, file, content))


def test_blocks_below_a_time_of_day(tmp_path: Path):
    stamps = pd.to_datetime(TIME, unit="s").strftime("%H:%M:%S.%f")
    lines = [
        f"Frame {n} {s}\n{_rows(image)}\n" for n, (s, image) in enumerate(zip(stamps, IMAGES, strict=True))
    ]
    (tmp_path / "a.txt").write_text("\n".join(lines))
    time = {"column": "moment", "unit": "datetime"}
    content = mapping(PLANE, WEIGHTS, csv={"layout": "blocks"}, columns={"time_s": time})
    assert_weights(bring(tmp_path, tmp_path / "a.txt", content))


@pytest.mark.parametrize("column", ["label[0]", "t"])
def test_blocks_below_a_bare_number(tmp_path: Path, column: str):
    before = "t," if column == "t" else ""
    lines = [f"{before}{t:.2f}\n{_rows(image)}\n" for t, image in zip(TIME, IMAGES, strict=True)]
    (tmp_path / "a.txt").write_text("\n".join(lines))
    content = mapping(
        PLANE, WEIGHTS, csv={"layout": "blocks"}, columns={"time_s": {"column": column, "unit": "s"}}
    )
    assert_weights(bring(tmp_path, tmp_path / "a.txt", content))


def test_blocks_of_printed_arrays_and_blank_cells(tmp_path: Path):
    (tmp_path / "a.txt").write_text("\n".join(str(image.reshape(3, 3)) for image in IMAGES))
    content = mapping(PLANE, WEIGHTS, csv={"layout": "blocks", "rate_hz": 50.0})
    assert_weights(bring(tmp_path, tmp_path / "a.txt", content))
    rows = [_rows(image).split("\n") for image in IMAGES]
    text = "\n".join(f"Frame {n}\nB{first[first.index(','):]}\n{second}\n{third}\n"
                     for n, (first, second, third) in enumerate(rows))  # fmt: skip
    (tmp_path / "b.txt").write_text(text)
    (tmp_path / "b").mkdir()
    content["csv"]["missing"] = ["B"]
    back = bring(tmp_path / "b", tmp_path / "b.txt", content)
    assert np.isnan(back.frames.counts[:, 0]).all()
    np.testing.assert_array_equal(back.frames.counts[:, 1:], IMAGES[:, 1:])


def _rows(image: np.ndarray) -> str:
    return "\n".join(",".join(map(str, row)) for row in image.reshape(3, 3))


FLAT = pd.DataFrame(IMAGES).to_csv(index=False, header=False)
ALL = whole_table(FOUND, TIME)
LINES = ALL.head(50).to_csv(index=False).splitlines()
LONG = "t,zeile,spalte,wert\n" + "".join(
    f"{t},{j // 4},{j % 4},{t * j % 7}\n" for t in range(40) for j in range(12)
)


@pytest.mark.parametrize(
    ("text", "counted", "advice"),
    [
        (FLAT.replace(",", " "), True, 'set delimiter = "whitespace"'),
        (FLAT, True, "Line 1 holds 9 numbers: set header = false"),
        ("3x3\n" + FLAT, True, "set skip_rows = 1 and header = false"),
        ("\n".join(map(_rows, IMAGES)), True, 'set layout = "blocks" and block_rows = 3'),
        (
            "\n".join(["Device X", "Rate 50", *LINES]),
            False,
            "Its columns are named in line 3: set skip_rows = 2",
        ),
        ("\n".join(LINES).replace(",", ";"), False, 'Its columns are named in line 1: set delimiter = ";"'),
        ("\n".join([LINES[0], "s,N,mm,mm" + ",-" * 9, *LINES[1:]]), False, "set skip_after_header = 1"),
        ('t,F,px,py,skin\n0,1,2,3,"[1, 2]"\n', False, 'its elements are the columns "skin[0]"'),
        ("t,row,col,value\n0,0,0,5\n", False, 'one row per taxel ("row", "col")'),
        (LONG, False, 'one row per taxel ("zeile", "spalte")'),
        ("\n".join(LINES[1:]).replace(",", "\t"), False, 'set header = false and delimiter = "\\t"'),
        ("x;y;z;", False, "expected "),
    ],
)
def test_other_layouts_are_named(tmp_path: Path, text: str, counted: bool, advice: str):
    (tmp_path / "a.csv").write_text(text)
    by_number = mapping(PLANE, WEIGHTS, csv={"rate_hz": 50.0, "header": advice.startswith("Line")})
    content = by_number if counted else mapping(PLANE, ONE_FILE)
    assert advice in refused(tmp_path, tmp_path / "a.csv", content)


def test_text_in_utf_16(tmp_path: Path):
    (tmp_path / "a.csv").write_text(ALL.to_csv(index=False), encoding="utf-16")
    assert len(bring(tmp_path, tmp_path / "a.csv", mapping(PLANE, ONE_FILE)).presses) == len(FOUND.force_n)


def test_a_header_that_comes_again(tmp_path: Path):
    """A logger that was restarted goes on in the same file."""
    lines = ALL.to_csv(index=False).splitlines()
    (tmp_path / "a.csv").write_text("\n".join([*lines[:300], lines[0], *lines[300:]]))
    assert len(bring(tmp_path, tmp_path / "a.csv", mapping(PLANE, ONE_FILE)).presses) == len(FOUND.force_n)


def test_rate_in_the_header_of_a_movie(tmp_path: Path):
    (tmp_path / "a.asf").write_text("SECONDS_PER_FRAME 0.02\n" + frames_text())
    content = mapping(PLANE, WEIGHTS, csv={"rate_hz": 10.0})
    assert "rate_hz = 50 (its header says SECONDS_PER_FRAME 0.02)" in refused(
        tmp_path, tmp_path / "a.asf", content
    )


def test_rows_that_end_in_a_delimiter_and_a_header_in_a_comment(tmp_path: Path):
    lines = ALL.to_csv(index=False).splitlines()
    (tmp_path / "a.csv").write_text("\n".join([f"# {lines[0]}", *(f"{line}," for line in lines[1:])]))
    back = bring(tmp_path, tmp_path / "a.csv", mapping(PLANE, ONE_FILE))
    np.testing.assert_array_equal(back.frames.counts, IMAGES)


@pytest.mark.parametrize("kind", ["lines", "nested", "array", "table", "cells"])
def test_json_and_lists_in_cells(tmp_path: Path, kind: str):
    name, shape = ("skin[{r},{c}]", (3, 3)) if kind == "nested" else ("skin[{j}]", (9,))
    samples = [
        {"t": t, "ft": {"F": f}, "px": x, "py": y, "skin": image.reshape(shape).tolist()}
        for t, f, x, y, image in zip(TIME, GAUGE.F, GAUGE.px, GAUGE.py, IMAGES, strict=True)
    ]
    force = "F" if kind == "cells" else "ft.F"
    if kind in ("lines", "nested"):
        text = "\n".join(map(json.dumps, samples))
    elif kind == "array":
        text = json.dumps(samples, indent=1)
    elif kind == "table":
        whole = {name: [sample[name] for sample in samples] for name in ("t", "px", "py", "skin")}
        text = json.dumps(whole | {"ft": {"F": GAUGE.F.tolist()}})
    else:
        text = ALL[["t", "F", "px", "py"]].assign(skin=[str(image.tolist()) for image in IMAGES]).to_csv()
    (tmp_path / "a.json").write_text(text)
    content = mapping(PLANE, ONE_FILE, taxels={"columns": name}, columns={"force_n": {"column": force}})
    back = bring(tmp_path, tmp_path / "a.json", content)
    np.testing.assert_array_equal(back.frames.counts, IMAGES)


TAXELS = [f"s{j}" for j in range(9)]


def assert_images(back: Dataset) -> None:
    assert back.frames is not None
    np.testing.assert_array_equal(back.frames.counts, IMAGES)


def test_quoted_decimal_commas(tmp_path: Path):
    """With commas between the cells, too, as a spreadsheet writes them; U+2212 is a minus."""
    table = whole_table(FOUND, TIME)
    stamps = (pd.Timestamp("2026-11-20 12:00") + pd.to_timedelta(table.t, unit="s")).dt.strftime("%FT%T.%f")
    table = table.round(4).assign(t=stamps).astype(str)
    for name in table:
        table[name] = (
            table[name].str.replace(".", ",").str.replace("-", "\N{MINUS SIGN}" if name != "t" else "-")
        )
    table.to_csv(tmp_path / "a.csv", index=False)
    content = mapping(PLANE, ONE_FILE, columns={"time_s": {"column": "t", "unit": "datetime"}})
    said = "\n".join(refusals(tmp_path, content, [tmp_path / "a.csv"]))
    assert 'Set decimal = "," and quoted = true in [csv]' in said
    content["csv"] |= {"decimal": ","}
    assert "quoted = true" in refused(tmp_path, tmp_path / "a.csv", content)
    content["csv"] |= {"quoted": True}
    assert_images(bring(tmp_path, tmp_path / "a.csv", content))


def test_hexadecimal_counts(tmp_path: Path):
    table = whole_table(FOUND, TIME)
    for name in TAXELS:
        table[name] = [f"0x{int(count):04X}" for count in table[name]]
    table.to_csv(tmp_path / "a.csv", index=False)
    assert_images(bring(tmp_path, tmp_path / "a.csv", mapping(PLANE, ONE_FILE)))


def test_a_transposed_table_is_named(tmp_path: Path):
    whole_table(FOUND, TIME).T.to_csv(tmp_path / "a.csv", header=False)
    said = refused(tmp_path, tmp_path / "a.csv", mapping(PLANE, ONE_FILE))
    assert "each line begins with a name" in said and "index_col=0).T" in said


def test_json_with_a_table_per_taxel(tmp_path: Path):
    table = whole_table(FOUND, TIME)
    samples = [
        {**row, "skin": [{"x": 0, "z": count} for count in counts]}
        for row, counts in zip(
            table.drop(columns=TAXELS).to_dict("records"), table[TAXELS].to_numpy().tolist(), strict=True
        )
    ]
    (tmp_path / "a.json").write_text("\n".join(map(json.dumps, samples)))
    content = mapping(PLANE, ONE_FILE, taxels={"columns": "skin[{j}].z"})
    assert_images(bring(tmp_path, tmp_path / "a.json", content))


def test_block_that_is_cut_short(tmp_path: Path):
    file = tmp_path / "movie.asf"
    file.write_text("\n".join(frames_text().splitlines()[:-2]))
    content = mapping(PLANE, WEIGHTS, csv={"rate_hz": 50.0, "layout": "blocks"})
    assert "expected a block of 3 rows of 3 cells as most; got 1 of 3" in refused(tmp_path, file, content)


def test_rows_named_by_letters(tmp_path: Path):
    names = [f"p{'ABC'[r]}{c + 1}" for r in range(3) for c in range(3)]
    file = tmp_path / "a.csv"
    pd.DataFrame(IMAGES, columns=names).to_csv(file, index=False)
    content = mapping(PLANE, WEIGHTS, csv={"rate_hz": 50.0, "header": True}, taxels={"columns": "p{R}{c}"})
    assert_weights(bring(tmp_path, file, content))


def test_lines_of_names_and_values(tmp_path: Path):
    """Lines as a serial monitor saves them."""
    file = tmp_path / "serial.log"
    names = [f"p{'ABC'[r]}{c + 1}" for r in range(3) for c in range(3)]
    stamps = pd.to_datetime(TIME, unit="s").strftime("%H:%M:%S.%f").str[:-3]
    lines = [
        f"{stamp} -> {' '.join(f'{n}:{v}' for n, v in zip(names, image, strict=True))}"
        for stamp, image in zip(stamps, IMAGES, strict=True)
    ]
    file.write_text("\n".join(["connected", *lines]))
    content = mapping(PLANE, WEIGHTS, columns={"time_s": {"column": "time", "unit": "datetime"}},
                      taxels={"columns": "p{R}{c}"})  # fmt: skip
    assert 'layout = "labelled"' in refused(tmp_path, file, content)
    content["csv"]["layout"] = "labelled"
    assert_weights(bring(tmp_path, file, content))


def test_seconds_in_brackets_before_a_line(tmp_path: Path):
    lines = [
        f"[{t:9.3f}] {' '.join(f's{j}={v}' for j, v in enumerate(image, 1))}"
        for t, image in zip(TIME, IMAGES, strict=True)
    ]
    (tmp_path / "serial.log").write_text("\n".join(lines))
    content = mapping(PLANE, WEIGHTS, csv={"layout": "labelled"}, taxels={"columns": "s{j}"},
                      columns={"time_s": {"column": "time", "unit": "s"}})  # fmt: skip
    assert_weights(bring(tmp_path, tmp_path / "serial.log", content))


def arrays() -> dict[str, np.ndarray]:
    return {"t": TIME, "F": GAUGE.F.to_numpy(), "place": GAUGE[["px", "py"]].to_numpy(), "skin": IMAGES}


ARRAYS = {
    **ONE_FILE,
    "columns": ONE_FILE["columns"]
    | {"x_m": {"column": "place[0]", "unit": "mm"}, "y_m": {"column": "place[1]", "unit": "mm"}},
    "taxels": {"columns": "skin[{j}]"},
}


@pytest.mark.parametrize(
    "kind", ["npz", "mat", "mat struct", "mat rows", "mat cells", "mat frames", "mat v4", "h5", "parquet", "feather",
             "cubes", "parquet lists"],
)  # fmt: skip
def test_arrays(tmp_path: Path, kind: str):
    content = mapping(PLANE, ARRAYS)
    file = tmp_path / f"data.{'npz' if kind == 'cubes' else kind.split()[0]}"
    held = arrays()
    if kind == "npz":
        np.savez(file, **held)
    elif kind == "cubes":
        np.savez(file, **held | {"skin": IMAGES.reshape(-1, 3, 3)})
        content["taxels"]["columns"] = "skin[{r},{c}]"
    elif kind.startswith("mat"):
        from scipy.io import savemat

        if kind == "mat rows":
            held["skin"] = IMAGES.T
        if kind == "mat cells":
            cells = np.empty(len(IMAGES), dtype=object)
            cells[:] = list(IMAGES)
            held["skin"] = cells
        if kind == "mat frames":  # an array of structures
            columns = zip(*held.values(), strict=True)
            held = [dict(zip(held, sample, strict=True)) for sample in columns]
        named = kind in ("mat struct", "mat frames")
        savemat(file, {"run": held} if named else held, format="4" if kind == "mat v4" else "5")
        if named:
            moved(content, "run.", "run.skin[{j}]")
    elif kind == "parquet lists":  # a list of rows in a cell
        rows = [image.tolist() for image in IMAGES.reshape(-1, 3, 3)]
        pd.DataFrame({name: list(array) for name, array in held.items()} | {"skin": rows}).to_parquet(file)
        content["taxels"]["columns"] = "skin[{r},{c}]"
    elif kind == "h5":
        h5py = pytest.importorskip("h5py")
        with h5py.File(file, "w") as out:
            for name, array in held.items():
                out[f"run/{name}"] = array
        moved(content, "run/", "run/skin[{j}]")
    else:
        ALL.set_index("t").to_parquet(file) if kind == "parquet" else ALL.to_feather(file)
        content = mapping(PLANE, ONE_FILE)
    back = bring(tmp_path, file, content)
    np.testing.assert_allclose(back.presses.force_n, FOUND.force_n, rtol=0.01)
    np.testing.assert_array_equal(back.frames.counts, IMAGES)


def test_matlab_7_3_with_cells_and_structures(tmp_path: Path):
    """Names have slashes in such files, and dots in older ones."""
    h5py = pytest.importorskip("h5py")
    with h5py.File(tmp_path / "a.mat", "w", userblock_size=512) as out:
        for name, array in arrays().items():
            out[f"run/{name}"] = array[None] if array.ndim == 1 else array.T
            out[f"run/{name}"].attrs["MATLAB_class"] = np.bytes_("double")
        del out["run/skin"]
        for n, image in enumerate(IMAGES):
            out[f"#refs#/{n}"] = image[:, None]
            out[f"#refs#/{n}"].attrs["MATLAB_class"] = np.bytes_("double")
        cells = out.create_dataset("run/skin", (1, len(IMAGES)), dtype=h5py.ref_dtype)
        cells[0] = [out[f"#refs#/{n}"].ref for n in range(len(IMAGES))]
    with (tmp_path / "a.mat").open("r+b") as file:
        file.write(b"MATLAB 7.3 MAT-file")
    content = moved(mapping(PLANE, ARRAYS), "run.", "run.skin[0,{j}]")
    np.testing.assert_array_equal(bring(tmp_path, tmp_path / "a.mat", content).frames.counts, IMAGES)


def test_one_file_with_two_clocks(tmp_path: Path):
    slow = slice(None, None, 5)
    np.savez(tmp_path / "a.npz", t=TIME, skin=IMAGES, tf=TIME[slow], F=GAUGE.F[slow],
             place=GAUGE[["px", "py"]].to_numpy()[slow])  # fmt: skip
    content = mapping(PLANE, ARRAYS)
    assert "add the file to [files] as well" in refused(tmp_path, tmp_path / "a.npz", content)
    content["files"] = {"gauge": {"file": "a.npz", "time": {"column": "tf", "unit": "s"}}}
    for name in ("force_n", "x_m", "y_m"):
        content["columns"][name]["file"] = "gauge"
    back = bring(tmp_path, tmp_path / "a.npz", content)
    np.testing.assert_allclose(back.presses.force_n, FOUND.force_n, rtol=0.01)


def test_arrays_that_are_not_there(tmp_path: Path):
    np.savez(tmp_path / "a.npz", **arrays())
    content = mapping(PLANE, ARRAYS, taxels={"columns": "skim[{j}]"})
    assert 'expected a column "skim[0]" and 8 more; got the columns "t", "F"' in refused(
        tmp_path, tmp_path / "a.npz", content
    )
    np.savez(tmp_path / "b.npz", **arrays() | {"F": GAUGE.F[::3]})
    assert "expected columns of one length" in refused(tmp_path, tmp_path / "b.npz", mapping(PLANE, ARRAYS))


@pytest.mark.parametrize(
    ("name", "got"),
    [
        ("a.npz", "Python objects, which are not"),
        ("a.mat", "lists of 9 numbers, and of 8 in row 3"),
        ("a.json", "lists of 9 numbers, and of 8 in row 3"),
    ],
)
def test_arrays_that_are_no_numbers(tmp_path: Path, name: str, got: str):
    from scipy.io import savemat

    cells = np.empty(len(IMAGES), dtype=object)
    cells[:] = list(IMAGES)
    cells[2] = cells[2][:8]
    held = arrays() | {"skin": cells}
    if name == "a.json":
        lists = {key: [np.asarray(row).tolist() for row in column] for key, column in held.items()}
        (tmp_path / name).write_text(json.dumps(lists))
    else:
        np.savez(tmp_path / name, **held) if name == "a.npz" else savemat(tmp_path / name, held)
    text = refused(tmp_path, tmp_path / name, mapping(PLANE, ARRAYS))
    assert f'{name}, "skin": expected an array of numbers; got {got}' in text
    assert "numpy.array(list(skin), dtype=float)" in text and "cut short" not in text


def test_objects_that_nothing_needs_are_left_alone(tmp_path: Path):
    np.savez(tmp_path / "a.npz", about=np.array({"rate": 50}, dtype=object), **arrays())
    back = bring(tmp_path, tmp_path / "a.npz", mapping(PLANE, ARRAYS))
    np.testing.assert_array_equal(back.frames.counts, IMAGES)


def test_lists_of_unlike_lengths_that_nothing_needs_are_left_alone(tmp_path: Path):
    lists = {name: np.asarray(column).tolist() for name, column in arrays().items()}
    lists["words"] = [[0.0] * (1 + i % 2) for i in range(len(IMAGES))]
    (tmp_path / "a.json").write_text(json.dumps(lists))
    back = bring(tmp_path, tmp_path / "a.json", mapping(PLANE, ARRAYS))
    np.testing.assert_array_equal(back.frames.counts, IMAGES)


@pytest.mark.parametrize("way", ["raw data", "virtual"])
def test_hdf5_that_lies_in_another_file_is_refused(tmp_path: Path, way: str):
    h5py = pytest.importorskip("h5py")
    (tmp_path / "secret").write_bytes(b"12345678" * 4)
    with h5py.File(tmp_path / "a.h5", "w") as out:
        if way == "raw data":
            out.create_dataset("t", (4,), "f8", external=[(str(tmp_path / "secret"), 0, 32)])
        else:
            with h5py.File(tmp_path / "b.h5", "w") as other:
                other["t"] = np.arange(4.0)
            layout = h5py.VirtualLayout((4,), "f8")
            layout[:] = h5py.VirtualSource(str(tmp_path / "b.h5"), "t", (4,))
            out.create_virtual_dataset("t", layout)
    with pytest.raises(ValueError, match="another file"):
        read_hdf5(tmp_path / "a.h5")


def test_hdf5_without_its_library(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    (tmp_path / "a.h5").write_bytes(b"\x89HDF\r\n\x1a\n" + bytes(100))
    monkeypatch.setitem(__import__("sys").modules, "h5py", None)
    with pytest.raises(WorkError, match=r"pip install skincal\[hdf5\]"):
        read_hdf5(tmp_path / "a.h5")


OBJECTS = io.BytesIO()
np.save(OBJECTS, np.array([{}, None], dtype=object), allow_pickle=True)


@pytest.mark.parametrize(
    ("name", "content", "text"),
    [
        ("a.mcap", b"\x89MCAP0\r\n" + bytes(50), "an MCAP recording. Use `skincal import rosbag`"),
        ("a.bag", b"#ROSBAG V2.0\n", "a ROS 1 bag"),
        ("a.db3", b"SQLite format 3\0" + bytes(50), "Is it a ROS 2 bag?"),
        ("a.xlsx", b"PK\x03\x04" + bytes(50), "a spreadsheet. Save the sheet as CSV."),
        ("a.csv.gz", gzip.compress(b"a,b", mtime=0), "compressed by gzip"),
        ("a.pkl", pickle.dumps([1]), "a Python pickle"),
        ("a.fsx", b"\1\2\0\0\0\3", 'a binary file of an unknown kind (".fsx")'),
        ("a.mat", b"MATLAB 5.0 MAT-file" + bytes(30), "Was it cut short?"),
        ("a.npz", b"PK\x03\x04" + bytes(50), "Was it cut short?"),
        ("a.npy", OBJECTS.getvalue(), "Python objects, which are not opened as they may run code"),
    ],
)
def test_other_files_are_refused_by_their_kind(tmp_path: Path, name: str, content: bytes, text: str):
    (tmp_path / name).write_bytes(content)
    assert text in refused(tmp_path, tmp_path / name, mapping(PLANE, ONE_FILE))


def test_mcap_of_other_messages(tmp_path: Path):
    """Its index names the encoding of its channels."""
    name = b"protobuf"
    (tmp_path / "a.mcap").write_bytes(b"\x89MCAP0\r\n" + bytes(64) + len(name).to_bytes(4, "little") + name)
    content = mapping(BAG, {"topics": None, "joints": None})
    said = refusals(tmp_path, content, [tmp_path / "a.mcap"], import_rosbag)
    assert any("an MCAP file of protobuf messages" in text for text in said)


def bring_vectors(folder: Path, rest: Callable[[int, int], Any]) -> tuple[Dataset, np.ndarray]:
    """A magnetometer, whose channels differ in sign, and the loads; ``rest`` is what a taxel's axis reads at rest."""
    load = FOUND.images(TIME) - 20.0
    table = pd.DataFrame({"t": TIME, **GAUGE})
    for j in range(9):
        for k, (axis, share) in enumerate((("X", 0.6), ("Y", -0.8), ("Z", 0.0))):
            table[f"S-{axis}[{j}]"] = rest(j, k) + share * load[:, j]
    table.to_csv(folder / "a.csv", index=False)
    content = mapping(PLANE, ONE_FILE, taxels={"columns": None, "vectors": "S-{axis}[{j}]", "axes": ["X", "Y", "Z"],
                                               "rest_rows": 20}, sensor={"integer": None, "unit": "uT"})  # fmt: skip
    return bring(folder, folder / "a.csv", content), load


def test_vectors_of_three_axes(tmp_path: Path):
    """They rest anywhere; a taxel's value is the length of the change."""
    back, load = bring_vectors(tmp_path, lambda j, k: (900.0, -300.0, 9000.0)[k] + 10 * j)
    np.testing.assert_allclose(np.abs(back.frames.counts), np.abs(load), atol=2.0)
    assert back.meta.sensor.unit == "uT"


def test_noise_of_three_axes_at_rest_has_no_length(tmp_path: Path):
    rng = np.random.default_rng(0)
    back, load = bring_vectors(tmp_path, lambda j, k: rng.normal(0.0, 2.0, len(TIME)))
    error = back.frames.counts - load
    # A length has 3.2 there; what is left is how well 20 rows tell the level.
    assert abs(error[load < 2.0].mean()) < 1.0 and abs(error[load > 20.0].mean()) < 1.0


@pytest.mark.parametrize("line", ["x" * 200_000, "x" + "1" * 200_000 + "y", "a" + " " * 200_000 + "b"])
def test_a_long_line_takes_no_time(line: str):
    """Backtracking that grows with the square of a line's length would take minutes."""
    begun = time.process_time()
    assert not PAIR.findall(line)
    assert not NAMED.findall(line + "?")
    assert time.process_time() - begun < 5


def test_a_line_of_megabytes_is_not_searched(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    (tmp_path / "log.csv").write_text("a=1;b=2\n" * 3 + "1;" * (2 << 20) + "\n" + "a=1;b=2\n" * 3)
    seen: list[int] = []
    monkeypatch.setattr(layout_hints, "_labelled", lambda filled: seen.append(len(filled)) or "")
    layout_hints.layout_hint(tmp_path / "log.csv", CsvFormat(), ["x"])
    assert seen == [3]
