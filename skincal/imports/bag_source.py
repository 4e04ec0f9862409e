"""Reader of ROS bags: a recording with every stream on the clock of the taxels' topic."""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial
from pathlib import Path

import numpy as np
from numpy.typing import DTypeLike

from skincal.bounded import UnreadableError
from skincal.dataset.findings import Findings
from skincal.errors import InputError, Problem, input_error
from skincal.imports.apart import apart
from skincal.imports.bag_file import check_topics, opened
from skincal.imports.clock import resampled
from skincal.imports.mapping import Mapping, Quantity
from skincal.imports.mapping_file import BagMapping
from skincal.imports.recording import Column, ReadFile, Recording, joined
from skincal.imports.streams import Collector


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
    with opened(path, definitions) as bag:
        if check_topics(bag, collector.places, findings):
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
    recording = Recording(
        columns, mapping.taxels.counts(images), np.full(len(time), part), (ReadFile(name, len(time)),)
    )
    needed = [q for q in mapping.quantities if q.target in mapping.required]
    ages = {q.topic: f"{q.topic} within {file.rules(q.topic).max_age_s:g} s (max_age_s)" for q in needed}
    missing = {f"no {q.target} from {ages[q.topic]}": np.isnan(columns[q.target]) for q in needed}
    return recording.without("frame", missing)
