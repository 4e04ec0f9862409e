"""``--force`` removes only what skincal wrote: no strangers, no inputs, nothing that appeared meanwhile."""

from __future__ import annotations

import fcntl
import json
import os
from collections.abc import Callable
from pathlib import Path

import pytest
from calibrations import make_calibration
from commands import run

from skincal.calibration import write_calibration
from skincal.dataset import write_dataset
from skincal.errors import InputError
from skincal.files import outputs, refuse_existing, whole_file, whole_folder
from skincal.files.manifest import NAME, strangers
from skincal.hand.sockets import make_keys
from tests.conftest import make_session


def write(path: Path, text: str = "x") -> Path:
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(text)
    return path


def output(path: Path, text: str = "old", **options: bool) -> Path:
    with whole_folder(path, marker="m.toml", **options) as folder:
        write(folder / "m.toml", text)
        write(folder / "inner" / "part", text)
    return path


@pytest.fixture(params=[True, False], ids=["exchange", "two moves"])
def way(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch) -> bool:
    """True if kernel and file system have renameat2."""
    if not request.param:
        monkeypatch.setattr(outputs, "_renameat2", lambda *_: False)
    return request.param


def test_a_folder_lists_what_was_written(tmp_path: Path) -> None:
    found = json.loads((output(tmp_path / "out") / NAME).read_text())
    assert found == {"tool": "skincal", "format": "skincal-output/1", "files": ["inner/part", "m.toml"]}
    assert strangers(tmp_path / "out") == []


@pytest.mark.parametrize(
    "name", ["thesis.tex", "inner/notes.txt", "empty/", "more/deep/x", "link", ".hidden", "m.toml.bak"]
)
def test_strangers_are_refused_by_name(tmp_path: Path, name: str) -> None:
    out = output(tmp_path / "out")
    if name == "link":
        (out / name).symlink_to(tmp_path)
    elif name.endswith("/"):
        (out / name).mkdir()
    else:
        write(out / name)
    if name == "m.toml.bak":
        (out / NAME).write_text(
            json.dumps({"tool": "skincal", "files": ["m.toml", "inner/part", "*", "m.*.bak"]})
        )
    shown = "more/" if name.startswith("more") else name
    with pytest.raises(InputError, match=rf"also {shown}\. Move that elsewhere"):
        output(out, "new", force=True)
    assert (out / "m.toml").read_text() == "old" and os.path.lexists(out / name)


def test_what_the_system_and_killed_runs_leave_is_no_stranger(tmp_path: Path, way: bool) -> None:
    out = output(tmp_path / "out")
    (
        write(out / ".DS_Store"),
        write(out / "inner" / ".nfs0001"),
        write(out / ".m.toml.abcd_123.part" / "m.toml"),
    )
    output(out, "new", force=True)
    assert sorted(p.name for p in out.iterdir()) == [NAME, "inner", "m.toml"]
    assert [p.name for p in tmp_path.iterdir()] == ["out"]


def _keys(path: Path, force: bool = False) -> None:
    pytest.importorskip("zmq")
    make_keys(path, force=force)


WRITERS: dict[str, Callable[..., None]] = {
    "calibration": lambda path, force=False: write_calibration(make_calibration(), path, force=force),
    "dataset": lambda path, force=False: write_dataset(make_session(), path, force=force),
    "keys": _keys,
}


@pytest.mark.parametrize("kind", WRITERS)
def test_folders_of_older_versions_are_replaced(tmp_path: Path, kind: str) -> None:
    """Folders without a list, as older versions wrote them."""
    out = tmp_path / "out"
    WRITERS[kind](out)
    (out / NAME).unlink()
    WRITERS[kind](out, force=True)
    assert (out / NAME).is_file()
    (out / NAME).unlink()
    write(out / "notes" / "lab.txt")
    with pytest.raises(InputError, match="also notes/"):
        WRITERS[kind](out, force=True)
    assert (out / "notes" / "lab.txt").is_file()


def test_keys_do_not_take_the_place_of_a_project(tmp_path: Path) -> None:
    pytest.importorskip("zmq")
    write(tmp_path / "proj" / "README.txt"), write(tmp_path / "proj" / "src" / "main.py", "code")
    with pytest.raises(InputError, match="a folder of something else"):
        make_keys(tmp_path / "proj", force=True)
    assert (tmp_path / "proj" / "src" / "main.py").read_text() == "code"


