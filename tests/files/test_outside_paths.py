"""Every reader refuses devices, pipes and files outside the folder that names them, without reading a byte."""

from __future__ import annotations

import os
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

pytest.importorskip("stable_baselines3", reason="needs skincal[train]")

from calibrations import make_calibration
from hands import other_hand

from skincal.calibration import read_calibration, write_calibration
from skincal.collect import Mount, read_plan
from skincal.dataset import read_dataset, write_dataset
from skincal.errors import InputError
from skincal.hand.sockets import client_keys
from skincal.imports import import_csv, import_rosbag
from skincal.ranges import read_ranges
from skincal.robot import read_hand
from skincal.train import read_curve, read_policy, read_run
from tests.conftest import make_session

pytestmark = pytest.mark.usefixtures("in_process")

SECRET = "root:x:0:0"


def _mapping(folder: Path, kind: str, files: str) -> Path:
    """A mapping that is right but for the file that it names."""
    from skincal.imports import template

    lines = template(kind).replace("# files", "files").splitlines()
    text = "\n".join(f"files = [{files}]" if line.startswith("files") else line for line in lines)
    (folder / "map.toml").write_text(text)
    return folder / "map.toml"


def _dataset(folder: Path) -> None:
    write_dataset(make_session(), folder, frames_as="parquet")


def _mount() -> Mount:
    return Mount.of(make_session().meta)


READERS: dict[str, tuple[str, Callable[[Path], object], Callable[[Path], Any]]] = {
    "dataset": ("dataset.toml", _dataset, read_dataset),
    "presses": ("presses.csv", _dataset, read_dataset),
    "frames": ("frames.parquet", _dataset, read_dataset),
    "calibration": (
        "calibration.toml", lambda f: write_calibration(make_calibration(), f), read_calibration
    ),
    "grid": ("grid.parquet", lambda f: write_calibration(make_calibration(), f), read_calibration),
    "hand": ("hand.toml", other_hand, read_hand),
    "urdf": ("other.urdf", other_hand, read_hand),
    "plan": ("plan.toml", Path.mkdir, lambda f: read_plan(f / "plan.toml", _mount())),
    "plan, csv": ("plan.csv", Path.mkdir, lambda f: read_plan(f / "plan.csv", _mount())),
    "ranges": ("ranges.yaml", Path.mkdir, lambda f: read_ranges(f / "ranges.yaml")),
    "policy": ("policy.onnx", Path.mkdir, lambda f: read_policy(f / "policy.onnx")),
    "curve": ("curve.csv", Path.mkdir, lambda f: read_curve(f / "curve.csv")),
    "run": ("run.toml", Path.mkdir, read_run),
    "key": ("client.key_secret", Path.mkdir, client_keys),
    "mapping": ("map.toml", Path.mkdir, lambda f: import_csv(f / "map.toml", f / "out")),
    "recording": (
        "presses.csv",
        lambda f: (f.mkdir(), _mapping(f, "csv", '"presses.csv"')),
        lambda f: import_csv(f / "map.toml", f / "out", [f / "presses.csv"]),
    ),
    **{
        f"recording, {suffix}": (
            f"presses.{suffix}",
            lambda f: (f.mkdir(), _mapping(f, "csv", '"presses.csv"')),
            lambda f, suffix=suffix: import_csv(f / "map.toml", f / "out", [f / f"presses.{suffix}"]),
        )
        for suffix in ("mat", "h5", "npz", "npy", "parquet")
    },
    **{
        f"bag, {suffix}": (
            f"session.{suffix}",
            lambda f: (f.mkdir(), _mapping(f, "rosbag", '"session.bag"')),
            lambda f, suffix=suffix: import_rosbag(f / "map.toml", f / "out", [f / f"session.{suffix}"]),
        )
        for suffix in ("mcap", "db3")
    },
    "bag": (
        "session.bag",
        lambda f: (f.mkdir(), _mapping(f, "rosbag", '"session.bag"')),
        lambda f: import_rosbag(f / "map.toml", f / "out", [f / "session.bag"]),
    ),
}  # fmt: skip
"""Name of a file, what makes a good folder about it, and what reads it."""

IN_FOLDERS = ("dataset", "presses", "frames", "calibration", "grid", "urdf", "curve", "run")
"""Those that belong to a folder: a link in it may not lead out."""


def _refused(folder: Path, reader: str) -> str:
    with pytest.raises(InputError) as caught:
        READERS[reader][2](folder)
    assert SECRET not in str(caught.value)
    return str(caught.value)


