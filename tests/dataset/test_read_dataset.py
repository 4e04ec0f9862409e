"""Every form that the contract allows is read as it is meant."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from datetime import UTC, date, datetime
from pathlib import Path

import numpy as np
import pandas as pd
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
import trimesh

from skincal.dataset import (
    HOLD,
    IDLE,
    LOAD,
    UNLOAD,
    Dataset,
    IndenterSpec,
    MountSpec,
    PositionSpec,
    Presses,
    SurfaceSpec,
    TaxelPositions,
    check_dataset,
    read_dataset,
    write_dataset,
)
from skincal.model import Converter, Cylinder, FlatPunch, MeshIndenter, MeshSurface, Plane, Sphere
from tests.dataset.changes import with_presses, with_sensor

Session = Callable[..., Dataset]

MINIMAL = """format = "skincal-dataset/1"
created = 2026-11-20T12:00:00Z
source = "by hand"

[sensor]
rows = 1
cols = 2
taxel_size_m = 0.0025
pitch_m = 0.004

[surface]
kind = "plane"

[indenter]
kind = "flat"
radius_m = 0.05

[mount]
x_m = 0.0
y_m = 0.01
alpha_deg = 90
x_range_m = [-0.001, 0.001]
y_range_m = [0.01, 0.01]
alpha_range_deg = [0, 90]

