"""ROS 1 and ROS 2 bags: topics, clocks, types of one's own, damage."""

from __future__ import annotations

import shutil
import sys
from collections.abc import Callable
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from skincal.dataset import Dataset, read_dataset
from skincal.errors import InputError, WorkError
from skincal.imports import Imported, bag_source, bag_topics, import_rosbag, template
from skincal.imports.apart import apart
from skincal.imports.bag_file import opened
from tests.conftest import make_session
from tests.imports.foreign import Recorded, imported, mapping, recorded, refusals, write_mapping
from tests.imports.ros import BAG, SKIN_MSG, BagMaker, ns, write_bag

WriteBag = Callable[..., Path]
pytestmark = pytest.mark.usefixtures("in_process")


@pytest.fixture(scope="module")
def recording() -> Recorded:
    return recorded(make_session(3, frames_per_press=0))


@pytest.fixture(scope="module")
def written(recording: Recorded, tmp_path_factory: pytest.TempPathFactory) -> WriteBag:
    """Writes a bag of the recording, each only once; returns its path."""

    @cache
    def write(name: str = "s.bag", storage: str = "", skin: str = "Float32", own: bool = False) -> Path:
        path = tmp_path_factory.mktemp("bags") / name
        if not own:
            return write_bag(path, recording, storage, skin)
        with BagMaker(path) as bag:
            _write_own(bag, recording)
        return path

    return write


def bring(folder: Path, bags: list[Path], **changes: Any) -> tuple[Dataset, Imported]:
    return imported(folder, mapping(BAG, **changes), bags, import_rosbag)


def refused(folder: Path, bags: list[Path], **changes: Any) -> str:
    return "\n".join(refusals(folder, mapping(BAG, **changes), bags, import_rosbag))


@pytest.mark.parametrize(
    ("name", "storage", "skin"),
    [("s.bag", "", "Float32"), ("s.bag", "", "Int16"), ("s", "sqlite3", "Float32"), ("s", "mcap", "Int16")],
)
def test_presses_come_out_of_a_bag(
    tmp_path: Path, recording: Recorded, written: WriteBag, monkeypatch: pytest.MonkeyPatch,
    name: str, storage: str, skin: str,
):  # fmt: skip
    if storage == "mcap":
        monkeypatch.setattr(bag_source, "apart", apart)  # read by another process, as a user reads it
    back, done = bring(tmp_path, [written(name, storage, skin)])
    presses, frames = back.presses, back.frames
    np.testing.assert_allclose(presses.force_n, recording.level_n, rtol=0.01)
    np.testing.assert_allclose(presses.counts, recording.image, atol=2.0, rtol=0.01)
    np.testing.assert_allclose(
        presses.position_m,
        recording.position_m[recording.press.searchsorted(0) + 180 * np.arange(3)],
        atol=1e-9,
    )
    np.testing.assert_allclose(presses.columns["t_hold_s"], recording.hold_s[:, 0], atol=0.03)
    np.testing.assert_allclose(presses.columns["q_0"], 0.1, rtol=1e-12)
    np.testing.assert_allclose(presses.columns["q_1"], 0.2, rtol=1e-12)
    np.testing.assert_allclose(presses.columns["tau_0"], 0.01, rtol=1e-12)
    assert "q_2" not in presses.columns
    assert frames is not None
    # The clock of the taxels, with their lag taken off; stamps are nanoseconds.
    np.testing.assert_allclose(frames.time_s, recording.time_s[: len(frames)] - 100, atol=1e-8)
    np.testing.assert_array_equal(frames.counts, recording.counts[: len(frames)])
    np.testing.assert_allclose(frames.force_n, recording.force_n[: len(frames)], atol=0.02)
    assert done.read[0].rows == len(recording.time_s)


def test_lag_moves_the_taxels_against_the_force(tmp_path: Path, written: WriteBag):
    bag = written()
    with_lag, _ = bring(tmp_path, [bag])
    done = import_rosbag(
        write_mapping(tmp_path, mapping(BAG, topics={"/skin": {"lag_s": 0.0}})), tmp_path / "late", [bag]
    )
    late = read_dataset(done.folder)
    assert with_lag.frames is not None and late.frames is not None
    right = np.corrcoef(with_lag.frames.force_n, with_lag.frames.counts.sum(axis=1))[0, 1]
    wrong = np.corrcoef(late.frames.force_n, late.frames.counts.sum(axis=1))[0, 1]
    assert right > wrong


def test_template_works(tmp_path: Path, written: WriteBag):
    (tmp_path / "m.toml").write_text(template("rosbag"), encoding="utf-8")
    done = import_rosbag(tmp_path / "m.toml", tmp_path / "out", [written("s", "mcap")])
    assert done.presses == 3