@pytest.mark.parametrize("force", [False, True])
@pytest.mark.parametrize("kind", ["folder", "file"])
def test_what_appears_meanwhile_stays(tmp_path: Path, way: bool, force: bool, kind: str) -> None:
    out = tmp_path / "cal.v2"
    with pytest.raises(InputError, match=r"cal\.v2: .* The new output is complete, as .*cal-\w{8}\.v2"):
        if kind == "folder":
            with whole_folder(out, marker="m.toml", force=force) as folder:
                write(folder / "m.toml", "new")
                write(out / "thesis.txt")
        else:
            with whole_file(out, force=force, mark="[ours]") as file:
                write(file, "[ours] new")
                write(out, "thesis")
    assert (out / "thesis.txt").is_file() if kind == "folder" else out.read_text() == "thesis"
    (kept,) = (path for path in tmp_path.iterdir() if path != out)
    assert ("new" in (kept / "m.toml" if kind == "folder" else kept).read_text()) and kept.suffix == ".v2"


def test_an_empty_folder_that_appears_meanwhile_is_no_loss(tmp_path: Path) -> None:
    with (
        pytest.raises(InputError, match="a folder of that name"),
        whole_folder(tmp_path / "o", marker="m") as folder,
    ):
        write(folder / "m")
        (tmp_path / "o").mkdir()


