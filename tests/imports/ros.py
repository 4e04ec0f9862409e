"""Bags with known presses in them, made by the library rosbags."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from rosbags.rosbag1 import Writer as Writer1
from rosbags.rosbag2 import StoragePlugin
from rosbags.rosbag2 import Writer as Writer2
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from tests.imports.foreign import Recorded

EPOCH_NS = 1_800_000_000_000_000_000
TIP_RATE_HZ, FORCE_RATE_HZ = 40.0, 250.0
SKIN_LATE_NS = 20_000_000
"""The recorder gets the skin's messages so much later than they were measured."""

SKIN_MSG = (
    "std_msgs/Header header\nuint8 board\nTaxelRow[] rows\n"
    + "=" * 80
    + ("\nMSG: my_msgs/TaxelRow\nuint16[4] values\n")
)
"""A type that no store knows: four rows of four taxels."""

BAG: dict[str, Any] = {
    "bag": {"clock": "header", "resample": "linear"},
    "topics": {"/skin": {"clock": "receive", "lag_s": 0.02}},
    "taxels": {"topic": "/skin", "field": "data"},
    "columns": {
        "force_n": {"topic": "/force", "field": "wrench.force.z", "unit": "N", "sign": -1},
        "position": {"topic": "/tip", "field": "point", "unit": "m"},
    },
    "joints": {"topic": "/joints", "names": ["prox", "dist"]},
}


class BagMaker:
    """Writes a recording as a bag.

    Args:
        path: of the bag; ``.bag`` for ROS 1, a folder for ROS 2.
        storage: of ROS 2: ``sqlite3``, also if it is empty, or ``mcap``.
    """

    def __init__(self, path: Path, storage: str = "sqlite3") -> None:
        self.path = path
        self.ros1 = path.suffix == ".bag"
        self.store: Any = get_typestore(Stores.ROS1_NOETIC if self.ros1 else Stores.ROS2_HUMBLE)
        self._writer: Any = (
            Writer1(path)
            if self.ros1
            else Writer2(path, version=9, storage_plugin=StoragePlugin[(storage or "sqlite3").upper()])
        )
        self._connections: dict[str, Any] = {}

    def __enter__(self) -> BagMaker:
        self._writer.open()
        return self

    def __exit__(self, *_: object) -> None:
        self._writer.close()

    def register(self, text: str, name: str) -> None:
        self.store.register(get_types_from_msg(text, name))

    def make(self, kind: str, *values: Any) -> Any:
        return self.store.types[kind](*values)

    def header(self, stamp_ns: int, frame: str = "base") -> Any:
        time = self.make("builtin_interfaces/msg/Time", stamp_ns // 10**9, stamp_ns % 10**9)
        kind = self.store.types["std_msgs/msg/Header"]
        return kind(seq=0, stamp=time, frame_id=frame) if self.ros1 else kind(stamp=time, frame_id=frame)

    def write(self, topic: str, receive_ns: int, message: Any) -> None:
        kind = message.__msgtype__
        if topic not in self._connections:
            self._connections[topic] = self._writer.add_connection(topic, kind, typestore=self.store)
        raw = (
            self.store.serialize_ros1(message, kind) if self.ros1 else self.store.serialize_cdr(message, kind)
        )
        self._writer.write(self._connections[topic], receive_ns, raw)

    def array(self, values: np.ndarray, kind: str = "std_msgs/msg/Float32MultiArray") -> Any:
        layout = self.make("std_msgs/msg/MultiArrayLayout", [], 0)
        dtype = {"Float32": np.float32, "Int16": np.int16}[kind.split("/")[-1].removesuffix("MultiArray")]
        return self.make(kind, layout, values.astype(dtype))

    def vector(self, values: np.ndarray, kind: str = "geometry_msgs/msg/Vector3") -> Any:
        return self.make(kind, *(float(value) for value in values))


def stamps(recording: Recorded, rate_hz: float) -> np.ndarray:
    """Times of a stream of its own rate over the recording [s]."""
    return np.arange(recording.time_s[0] - 0.05, recording.time_s[-1] + 0.05, 1 / rate_hz)


def at(recording: Recorded, times: np.ndarray, values: np.ndarray) -> np.ndarray:
    """Values of the recording at other times."""
    columns = values.reshape(len(values), -1).T
    return np.column_stack([np.interp(times, recording.time_s, column) for column in columns])


def write_bag(
    path: Path,
    recording: Recorded,
    storage: str = "sqlite3",
    skin: str = "Float32",
    force_from_s: float = -np.inf,
) -> Path:
    """The recording as ``BAG`` understands it; there is no force before ``force_from_s``."""
    with BagMaker(path, storage) as bag:
        for stamp, topic, message in sorted(_messages(bag, recording, skin), key=lambda item: item[0]):
            if topic != "/force" or stamp >= ns(force_from_s):
                bag.write(topic, stamp, message)
    return path


def _messages(bag: BagMaker, recording: Recorded, skin: str) -> list[tuple[int, str, Any]]:
    found: list[tuple[int, str, Any]] = []
    for time, image in zip(recording.time_s, recording.counts, strict=True):
        stamp = ns(time)
        found.append((stamp + SKIN_LATE_NS, "/skin", bag.array(image, f"std_msgs/msg/{skin}MultiArray")))
    times = stamps(recording, FORCE_RATE_HZ)
    for time, force in zip(times, at(recording, times, recording.force_n)[:, 0], strict=True):
        wrench = bag.make(
            "geometry_msgs/msg/Wrench", bag.vector(np.array([0.1, 0, -force])), bag.vector(np.zeros(3))
        )
        message = bag.make("geometry_msgs/msg/WrenchStamped", bag.header(ns(time)), wrench)
        found.append((ns(time) + 7_000_000, "/force", message))
    times = stamps(recording, TIP_RATE_HZ)
    nearest = np.abs(times[:, None] - recording.time_s).argmin(axis=1)
    for time, point in zip(times, recording.position_m[nearest], strict=True):
        place = bag.vector(point, "geometry_msgs/msg/Point")
        found.append(
            (ns(time), "/tip", bag.make("geometry_msgs/msg/PointStamped", bag.header(ns(time)), place))
        )
        names, angles = ["dist", "prox", "spare"], np.array([0.2, 0.1, 9.0])
        joints = bag.make(
            "sensor_msgs/msg/JointState", bag.header(ns(time)), names, angles, np.zeros(3), angles / 10
        )
        found.append((ns(time), "/joints", joints))
    return found


def ns(time_s: float) -> int:
    """A time of the recording as nanoseconds since 1970."""
    return EPOCH_NS + round(max(time_s, 0.0) * 1e9)
