"""The score of the blind test as tables in Markdown."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from benchmarks.blind.suites import CLASSES, SIZES

Record = dict[str, Any]

_ROWS: Sequence[tuple[str, str, str, str]] = (
    ("none", "nothing hidden, elastic layer", "false alarms", "false_alarms"),
    ("none", "", "an effect named", "wrong_names"),
    ("none", "", "an effect scores, p ≤ 0.01", "scores"),
    ("decoy", "decoys", "false alarms", "false_alarms"),
    ("decoy", "", "an effect named", "wrong_names"),
    ("decoy", "", "an effect scores, p ≤ 0.01", "scores"),
    ("one", "one effect", "right class, g ≥ 0.4", "right_class_strong"),
    ("one", "", "right class, g 0.2 to 0.4", "right_class_weak"),
    ("one", "", "exact name where it can be told", "exact_name_where_it_can_be_told"),
    ("one", "", "truth in the reported set, where one is named", "truth_in_set_where_named"),
    ("one", "", "the same of all sessions", "truth_in_set_of_all"),
    ("one", "", "mean size of the set", "set_size"),
    ("two", "two effects", "both", "both"),
    ("two", "", "at least one", "at_least_one"),
    ("two", "", "spurious third", "spurious_third"),
    ("outside", "outside the catalogue", "unknown", "unknown"),
    ("outside", "", "confidently wrong", "confidently_wrong"),
    ("poor", "poor data", "abstains or names the class", "abstains_or_names_the_class"),
    ("robust", "faults of sensor or rig", "as expected", "as_expected"),
    *(
        row
        for suite, name in (
            ("rest", "rest anywhere, coarse counts, noise that grows"),
            ("third", "half space"),
        )
        for row in (
            (suite, name, "an effect named, nothing hidden", "wrong_names"),
            (suite, "", "unknown, nothing hidden", "unknown_though_empty"),
            (suite, "", "right class, g ≥ 0.4", "right_class_strong"),
            (suite, "", "right class, g 0.2 to 0.4", "right_class_weak"),
        )
    ),
)


def as_markdown(suites: Record) -> str:
    """All tables."""
    return "\n\n".join(sections(suites).values()) + "\n"


def sections(suites: Record) -> dict[str, str]:
    """The tables of what was run, by name: overview, power, gap, effects, confusion, kinds, seconds."""
    found = {"overview": _overview(suites)}
    if "one" in suites:
        one = suites["one"]
        found["power"] = _power(one["power"])
        found["gap"] = _gap(one["gap_by_strength"])
        found["effects"] = _effects(one["by_effect"])
        found["confusion"] = _confusion(one["confusion"])
    if "outside" in suites:
        found["kinds"] = _kinds("kind outside the catalogue: unknown", suites["outside"]["by_kind"])
    if "seconds" in suites:
        times = suites["seconds"]
        found["seconds"] = (
            f"A diagnosis took {times['wall_median']:.0f} s (median; processor {times['cpu_median']:.0f} s), "
            f"at most {times['wall_largest']:.0f} s."
        )
    return found


def _overview(suites: Record) -> str:
    rows: list[list[str]] = []
    for suite, name, measure, key in _ROWS:
        if suite in suites:
            rows.append([name, measure, *_cells(suites[suite][key], whole=_whole(suites, suite))])
    if "one" in suites and suites["one"]["gap_closed"]["of"]:
        gap, strong = suites["one"]["gap_closed"], suites["one"]["gap_closed_strong"]
        whole = _whole(suites, "one")
        rows.append(["gap closed, held-out presses", "median", *_cells(gap["median"], whole=whole)])
        rows.append(["", "10th percentile", *_cells(gap["percentile_10"], whole=whole)])
        if strong["of"]:
            value = f"{strong['percentile_10']['value']:.2f}"
            rows.append(["", "the same at g ≥ 0.4, without `contact_offset`", value, "", "", ""])
    return _table(["suite", "measure", "found", "95 %", "asked", "reached"], rows)


def _whole(suites: Record, suite: str) -> bool:
    """Return True if a suite has as many sessions as the whole test."""
    return suites[suite].get("sessions", 0) >= SIZES[suite]


def _cells(measure: Record, *, whole: bool) -> list[str]:
    """Found, interval, asked, reached."""
    yes = "yes" if whole else "so far"
    reached = {True: yes, False: "**no**", None: ""}[measure.get("reached")]
    asked = measure.get("asked", "").replace(">=", "≥").replace("<=", "≤")
    if "of" in measure:
        return [_share(measure), _interval(measure), asked, reached]
    value = measure["value"]
    return ["" if value is None else f"{value:.2f}", "", asked, reached]


def _share(share: Record) -> str:
    if not share["of"]:
        return "no session"
    return f"{100 * share['share']:.0f} % ({share['hits']} of {share['of']})"


def _interval(share: Record) -> str:
    low, high = share["interval_95"]
    return f"{100 * low:.0f} to {100 * high:.0f} %" if share["of"] else ""


def _power(bins: Sequence[Record]) -> str:
    keys = ("detected", "right_class", "truth_in_set", "exact_name")
    rows = [
        [_bin(entry), *(f"{_share(entry[key])}, {_interval(entry[key])}" for key in keys)] for entry in bins
    ]
    return _table(["g", "detected", "right class", "truth in set", "exact name"], rows)


def _gap(bins: Sequence[Record]) -> str:
    laws = sorted({law for entry in bins for law in entry["by_law"]})
    rows: list[list[str]] = []
    for entry in bins:
        own = [entry["all"], *(entry["by_law"].get(law, {"of": 0}) for law in laws)]
        rows.append([_bin(entry), *map(_closed, own)])
    head = ["gap closed where named, without `contact_offset`: median, 10th percentile; g", "all", *laws]
    return _table(head, rows)


def _closed(gap: Record) -> str:
    if not gap["of"]:
        return ""
    return f"{gap['median']['value']:.2f}, {gap['percentile_10']['value']:.2f} ({gap['of']} sessions)"


def _bin(entry: Record) -> str:
    low, high = entry["g"]
    return f"{low:g} to {high:g}" if high is not None else f"above {low:g}"


def _effects(effects: Record) -> str:
    rows: list[list[str]] = []
    for name, found in effects.items():
        size, gap = found["set_size"], found["gap_closed"]
        rows.append(
            [
                f"`{name}`",
                _share(found["right_class"]),
                _share(found["right_class_strong"]),
                _share(found["exact_name"]),
                _share(found["truth_in_set"]),
                "" if size is None else f"{size:.1f}",
                f"{gap['median']['value']:.2f}" if gap["of"] else "",
            ]
        )
    head = [
        "hidden",
        "right class",
        "at g ≥ 0.4",
        "exact name",
        "truth in set",
        "set size",
        "gap closed, median",
    ]
    return _table(head, rows)


def _confusion(rows: Record) -> str:
    """Rows: hidden; columns: what was named first, in the order of the classes."""
    order = [name for names in CLASSES.values() for name in names]
    columns = [c for c in (*order, "none", "unknown") if any(c in row for row in rows.values())]
    body = [[f"`{name}`", *(str(row.get(c, "")) for c in columns)] for name, row in rows.items()]
    return _table(["hidden \\ named", *columns], body)


def _kinds(title: str, kinds: Record) -> str:
    rows = [[f"`{kind}`", _share(share), _interval(share)] for kind, share in kinds.items()]
    return _table([title, "found", "95 %"], rows)


def _table(head: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    lines = [list(head), ["---"] * len(head), *(list(row) for row in rows)]
    return "\n".join(f"| {' | '.join(line)} |" for line in lines)