def test_topics_are_listed(tmp_path: Path, recording: Recorded, written: WriteBag):
    topics = bag_topics(written())
    assert topics["/skin"] == ("std_msgs/msg/Float32MultiArray", len(recording.time_s))
    assert list(topics) == ["/force", "/joints", "/skin", "/tip"]
    with pytest.raises(InputError, match=r"no\.bag: expected a bag to read; got no such file"):
        bag_topics(tmp_path / "no.bag")


OWN: dict[str, Any] = {
    "topics": None,
    "joints": None,
    "taxels": {"field": "rows[0].values"},
    "sensor": {"rows": 1},
    "columns": {
        "position": {"topic": "/tf", "field": "transforms[child_frame_id=tip].transform.translation"}
    },
}
"""Changes of the mapping for bags with types of their own."""


@pytest.mark.parametrize("name", ["s.bag", "s"])
def test_types_of_ones_own_poses_and_transforms(
    tmp_path: Path, recording: Recorded, written: WriteBag, name: str
):
    """The skin is an array of rows in a message of its own, the tip one of several transforms."""
    changes: dict[str, Any] = {
        **OWN,
        "taxels": {"field": "rows[0].values", "elements": [3, 2, 1, 0]},
        "bag": {"resample": "previous"},
        "columns": OWN["columns"]
        | {
            "temperature_c": {"topic": "/force", "field": "wrench.torque.x", "unit": "K"},
            "pose": {"topic": "/tf", "field": "transforms[child_frame_id=tip].header.frame_id"},
        },
    }
    back, _ = bring(tmp_path, [written(name, own=True)], **changes)
    np.testing.assert_allclose(back.presses.force_n, recording.level_n, rtol=0.01)
    np.testing.assert_allclose(back.presses.counts, recording.image[:, 3::-1], atol=2.0, rtol=0.01)
    np.testing.assert_allclose(back.presses.columns["temperature_c"], 25.0)
    assert set(back.presses.columns["pose"]) == {"palm"}


def _write_own(bag: BagMaker, recording: Recorded) -> None:
    bag.register(SKIN_MSG, "my_msgs/msg/Skin")
    if bag.ros1:
        bag.register("geometry_msgs/TransformStamped[] transforms", "tf2_msgs/msg/TFMessage")
    for i, time in enumerate(recording.time_s):
        header = bag.header(ns(time))
        rows = [
            bag.make("my_msgs/msg/TaxelRow", recording.counts[i, 4 * r : 4 * r + 4].astype(np.uint16))
            for r in range(4)
        ]
        bag.write("/skin", ns(time), bag.make("my_msgs/msg/Skin", header, 3, rows))
        vectors = (np.array([0, 0, -recording.force_n[i]]), np.array([298.15, 0, 0]))
        wrench = bag.make("geometry_msgs/msg/Wrench", *(bag.vector(v) for v in vectors))
        bag.write("/force", ns(time), bag.make("geometry_msgs/msg/WrenchStamped", header, wrench))
        turn = bag.make("geometry_msgs/msg/Quaternion", 0.0, 0.0, 0.0, 1.0)
        transforms = [
            bag.make(
                "geometry_msgs/msg/TransformStamped",
                bag.header(ns(time), "palm"),
                child,
                bag.make("geometry_msgs/msg/Transform", bag.vector(point), turn),
            )
            for child, point in (("elbow", np.ones(3)), ("tip", recording.position_m[i]))
        ]
        bag.write("/tf", ns(time), bag.make("tf2_msgs/msg/TFMessage", transforms))
        # Other nodes send other frames on the same topic.
        bag.write("/tf", ns(time), bag.make("tf2_msgs/msg/TFMessage", transforms[:1]))


def test_definition_that_the_bag_lacks(tmp_path: Path, recording: Recorded, written: WriteBag):
    """Old ROS 2 recorders wrote no definitions: then a file has to say what a message is."""
    shutil.copytree(written("s", own=True), tmp_path / "s")
    _forget_definitions(tmp_path / "s")
    changes: dict[str, Any] = {**OWN}
    assert "Name its file in definitions of [bag]" in refused(tmp_path, [tmp_path / "s"], **changes)
    (tmp_path / "Skin.msg").write_text(SKIN_MSG.split("=")[0])
    (tmp_path / "TaxelRow.msg").write_text("uint16[4] values\n")
    changes["bag"] = {"definitions": {"my_msgs/msg/Skin": "Skin.msg", "my_msgs/TaxelRow": "TaxelRow.msg"}}
    back, _ = bring(tmp_path, [tmp_path / "s"], **changes)
    np.testing.assert_allclose(back.presses.force_n, recording.level_n, rtol=0.01)


def _forget_definitions(folder: Path) -> None:
    import sqlite3

    (file,) = folder.glob("*.db3")
    base = sqlite3.connect(file)
    base.execute("DELETE FROM message_definitions")
    base.commit()
    base.close()


def test_absent_topic_lists_those_that_are_there(tmp_path: Path, written: WriteBag):
    found = refused(tmp_path, [written()], columns={"force_n": {"topic": "/fource"}})
    assert (
        "map.toml, [columns.force_n] topic: expected a topic of s.bag, which has /force (geometry_msgs/"
        in found
    )
    assert "/skin (std_msgs/msg/Float32MultiArray)" in found
    assert 'got "/fource". Did you mean "/force"?' in found