[position]
sigma_m = inf
slack_m = 0
"""


def by_hand(folder: Path, presses: str, frames: str | None = None, description: str = MINIMAL) -> Path:
    (folder / "dataset.toml").write_text(description)
    (folder / "presses.csv").write_text(presses)
    if frames is not None:
        (folder / "frames.csv").write_text(frames)
    return folder


def test_the_least_that_a_dataset_is(tmp_path: Path) -> None:
    by_hand(tmp_path, "press,x_m,y_m,z_m,force_n,taxel_0_0,taxel_0_1\n3,,,,100,-3.5,1000\n4,,,,100,9,1400\n")
    dataset = read_dataset(tmp_path)
    assert [warning.got for warning in dataset.warnings] == ["at most one in any press"]
    sensor = dataset.meta.sensor
    assert (sensor.value_min, sensor.value_max, sensor.integer, sensor.baseline) == (None, None, False, "raw")
    assert dataset.meta.assumed == ()
    assert dataset.meta.clock is None
    assert dataset.meta.created == datetime(2026, 11, 20, 12, tzinfo=UTC)
    assert dataset.presses.press.tolist() == [3, 4]
    assert dataset.presses.counts.tolist() == [[-3.5, 1000.0], [9.0, 1400.0]]
    assert np.isnan(dataset.presses.position_m).all()
    assert dataset.frames is None
    assert isinstance(dataset.surface(), Plane)
    assert isinstance(dataset.indenter(), FlatPunch)
    assert dataset.nominal_pose().alpha_rad == pytest.approx(np.pi / 2)
    assert dataset.converter() == Converter.none()


def test_columns_in_any_order_and_a_byte_order_mark(tmp_path: Path) -> None:
    by_hand(tmp_path, "\ufefftaxel_0_1,force_n,taxel_0_0,press,z_m,y_m,x_m\r\n7,100,2,0,0,0.01,0.001\r\n")
    presses = read_dataset(tmp_path).presses
    assert presses.counts.tolist() == [[2.0, 7.0]]
    assert presses.position_m.tolist() == [[0.001, 0.01, 0.0]]


def test_nothing_known_of_the_position(tmp_path: Path) -> None:
    """A pressure chamber: sigma is inf, and positions may be missing, in frames with contact too."""
    frames = (
        "press,phase,time_s,force_n,x_m,y_m,z_m,taxel_0_0,taxel_0_1\n"
        "-1,idle,0,0,,,,0,0\n0,hold,1,100,,,,2,7\n0,unload,2,50,NaN,nan,,1,3\n0,load,2.5,50,,,,1,3\n"
    )
    by_hand(tmp_path, "press,x_m,y_m,z_m,force_n,taxel_0_0,taxel_0_1\n0,,,,100,2,7\n", frames)
    dataset = read_dataset(tmp_path)
    assert dataset.frames is not None
    assert dataset.frames.phase.tolist() == [IDLE, HOLD, UNLOAD, LOAD]
    assert dataset.frames.press.tolist() == [-1, 0, 0, 0]


def test_a_pose_has_the_same_name_whatever_wrote_it(folder: Path) -> None:
    """A column of whole numbers with a gap is one of 1.0 in a CSV, and of floats in a Parquet file."""
    table = pd.read_csv(folder / "presses.csv")
    table["pose"] = [1.0, None, *[0.0] * (len(table) - 2)]
    table.to_csv(folder / "presses.csv", index=False)
    assert read_dataset(folder).presses.columns["pose"][:3].tolist() == ["1", "", "0"]


def test_optional_columns_are_kept_and_may_have_gaps(folder: Path) -> None:
    table = pd.read_csv(folder / "presses.csv")
    table["branch"] = ["up", "down", None, *["up"] * (len(table) - 3)]
    table["pose"] = 7
    table["cycle"] = [0, None, *range(len(table) - 2)]
    table["indenter_radius_m"] = [0.004, None, *[0.006] * (len(table) - 2)]
    table["q_0"], table["tau_11"], table["temperature_c"] = 0.5, -0.1, 24.5
    table["my_note"], table["my_number"] = "a, b", 1.5
    table["nx"], table["ny"], table["nz"] = 0.0, 0.0, 1.0
    table.loc[1, ["nx", "ny", "nz"]] = np.nan
    table.to_csv(folder / "presses.csv", index=False)
    dataset = read_dataset(folder)
    columns = dataset.presses.columns
    assert columns["branch"][:3].tolist() == ["up", "down", ""]
    assert columns["pose"][0] == "7"
    assert np.isnan(columns["cycle"][1])
    assert columns["my_note"][0] == "a, b"
    assert columns["my_number"][0] == 1.5
    assert columns["tau_11"][0] == -0.1
    assert dataset.presses.column("speed_m_per_s") is None
    assert dataset.indenter_radii_m()[:3].tolist() == [0.004, 0.006, 0.006]
    assert dataset.presses.normals is not None
    assert np.isnan(dataset.presses.normals[1]).all()
    assert "nx" not in columns


@pytest.mark.parametrize(
    ("kind", "value"),
    [
        (pa.list_(pa.float64()), [1.0, 2.0]), (pa.struct([("a", pa.int8())]), {"a": 1}), (pa.binary(), b"\xff"),
        (pa.map_(pa.string(), pa.int8()), [("a", 1)]),
    ],
)  # fmt: skip
@pytest.mark.parametrize("table", ["presses", "frames"])
def test_unknown_columns_of_other_types_are_ignored(
    session: Session, tmp_path: Path, table: str, kind: pa.DataType, value: object
) -> None:
    write_dataset(session(), tmp_path / "d", frames_as="parquet", presses_as="parquet")
    file = tmp_path / "d" / f"{table}.parquet"
    content = pq.read_table(file)
    pq.write_table(content.append_column("images", pa.array([value] * content.num_rows, kind)), file)
    found = check_dataset(tmp_path / "d")
    assert not found.errors and found.dataset is not None
    notes = [str(note) for note in found.warnings if f"{table}.parquet" in note.place]
    assert len(notes) == 1 and "column images: expected single numbers or texts" in notes[0]
    assert "images" not in getattr(found.dataset, table).columns


def test_a_radius_of_a_press_goes_before_the_indenters(session: Session) -> None:
    dataset = session()
    assert dataset.indenter() == Sphere(0.006)
    assert dataset.indenter(0.004) == Sphere(0.004)
    assert dataset.indenter(np.nan) == Sphere(0.006)
    assert isinstance(dataset.surface(), Cylinder)


@pytest.mark.parametrize(
    ("text", "value"),
    [
        ("2026-11-20 12:00:00+00:00", datetime(2026, 11, 20, 12, tzinfo=UTC)),
        ('"2026-11-20 12:00:00+00:00"', datetime(2026, 11, 20, 12, tzinfo=UTC)),
        ('"2026-11-20T12:00:00Z"', datetime(2026, 11, 20, 12, tzinfo=UTC)),
        ("2026-11-20", date(2026, 11, 20)),
        ("2026-11-20T12:00:00", datetime(2026, 11, 20, 12)),
    ],
)
def test_forms_of_the_date(folder: Path, text: str, value: date) -> None:
    path = folder / "dataset.toml"
    path.write_text(f"created = {text}\n" + path.read_text())
    assert read_dataset(folder).meta.created == value


def test_unknown_keys_are_kept_with_a_warning(folder: Path, tmp_path: Path) -> None:
    path = folder / "dataset.toml"
    path.write_text("operator = 'me'\n" + path.read_text() + "[humidity]\npercent = 40\n")
    dataset = read_dataset(folder)
    assert dataset.meta.extra == {"operator": "me", "humidity": {"percent": 40}}
    assert sum("unknown key" in str(w) for w in dataset.warnings) == 2
    write_dataset(dataset, tmp_path / "copy")
    assert read_dataset(tmp_path / "copy").meta == dataset.meta


def test_sizes_and_pitches_by_direction(session: Session, tmp_path: Path) -> None:
    sizes = {"taxel_size_m": (0.002, 0.003), "pitch_m": (0.004, 0.005)}
    write_dataset(with_sensor(session(), **sizes), tmp_path / "d")
    assert "[\n    0.002,\n    0.003,\n]" in (tmp_path / "d" / "dataset.toml").read_text()
    layout = read_dataset(tmp_path / "d").layout()
    np.testing.assert_allclose(layout.centres_m[5] - layout.centres_m[0], [0.004, 0.005])
    np.testing.assert_array_equal(layout.sizes_m[0], [0.002, 0.003])


SHIFT = np.array([0.001, 0.0])


def listed(dataset: Dataset) -> Dataset:
    """The same taxels as a table of positions, shifted by 1 mm along u."""
    layout = dataset.layout()
    positions = TaxelPositions(layout.centres_m + SHIFT, layout.sizes_m)
    named = with_sensor(dataset, positions="taxels.csv", taxel_size_m=None, pitch_m=None)
    return replace(named, positions=positions)


def test_a_layout_that_is_no_grid(session: Session, tmp_path: Path) -> None:
    write_dataset(listed(session()), tmp_path / "d")
    path = tmp_path / "d" / "taxels.csv"
    table = pd.read_csv(path)
    assert list(table.columns) == ["r", "c", "u_m", "v_m", "du_m", "dv_m"]
    table.sample(frac=1, random_state=3).to_csv(path, index=False)
    dataset = read_dataset(tmp_path / "d")
    np.testing.assert_array_equal(dataset.layout().centres_m, session().layout().centres_m + SHIFT)


@pytest.mark.parametrize(
    ("edit", "said"),
    [
        (lambda t: t.drop(index=3), "a row for every taxel of rows x cols; got none for taxel_0_3"),
        (lambda t: t.assign(c=t.c.replace(3, 2)), "each taxel once"),
        (lambda t: t.assign(r=t.r.replace(3, 4)), "a row below [sensor] rows = 4"),
        (lambda t: t.assign(u_m=t.u_m * 1000), "looks like millimetres"),
        (lambda t: t.assign(du_m=0.0), "a number above 0"),
        (lambda t: t.assign(du_m=0.005), "do not overlap"),
        (lambda t: t.drop(columns="dv_m"), "the column dv_m"),
    ],
)
def test_mistakes_in_the_positions(session: Session, tmp_path: Path, edit: Callable, said: str) -> None:
    write_dataset(listed(session()), tmp_path / "d")
    path = tmp_path / "d" / "taxels.csv"
    edit(pd.read_csv(path)).to_csv(path, index=False)
    problems = [str(p) for p in check_dataset(tmp_path / "d").errors]
    assert any(said in text and text.startswith(str(path)) for text in problems), problems


def test_positions_that_nothing_names(folder: Path) -> None:
    (folder / "taxels.csv").write_text("r,c,u_m,v_m,du_m,dv_m\n")
    assert any("taxels.csv" in str(w) for w in read_dataset(folder).warnings)


def meshed(dataset: Dataset, scale: float = 1.0) -> Dataset:
    """The session with meshes for its cylinder and its sphere."""
    tip = trimesh.creation.cylinder(radius=0.0115, height=0.08, sections=90)
    tip.apply_transform(trimesh.transformations.rotation_matrix(np.pi / 2, [1, 0, 0]))
    ball = trimesh.creation.icosphere(subdivisions=2, radius=0.006)
    tip.apply_scale(scale)
    meshes = {"tip.stl": tip.export(file_type="stl"), "ball.obj": ball.export(file_type="obj").encode()}
    meta = replace(
        dataset.meta,
        surface=SurfaceSpec("mesh", file="tip.stl"),
        indenter=IndenterSpec("mesh", file="ball.obj"),
    )
    return replace(dataset, meta=meta, meshes=meshes)


def test_meshes_travel_with_the_dataset(session: Session, tmp_path: Path) -> None:
    dataset = meshed(session())
    write_dataset(dataset, tmp_path / "d")
    back = read_dataset(tmp_path / "d")
    assert isinstance(back.surface(), MeshSurface)
    assert isinstance(back.indenter(), MeshIndenter)
    assert back.meshes == dataset.meshes
    assert np.isnan(back.indenter_radii_m()).all()


def test_a_mesh_in_millimetres_or_broken(session: Session, tmp_path: Path) -> None:
    write_dataset(meshed(session(), scale=1000.0), tmp_path / "d")
    (tmp_path / "d" / "ball.obj").write_text("no mesh at all")
    said = [str(p) for p in check_dataset(tmp_path / "d").errors]
    assert (
        said[0].startswith(f"{tmp_path}/d/tip.stl: expected a mesh in metres")
        and "looks like millimetres" in said[0]
    )
    assert said[1].startswith(f"{tmp_path}/d/ball.obj: expected a triangle mesh")


def test_lost_readings_are_no_fault(folder: Path) -> None:
    table = pd.read_csv(folder / "presses.csv")
    table.loc[5, "taxel_1_2"] = np.nan
    table.to_csv(folder / "presses.csv", index=False)
    dataset = read_dataset(folder)
    assert np.isnan(dataset.presses.counts[5, 6]) and np.isnan(dataset.presses.counts).sum() == 1
    assert any("none in 1 of" in str(warning) for warning in dataset.warnings)


def test_dead_taxels(folder: Path) -> None:
    for name in ("presses.csv", "frames.csv"):
        table = pd.read_csv(folder / name)
        table["taxel_0_0"] = np.nan
        table["taxel_3_3"] = table["taxel_3_3"].astype(float)
        table.loc[table.index[-4:], "taxel_3_3"] = np.nan
        table.to_csv(folder / name, index=False)
    dataset = read_dataset(folder)
    assert np.isnan(dataset.presses.counts[:, 0]).all()
    assert np.isnan(dataset.presses.counts[-4:, 15]).all()
    text = "\n".join(str(w) for w in dataset.warnings)
    assert "nothing but NaN from taxel_0_0" in text
    assert "NaN for a part of the session from taxel_3_3" in text


def test_counts_whose_rest_was_taken_off(session: Session, tmp_path: Path) -> None:
    """They may be negative, and no whole numbers; nothing is clipped or rounded that was not."""
    dataset = with_sensor(session(), baseline="subtracted")
    assert dataset.frames is not None
    frames = replace(dataset.frames, counts=dataset.frames.counts - 0.4)
    moved = with_presses(replace(dataset, frames=frames), counts=dataset.presses.counts - 0.4)
    write_dataset(moved, tmp_path / "d")
    assert read_dataset(tmp_path / "d").converter() == Converter.none()


def test_frames_beyond_the_presses_and_presses_without_frames(folder: Path) -> None:
    table = pd.read_csv(folder / "frames.csv")
    table[table.press != 3].to_csv(folder / "frames.csv", index=False)
    assert any("none for 1 of 12" in str(w) for w in read_dataset(folder).warnings)


def test_arrays_are_read_only_and_checked(session: Session) -> None:
    presses = session().presses
    with pytest.raises(ValueError, match="read-only"):
        presses.counts[0, 0] = 1.0
    with pytest.raises(ValueError, match="read-only"):
        presses.columns["t_hold_s"][0] = 1.0
    with pytest.raises(ValueError, match=r"position_m: expected shape \(2, 3\); got \(2, 2\)"):
        Presses(np.arange(2), np.zeros((2, 2)), np.ones(2), np.zeros((2, 16)))
    with pytest.raises(ValueError, match="pose"):
        replace(presses, columns={"pose": np.array(["A"], dtype=object)})


def test_selecting_rows(session: Session) -> None:
    dataset = session()
    chosen = dataset.presses.select([4, 1])
    assert chosen.press.tolist() == [4, 1]
    assert chosen.columns["pose"].tolist() == ["A", "B"]
    np.testing.assert_array_equal(chosen.counts, dataset.presses.counts[[4, 1]])
    assert dataset.frames is not None
    held = dataset.frames.select(dataset.frames.phase == HOLD)
    assert set(held.phase.tolist()) == {HOLD}
    assert len(held) < len(dataset.frames)


def test_a_chamber_may_press_with_kilonewtons(tmp_path: Path) -> None:
    """3.4 bar on a punch of 0.1 m radius are 10 kN, and no mistake."""
    by_hand(
        tmp_path,
        "press,x_m,y_m,z_m,force_n,taxel_0_0,taxel_0_1\n0,,,,10681,20,30\n1,,,,5000,10,15\n",
        description=MINIMAL.replace("0.05", "0.1"),
    )
    assert not check_dataset(tmp_path).errors


def test_mounts_of_all_surfaces() -> None:
    mount = MountSpec(0.02, 0.0, (0.01, 0.03), (-5.0, 5.0), x_m=0.001, x_range_m=(0.0, 0.002))
    assert mount.beta_deg is None
    assert PositionSpec(np.inf, 0.0).sigma_m == np.inf
