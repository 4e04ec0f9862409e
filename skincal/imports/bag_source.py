"""Reader of ROS bags: a recording with every stream on the clock of the taxels' topic."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from skincal.bounded import UnreadableError
from skincal.dataset.findings import Findings
from skincal.errors import InputError, Problem
from skincal.imports import targets
from skincal.imports.apart import apart
from skincal.imports.assembly import beside
from skincal.imports.bag_file import check_topics, opened
from skincal.imports.csv_source import joined
from skincal.imports.mapping import BagFormat, Mapping, Quantity
from skincal.imports.recording import Column, Dropped, FloatArray, ReadFile, Recording
from skincal.imports.resample import resampled
from skincal.imports.streams import Collector, Stream
from skincal.imports.values import constant, length


def read_bags(mapping: Mapping, bags: Sequence[Path], findings: Findings) -> Recording | None:
    """Read bags by a mapping.

    Args:
        mapping: the mapping.
        bags: the bags, in the order of the session.
        findings: collects the errors.

    Returns:
        One row per message of the taxels' topic; None, with errors added, if something is wrong.

    Raises:
        InputError: a bag cannot be opened.
        WorkError: the library rosbags is not installed.
    """
    collected: list[Collector] = []
    for path in bags:
        collector, errors = _collected(path, mapping)
        collected.append(collector)
        findings.errors.extend(errors)
    if findings.errors:
        return None
    stamps = [collector.streams[mapping.taxels.topic].stamps_ns for collector in collected]
    for path, found in zip(bags, stamps, strict=True):
        if not found:
            findings.error(f"{path}, {mapping.taxels.topic}", "at least one message", "none that can be used")
    joints = {collector.joints for collector in collected}
    if len(joints) > 1:
        findings.error("[joints]", "the same joints in every bag", "others", "Name them in [joints].")
    if findings.errors:
        return None
    zero = min(min(found) for found in stamps)
    parts = [
        _recording(mapping, i, path.name, collector, zero)
        for i, (path, collector) in enumerate(zip(bags, collected, strict=True))
    ]
    _check_left(mapping, parts, findings)
    return None if findings.errors else joined(parts)


def _collected(path: Path, mapping: Mapping) -> tuple[Collector, list[Problem]]:
    """What a bag holds of what a mapping asks for, and what is wrong with it.

    Raises:
        InputError: it cannot be opened.
        WorkError: the library rosbags is not installed.
    """
    try:
        return apart(collect, path, mapping)
    except UnreadableError as error:
        raise InputError([Problem(str(path), error.expected, error.got, "Was it cut short?")]) from None


def collect(path: Path, mapping: Mapping) -> tuple[Collector, list[Problem]]:
    """Do as :func:`_collected` says, in this process."""
    form = mapping.source
    assert isinstance(form, BagFormat)
    findings = Findings()
    collector = Collector(mapping, findings)
    definitions = {
        name: beside(mapping, file, f"the definition of {name}") for name, file in form.definitions.items()
    }
    with opened(path, definitions) as bag:
        if check_topics(bag, collector.places, findings):
            _read_messages(bag.messages(set(collector.places)), collector, findings)
    return collector, findings.errors


def _read_messages(
    messages: Iterable[tuple[str, int, Any]], collector: Collector, findings: Findings
) -> None:
    try:
        for topic, stamp_ns, message in messages:
            collector.take(topic, stamp_ns, message)
    except InputError as error:
        findings.errors.extend(error.problems)


def _recording(mapping: Mapping, part: int, file: str, collector: Collector, zero_ns: int) -> Recording:
    """Return one bag, without samples of the taxels that have no force or position at their time."""
    taxels = collector.streams[mapping.taxels.topic]
    time = taxels.times_s(zero_ns)
    order = np.argsort(time, kind="stable")
    time = time[order]
    images = np.array(taxels.samples[mapping.taxels.field], dtype=np.float64)[order]
    columns: dict[str, Column] = {"time_s": time}
    for quantity in mapping.quantities:
        columns[quantity.target] = _values(quantity, collector, zero_ns, time)
    form = mapping.source
    assert isinstance(form, BagFormat)
    if form.joints_topic:
        stream = collector.streams[form.joints_topic]
        for name in sorted(
            stream.samples, key=lambda name: (name.split("_")[0] != "q", int(name.split("_")[1]))
        ):
            if name[0] in "qt" and np.isfinite(np.array(stream.samples[name], dtype=np.float64)).any():
                columns[name] = _resampled(stream, stream.samples[name], zero_ns, time)
    recording = Recording(
        columns,
        mapping.taxels.counts(images),
        np.full(len(time), part, dtype=np.int64),
        (ReadFile(file, len(time)),),
    )
    return _with_force(recording, mapping)


def _values(quantity: Quantity, collector: Collector, zero_ns: int, onto_s: FloatArray) -> Column:
    if quantity.constant is not None:
        return constant(quantity.constant, len(onto_s))
    stream = collector.streams[quantity.topic]
    samples = [stream.samples.get(path, []) for path in quantity.sources]
    if targets.is_text(quantity.target):
        words = [quantity.words.get(word, word) for word in samples[0]]
        return _words(stream, words, zero_ns, onto_s)
    parts = [_resampled(stream, found, zero_ns, onto_s, quantity.target) for found in samples]
    return quantity.si(parts[0]) if len(parts) == 1 else length([quantity.si(values) for values in parts])


def _resampled(
    stream: Stream, samples: list[float], zero_ns: int, onto_s: FloatArray, target: str = ""
) -> FloatArray:
    time = stream.times_s(zero_ns)
    order = np.argsort(time, kind="stable")
    rules = stream.rules
    if targets.is_whole(target):
        # A value between press 3 and press 4 belongs to neither.
        rules = type(rules)(rules.clock, "previous", rules.max_age_s, rules.lag_s)
    return resampled(time[order], np.array(samples, dtype=np.float64)[order], onto_s, rules)


def _words(stream: Stream, words: list[str], zero_ns: int, onto_s: FloatArray) -> Column:
    known = [*dict.fromkeys(words)]
    codes = _resampled(stream, [known.index(word) for word in words], zero_ns, onto_s, "press")
    return np.array(["" if np.isnan(code) else known[int(code)] for code in codes], dtype=object)


def _with_force(recording: Recording, mapping: Mapping) -> Recording:
    needed = targets.required_targets("series", positions=np.isfinite(mapping.meta.position.sigma_m))
    kept = np.ones(len(recording), dtype=bool)
    dropped: list[Dropped] = []
    for target in needed:
        missing = np.isnan(recording.columns[target]) & kept
        if missing.any():
            dropped.append(Dropped(int(missing.sum()), "frame", _why(target, mapping)))
            kept &= ~missing
    return recording if kept.all() else recording.select(kept, tuple(dropped))


def _why(target: str, mapping: Mapping) -> str:
    quantity, form = mapping.quantity(target), mapping.source
    assert quantity is not None and isinstance(form, BagFormat)
    return f"no {target} from {quantity.topic} within {form.rules(quantity.topic).max_age_s:g} s (max_age_s)"


def _check_left(mapping: Mapping, parts: Sequence[Recording], findings: Findings) -> None:
    """Add an error for a bag whose streams never meet, most often because of two clocks."""
    for recording in parts:
        if len(recording):
            continue
        got = "; ".join(str(item) for item in recording.dropped)
        fix = "Do the streams overlap in time, and are their clocks the same? See clock, lag_s and max_age_s."
        findings.error(recording.files[0].file, "frames with taxels, force and position", f"none: {got}", fix)