def test_what_appears_during_the_exchange_stays(
    tmp_path: Path, way: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Between the last look and the move; the move is taken back."""
    out = output(tmp_path / "out")
    if way:
        real = outputs._renameat2

        def move(source: Path, target: Path, flag: int) -> bool:
            if flag == outputs._EXCHANGE and source.suffix == ".part":
                write(out / "thesis.txt") if (out / "m.toml").read_text() == "old" else None
            return real(source, target, flag)

        monkeypatch.setattr(outputs, "_renameat2", move)
    else:
        rename = Path.rename

        def late(self: Path, target: Path) -> Path:
            if self == out:
                write(out / "thesis.txt")
            return rename(self, target)

        monkeypatch.setattr(Path, "rename", late)
    with pytest.raises(InputError, match=r"also thesis\.txt\. The new output is complete"):
        output(out, "new", force=True)
    assert (out / "thesis.txt").is_file() and (out / "m.toml").read_text() == "old"
    (kept,) = tmp_path.glob("out-*")
    assert (kept / "m.toml").read_text() == "new" and len(list(tmp_path.iterdir())) == 2


def test_a_folder_in_which_somebody_works_stays(tmp_path: Path) -> None:
    out = output(tmp_path / "out")
    with (out / "m.toml").open("r+") as file:
        fcntl.flock(file, fcntl.LOCK_EX)
        with pytest.raises(InputError, match="another process at work"):
            refuse_existing(out, force=True, marker="m.toml")
    with (
        pytest.raises(InputError, match="another process at work"),
        (out / "m.toml").open("r+") as file,
        whole_folder(out, force=True, marker="m.toml") as folder,
    ):
        write(folder / "m.toml", "new")
        fcntl.flock(file, fcntl.LOCK_EX)  # began meanwhile
    assert (out / "m.toml").read_text() == "old"


def test_a_file_of_another_kind_is_not_replaced(tmp_path: Path) -> None:
    path = write(tmp_path / "ranges.toml", "[tool.somebody]")
    with pytest.raises(InputError, match="a file to replace that holds skincal-ranges/1; got another file"):
        refuse_existing(path, force=True, mark="skincal-ranges/1")
    path.write_text("")
    refuse_existing(path, force=True, mark="skincal-ranges/1")
    path.write_text("# " + 5000 * "x" + "skincal-ranges/1")
    refuse_existing(path, force=True, mark="skincal-ranges/1")


@pytest.mark.parametrize("suffix", [".png", ".svg", ".pdf"])
def test_pictures_have_their_mark(tmp_path: Path, suffix: str) -> None:
    from matplotlib.figure import Figure

    from skincal.report.style import PICTURE_MARK, save

    figure = Figure()
    figure.subplots().plot([1, 2])
    save(figure, tmp_path / f"picture{suffix}")
    refuse_existing(tmp_path / f"picture{suffix}", force=True, mark=PICTURE_MARK)


PLACES = {
    "in": ".", "a folder above": "..", "a file of it": "dataset.toml", "a table": "presses.csv", "a mesh": "tip.stl",
}  # fmt: skip


@pytest.mark.parametrize("place", PLACES.values())
@pytest.mark.parametrize("listed", [True, False])
def test_inputs_are_never_replaced(tmp_path: Path, place: str, listed: bool) -> None:
    """With and without a list in the input, for each nesting of input and output."""
    data = tmp_path / "deep" / "data"
    data.parent.mkdir()
    write_dataset(make_session(), data)
    write(data / "tip.stl")
    toml = (data / "dataset.toml").read_text().replace('kind = "sphere"', 'kind = "mesh"\nfile = "tip.stl"')
    (data / "dataset.toml").write_text(toml)
    content = json.loads((data / NAME).read_text())
    (data / NAME).write_text(json.dumps({**content, "files": [*content["files"], "tip.stl"]}))
    if not listed:
        (data / NAME).unlink()
    (tmp_path / "link").symlink_to(data)
    for base in (data, tmp_path / "link"):
        with pytest.raises(InputError, match="an output that is not an input"):
            refuse_existing((base / place).resolve() if place == ".." else base / place, data, force=True)
    refuse_existing(data / "cal", data, force=True, marker="calibration.toml")
    refuse_existing(data / "notes.toml", data, force=True)


def test_an_input_of_another_name_is_not_replaced(tmp_path: Path) -> None:
    """By a hard link; a mount and a file system that ignores case have one file under two paths, too."""
    (tmp_path / "plan.toml").write_text("a plan")
    (tmp_path / "out.toml").hardlink_to(tmp_path / "plan.toml")
    with pytest.raises(InputError, match="an output that is not an input"):
        refuse_existing(tmp_path / "out.toml", tmp_path / "plan.toml", force=True)


def test_a_loop_of_links_is_no_input_and_no_output(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    write_calibration(make_calibration(), tmp_path / "c")
    loop = tmp_path / "loop.toml"
    loop.symlink_to(loop)
    assert run("export-dr", tmp_path / "c", "--out", loop) == 2
    assert run("export-dr", loop, "--out", tmp_path / "ranges.toml") == 2
    assert run("dataset", "show", loop) == 2
    assert run("hand", "show", loop) == 2
    assert "internal error" not in capsys.readouterr().err
    assert loop.is_symlink()


def test_export_dr_spares_its_calibration(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    write_calibration(make_calibration(), tmp_path / "c")
    before = (tmp_path / "c" / "calibration.toml").read_bytes()
    assert run("export-dr", tmp_path / "c", "--out", tmp_path / "c" / "calibration.toml", "--force") == 2
    assert "inputs are not replaced" in capsys.readouterr().err
    assert run("export-dr", tmp_path / "c", "--out", tmp_path / "c" / "ranges.toml") == 0
    assert run("export-dr", tmp_path / "c", "--out", tmp_path / "c" / "ranges.toml", "--force") == 0
    assert (tmp_path / "c" / "calibration.toml").read_bytes() == before


def test_predict_refuses_a_dataset_with_more_in_it(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    write_calibration(make_calibration(), folder.parent / "cal")
    write_dataset(make_session(), folder.parent / "run")
    (
        write(folder.parent / "run" / "cal" / "calibration.toml"),
        write(folder.parent / "run" / "notes" / "lab.txt"),
    )
    assert run("predict", folder.parent / "cal", folder, "--out", folder.parent / "run", "--force") == 2
    assert "also cal/, notes/" in capsys.readouterr().err
    assert (folder.parent / "run" / "notes" / "lab.txt").is_file()


def test_an_import_spares_its_recording(tmp_path: Path) -> None:
    from skincal.imports import import_csv, template

    text = template("csv").replace("# files", "files")
    mapping = write(tmp_path / "rec" / "map.toml", text)
    write(tmp_path / "rec" / "presses.csv"), write(tmp_path / "rec" / "dataset.toml")
    with pytest.raises(InputError, match="inputs are not replaced"):
        import_csv(mapping, tmp_path / "rec", force=True)