@pytest.mark.parametrize("special", ["a device", "a pipe"])
@pytest.mark.parametrize("reader", READERS)
def test_devices_and_pipes_are_refused(tmp_path: Path, reader: str, special: str) -> None:
    folder, (name, make, _) = tmp_path / "input", READERS[reader]
    make(folder)
    (folder / name).unlink(missing_ok=True)
    if special == "a pipe":
        os.mkfifo(folder / name)
    else:
        (folder / name).symlink_to("/dev/zero")
    assert any(
        reason in _refused(folder, reader) for reason in (f"{special}, not a file", "outside the folder")
    )


@pytest.mark.parametrize("reader", IN_FOLDERS)
def test_links_out_of_a_folder_are_refused(tmp_path: Path, reader: str) -> None:
    folder, (name, make, _) = tmp_path / "input", READERS[reader]
    make(folder)
    (tmp_path / "secret").write_text(SECRET)
    (folder / name).unlink(missing_ok=True)
    (folder / name).symlink_to("../secret")
    assert "outside the folder" in _refused(folder, reader)


PLACES = ("/etc/passwd", "../secret", "/dev/zero", "a/../../secret", "../..", "a\\u0000b")


@pytest.mark.parametrize("place", PLACES)
@pytest.mark.parametrize("kind", ["csv", "rosbag"])
def test_a_mapping_names_only_what_lies_next_to_it(tmp_path: Path, place: str, kind: str) -> None:
    (tmp_path / "secret").write_text(SECRET)
    (tmp_path / "here" / "a").mkdir(parents=True)
    path = _mapping(tmp_path / "here", kind, f'"{place}"')
    with pytest.raises(InputError, match=r"map\.toml, .*(outside the folder|null character)") as caught:
        (import_csv if kind == "csv" else import_rosbag)(path, tmp_path / "out")
    assert SECRET not in str(caught.value)


@pytest.mark.parametrize("place", PLACES)
def test_a_hand_names_only_a_urdf_in_its_folder(tmp_path: Path, place: str) -> None:
    (tmp_path / "secret").write_text(SECRET)
    path = other_hand(tmp_path / "hand")
    (tmp_path / "hand" / "a").mkdir()
    path.write_text(path.read_text().replace("other.urdf", place))
    with pytest.raises(
        InputError, match=r"expected the URDF .*(outside the folder|null character)"
    ) as caught:
        read_hand(path)
    assert SECRET not in str(caught.value)


@pytest.mark.parametrize(
    "place", ["/dev/zero", "../../mesh.stl", "package:///dev/zero", "package://../mesh.stl"]
)
@pytest.mark.parametrize("of", ['mesh filename="{}"', 'texture filename="{}"'])
def test_a_urdf_names_only_meshes_in_the_hands_folder(tmp_path: Path, place: str, of: str) -> None:
    path = other_hand(tmp_path / "hand")
    urdf = path.parent / "other.urdf"
    urdf.write_text(
        urdf.read_text().replace("<geometry><sphere", f"<{of.format(place)}/><geometry><sphere", 1)
    )
    with pytest.raises(InputError, match=r"other\.urdf, filename .* outside the folder"):
        read_hand(path)
    urdf.write_text(urdf.read_text().replace(place, "meshes/none.stl"))
    read_hand(path)


@pytest.mark.parametrize("place", ["/dev/zero", "../secret"])
def test_a_description_names_only_files_next_to_it(tmp_path: Path, place: str) -> None:
    """Named directly, and reached by a link."""
    (tmp_path / "secret").write_text(SECRET)
    _dataset(tmp_path / "data")
    toml = tmp_path / "data" / "dataset.toml"
    was = toml.read_text()
    for table in ("surface", "indenter"):
        (tmp_path / "data" / "tip.stl").unlink(missing_ok=True)
        for name in (place, "tip.stl"):
            kind = 'kind = "mesh"' + f'\nfile = "{name}"\n'
            begin, _, rest = was.partition(f"[{table}]")
            toml.write_text(f"{begin}[{table}]\n{kind}[" + rest.partition("[")[2])
            with pytest.raises(InputError, match=r"file: expected a file in the same folder"):
                read_dataset(tmp_path / "data")
            if name == place:
                (tmp_path / "data" / "tip.stl").symlink_to(place)


def test_every_file_of_a_bag_lies_in_its_folder(tmp_path: Path) -> None:
    pytest.importorskip("rosbags")
    bag = tmp_path / "bag"
    bag.mkdir()
    (bag / "metadata.yaml").symlink_to("/etc/passwd")
    with pytest.raises(InputError, match=r"metadata\.yaml: .* outside the folder"):
        import_rosbag(_mapping(tmp_path, "rosbag", '"bag"'), tmp_path / "out", [bag])