@pytest.mark.parametrize(
    ("changes", "expected"),
    [
        (
            {"columns": {"force_n": {"field": "wrench.force.w"}}},
            'no field "w" in geometry_msgs/msg/Vector3, which has x, y, z',
        ),
        (
            {"columns": {"force_n": {"field": "wrench.force"}}},
            "no number but geometry_msgs/msg/Vector3, which has x, y, z",
        ),
        (
            {"taxels": {"topic": "/force", "field": "wrench"}},
            "no array of numbers but geometry_msgs/msg/Wrench",
        ),
        ({"sensor": {"cols": 5}}, "expected an array of 20 values or more; got 16 values"),
        ({"topics": None}, 'expected messages with a header on /skin; got none. Set clock = "receive" in'),
        (
            {"joints": {"topic": "/tip"}},
            "[joints]: expected sensor_msgs/JointState; got geometry_msgs/msg/Point",
        ),
        ({"columns": {"force_n": {"field": "wrench..z"}}}, "expected a path like wrench.force.z"),
    ],
)
def test_wrong_types_and_fields(tmp_path: Path, written: WriteBag, changes: dict, expected: str):
    found = refused(tmp_path, [written()], **changes)
    assert expected in found
    assert len(found.splitlines()) == 1


@pytest.mark.parametrize(("name", "storage"), [("s.bag", ""), ("s", "sqlite3"), ("s", "mcap")])
@pytest.mark.parametrize("share", [0.0, 0.3, 0.7, 0.98])
def test_bag_cut_short(tmp_path: Path, written: WriteBag, name: str, storage: str, share: float):
    whole, bag = written(name, storage), tmp_path / name
    shutil.copytree(whole, bag) if whole.is_dir() else shutil.copy(whole, bag)
    file = bag if bag.is_file() else next(iter([*bag.glob("*.db3"), *bag.glob("*.mcap")]))
    content = file.read_bytes()
    file.write_bytes(content[: int(share * len(content))])
    found = refused(tmp_path, [bag])
    assert "expected a whole ROS" in found
    assert "Was the recording cut short?" in found


def test_no_bag_at_all(tmp_path: Path):
    (tmp_path / "s.bag").write_text("not a bag")
    assert "expected a whole ROS 1 bag" in refused(tmp_path, [tmp_path / "s.bag"])
    (tmp_path / "folder").mkdir()
    assert "folder with metadata.yaml" in refused(tmp_path, [tmp_path / "folder"])
    assert "no such file" in refused(tmp_path, [tmp_path / "nothing.bag"])


def test_two_clocks_that_never_meet(tmp_path: Path, written: WriteBag):
    found = refused(tmp_path, [written()], topics={"/skin": {"lag_s": 3600.0}})
    assert "s.bag: expected frames with taxels, force and position; got none" in found
    assert "max_age_s" in found


def test_frames_without_force_are_left_out_and_counted(tmp_path: Path, recording: Recorded):
    """The sensor of the force was started late: of the first press nothing is known."""
    bag = write_bag(tmp_path / "s.bag", recording, force_from_s=recording.time_s[0] + 1.0)
    back, done = bring(tmp_path, [bag])
    assert len(back.presses) == 2 + 1  # what is left of the hold of the first is one too
    dropped = {item.why: item.count for item in done.dropped}
    assert dropped == {"no force_n from /force within 0.1 s (max_age_s)": pytest.approx(100, abs=3)}
    assert back.frames is not None
    assert len(back.frames) == len(recording.time_s) - sum(dropped.values())


def test_two_bags_follow_each_other(tmp_path: Path, recording: Recorded, written: WriteBag):
    first = written()
    after = recorded(make_session(3, frames_per_press=0, seed=5))
    later = Recorded(**{**vars(after), "time_s": after.time_s + 60.0})
    second = write_bag(tmp_path / "b.bag", later)
    back, done = bring(tmp_path, [first, second])
    np.testing.assert_allclose(back.presses.force_n, [*recording.level_n, *after.level_n], rtol=0.01)
    assert [file.file for file in done.read] == ["s.bag", "b.bag"]
    np.testing.assert_allclose(
        back.presses.columns["t_hold_s"], [*recording.hold_s[:, 0], *(after.hold_s[:, 0] + 60)], atol=0.03
    )
    with pytest.raises(InputError, match="times in order"):
        import_rosbag(tmp_path / "map.toml", tmp_path / "other", [second, first])


def test_library_that_is_not_installed(written: WriteBag, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setitem(sys.modules, "rosbags.highlevel", None)
    # Opened here: an import opens it in a process of its own, which has the library.
    with pytest.raises(WorkError, match=r"pip install skincal\[ros\]"), opened(written(), {}):
        pass
