"""Reader of ROS bags: the values that a mapping takes from each topic, all on the clock of the taxels' topic."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import Any, Final

import numpy as np
from numpy.typing import DTypeLike, NDArray

from skincal.bounded import UnreadableError
from skincal.dataset.findings import Findings
from skincal.errors import InputError, Problem, input_error
from skincal.imports import bag_file, targets
from skincal.imports.apart import apart
from skincal.imports.clock import resampled
from skincal.imports.mapping import Mapping, Quantity
from skincal.imports.mapping_file import BagMapping, BagTaxels, TopicRules
from skincal.imports.recording import Column, FloatArray, ReadFile, Recording, joined


def read_bags(mapping: Mapping, bags: Sequence[Path], findings: Findings) -> Recording:
    """Return bags, in the order of the session, with one row per message of the taxels' topic.

    Raises:
        InputError: a bag cannot be opened, or does not hold what the mapping needs.
        WorkError: the library rosbags is not installed.
    """
    collected: list[Collector] = []
    for path in bags:
        try:
            # The library may crash on a damaged file.
            collector, errors = apart(collect, path, mapping)
        except UnreadableError as error:
            raise input_error(str(path), error.expected, error.got, "Was it cut short?") from None
        collected.append(collector)
        findings.errors.extend(errors)
    findings.raise_errors()
    assert isinstance(mapping.file, BagMapping)
    topic = mapping.file.taxels.topic
    stamps = [collector.streams[topic].stamps_ns for collector in collected]
    for path, found in zip(bags, stamps, strict=True):
        if not found:
            findings.error(f"{path}, {topic}", "at least one message", "none that can be used")
    if len({collector.joints for collector in collected}) > 1:
        findings.error("[joints]", "the same joints in every bag", "others", "Name them in [joints].")
    findings.raise_errors()
    zero = min(min(found) for found in stamps)
    parts = [
        _recording(mapping, mapping.file, i, path.name, collector, zero)
        for i, (path, collector) in enumerate(zip(bags, collected, strict=True))
    ]
    for recording in (one for one in parts if not len(one)):  # most often because of two clocks
        got = f"none: {'; '.join(map(str, recording.dropped))}"
        fix = "Do the streams overlap in time, and are their clocks the same? See clock, lag_s and max_age_s."
        findings.error(recording.files[0].file, "frames with taxels, force and position", got, fix)
    findings.raise_errors()
    return joined(parts)


def collect(path: Path, mapping: Mapping) -> tuple[Collector, list[Problem]]:
    """Return the content of a bag that a mapping needs, and the problems; raise as :func:`read_bags`."""
    assert isinstance(mapping.file, BagMapping)
    findings = Findings()
    collector, named = Collector(mapping, findings), mapping.file.bag.definitions
    definitions = {
        name: mapping.resolve_file(one, f"the definition of {name}") for name, one in named.items()
    }
    with bag_file.opened(path, definitions) as bag:
        if bag_file.check_topics(bag, collector.places, findings):
            try:
                for topic, stamp_ns, message in bag.messages(set(collector.places)):
                    collector.take(topic, stamp_ns, message)
            except InputError as error:
                findings.errors.extend(error.problems)
    return collector, findings.errors


def _recording(
    mapping: Mapping, file: BagMapping, part: int, name: str, collector: Collector, zero_ns: int
) -> Recording:
    """Return one bag, without samples of the taxels that have no force or position at their time."""
    time, images = collector.streams[file.taxels.topic].ordered(file.taxels.field, zero_ns)
    columns: dict[str, Column] = {"time_s": time}

    def take(quantity: Quantity, path: str, dtype: DTypeLike) -> Column:
        stream = collector.streams[quantity.topic]
        method, age_s = quantity.resampling(stream.rules.resample), stream.rules.max_age_s
        return resampled(*stream.ordered(path, zero_ns, dtype), time, method, age_s)

    for quantity in mapping.quantities:
        words, numbers = (partial(take, quantity, dtype=dtype) for dtype in (object, np.float64))
        columns[quantity.target] = quantity.column(len(time), words, numbers)
    if file.joints is not None:
        stream = collector.streams[file.joints.topic]
        joints = [one for one in stream.samples if one[0] in "qt"]
        for one in sorted(joints, key=lambda one: (one[0] != "q", int(one.split("_")[1]))):
            times, values = stream.ordered(one, zero_ns)
            if np.isfinite(values).any():
                columns[one] = resampled(times, values, time, stream.rules.resample, stream.rules.max_age_s)
    read = (ReadFile(name, len(time)),)
    rows = np.arange(len(time))
    recording = Recording(columns, mapping.taxels.counts(images), np.full(len(time), part), rows, read)
    needed = [q for q in mapping.quantities if q.target in mapping.required]
    ages = {q.topic: f"{q.topic} within {file.rules(q.topic).max_age_s:g} s (max_age_s)" for q in needed}
    missing = {f"no {q.target} from {ages[q.topic]}": np.isnan(columns[q.target]) for q in needed}
    return recording.without("frame", missing)


@dataclass
class Stream:
    """Samples of one topic while they are read, by field path or joint: one per message, with its stamp [ns]."""

    topic: str
    rules: TopicRules
    stamps_ns: list[int] = field(default_factory=list[int])
    samples: dict[str, list[Any]] = field(default_factory=dict[str, list[Any]])

    def ordered(
        self, path: str, zero_ns: int, dtype: DTypeLike = np.float64
    ) -> tuple[FloatArray, NDArray[Any]]:
        """Return the ascending times since ``zero_ns``, without the lag [s], and the samples of a path at them."""
        # Subtract whole nanoseconds first: seconds since 1970 would lose the last digits.
        passed = np.array([stamp - zero_ns for stamp in self.stamps_ns], dtype=np.float64)
        time = passed * 1e-9 - self.rules.lag_s
        order = np.argsort(time, kind="stable")
        return time[order], np.array(self.samples.get(path, []), dtype=dtype)[order]


_KINDS: Final[dict[str, tuple[Callable[[Any, Sequence[bag_file.Step]], Any], str]]] = {
    "array": (bag_file.array_at, "an array of numbers"),
    "number": (bag_file.number_at, "a number"),
    "text": (lambda message, steps: str(bag_file.value_at(message, steps)), "a word"),
}
"""What reads a value of each kind, and what an error expects."""


class Collector:
    """Collector of the samples of all topics in a mapping."""

    def __init__(self, mapping: Mapping, findings: Findings) -> None:
        file = mapping.file
        assert isinstance(file, BagMapping) and isinstance(file.taxels, BagTaxels)
        self._joints_topic = "" if file.joints is None else file.joints.topic
        self._findings = findings
        self._reported: set[str] = set()
        self._taxels = mapping.taxels
        self._readers: dict[str, list[tuple[str, str, tuple[bag_file.Step, ...], str]]] = {}
        self.joints = () if file.joints is None else file.joints.names
        """Names of the joints: those of the mapping, or of the first message."""
        self.places = {q.topic: q.place for q in mapping.quantities if q.topic}
        self.places[file.taxels.topic] = self._taxels.place
        if self._joints_topic:
            self.places[self._joints_topic] = f"{mapping.path.name}, [joints]"
        self.streams = {topic: Stream(topic, file.rules(topic)) for topic in self.places}
        self._add(file.taxels.topic, file.taxels.field, self._taxels.place, "array")
        for quantity in mapping.quantities:
            for path in quantity.sources:
                kind = "text" if targets.is_text(quantity.target) else "number"
                self._add(quantity.topic, path, quantity.place, kind)

    def take(self, topic: str, receive_ns: int, message: Any) -> None:
        """Add one message."""
        stream = self.streams[topic]
        sample: dict[str, Any] = {}
        try:
            for path, place, steps, kind in self._readers.get(topic, []):
                sample[path] = self._read(path, place, steps, kind, message)
            if topic == self._joints_topic:
                sample |= self._joint_values(message)
        except bag_file.NotHereError:
            return
        stamp_ns = self._header_ns(topic, message) if stream.rules.clock == "header" else receive_ns
        if stamp_ns is None:
            return
        stream.stamps_ns.append(stamp_ns)
        for path, value in sample.items():
            stream.samples.setdefault(path, []).append(value)

    def _add(self, topic: str, path: str, place: str, kind: str) -> None:
        try:
            steps = bag_file.parse_path(path)
        except bag_file.FieldError as error:
            self._report(place, "a path like wrench.force.z", f'"{path}": {error}')
            return
        self._readers.setdefault(topic, []).append((path, place, steps, kind))

    def _read(self, path: str, place: str, steps: tuple[bag_file.Step, ...], kind: str, message: Any) -> Any:
        read, expected = _KINDS[kind]
        try:
            values = read(message, steps)
        except bag_file.FieldError as error:
            self._report(f"{place} field", f"{expected} at {path}", str(error))
            raise bag_file.NotHereError from error
        if kind != "array":
            return values
        fewest = max(self._taxels.order) + 1
        if len(values) < fewest:
            self._report(f"{place} field", f"an array of {fewest} values or more", f"{len(values)} values")
            raise bag_file.NotHereError
        return values

    def _header_ns(self, topic: str, message: Any) -> int | None:
        """Return the stamp of a message, or of the element that a path selects [ns]; None, reported, without one."""
        holders = [message]
        for _, _, steps, _ in self._readers.get(topic, []):
            with suppress(bag_file.FieldError, bag_file.NotHereError):
                holders.append(bag_file.value_at(message, steps[:1]))
        stamp = next((one.header.stamp for one in holders if hasattr(one, "header")), None)
        if stamp is not None and (stamp.sec or stamp.nanosec):
            return int(stamp.sec) * 10**9 + int(stamp.nanosec)
        no_header = (f"messages with a header on {topic}", "none")
        expected, got = no_header if stamp is None else (f"stamps in the headers of {topic}", "0")
        fix = f'Set clock = "receive" in [topics."{topic}"], and lag_s if its delay is known.'
        self._report(self.places[topic], expected, got, fix)
        return None

    def _joint_values(self, message: Any) -> dict[str, float]:
        if not all(hasattr(message, name) for name in ("name", "position", "effort")):
            place, got = self.places[self._joints_topic], getattr(message, "__msgtype__", "another")
            self._report(place, "sensor_msgs/JointState", got)
            raise bag_file.NotHereError
        names = list(message.name)
        self.joints = self.joints or tuple(names)
        if not set(self.joints) & set(names):
            # Several nodes may publish the states of different joints on one topic.
            raise bag_file.NotHereError
        values: dict[str, float] = {}
        for i, name in enumerate(self.joints):
            at = names.index(name) if name in names else len(message.position)
            values[f"q_{i}"] = float(message.position[at]) if at < len(message.position) else np.nan
            values[f"tau_{i}"] = float(message.effort[at]) if at < len(message.effort) else np.nan
        return values

    def _report(self, place: str, expected: str, got: str, fix: str = "") -> None:
        if place + expected not in self._reported:
            self._reported.add(place + expected)
            self._findings.error(place, expected, got, fix)
