"""Opens the labels of a blind test that has been run, and says what was found of what was hidden.

    python -m benchmarks.blind score DIR... [--out benchmarks/results/blind.json] [--markdown TABLE.md] [--figures DIR]

A label that is not the one that was sealed before the diagnosis is refused. A test that is not whole is scored with
``--partial`` only: labels stay sealed until the run is over. Several tests, each with a seed of its own, are scored
together.
"""

from __future__ import annotations

import argparse
import json
import math
import sys
from collections import Counter
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from benchmarks.blind.figures import figures
from benchmarks.blind.markdown import as_markdown
from benchmarks.blind.measures import summary
from benchmarks.blind.outcome import Outcome, OutcomeError
from benchmarks.blind.suites import SUITES, specs
from benchmarks.blind.truth.writing import unsealed
from skincal.report.style import save

Record = dict[str, Any]


class ScoreError(RuntimeError):
    """The test cannot be scored."""


def opened(folder: Path) -> tuple[list[Outcome], list[Record]]:
    """Outcomes of the sessions that have a diagnosis, and the labels of those whose diagnosis failed.

    Raises:
        ScoreError: no results, or a label that is not the sealed one.
    """
    files = sorted((folder / "results").glob("*.json"))
    if not files:
        raise ScoreError(
            f"{folder / 'results'}: expected results of `python -m benchmarks.blind run`, found none"
        )
    outcomes, failed = list[Outcome](), list[Record]()
    for file in files:
        record = json.loads(file.read_text(encoding="utf-8"))
        label = _label(folder, record)
        done = record.get("diagnose", {"status": 1})
        if done["status"] != 0:
            failed.append(label)
            continue
        try:
            outcomes.append(
                Outcome.of(label, done["json"], done["wall_s"], done["cpu_s"], done.get("calibrated"))
            )
        except OutcomeError as error:
            print(error, file=sys.stderr)
            failed.append(label)
    return outcomes, failed


def _label(folder: Path, record: Record) -> Record:
    file = folder / "labels" / f"{record['session']}.sealed"
    try:
        return unsealed(file.read_bytes(), record["label_sha256"])
    except (OSError, ValueError) as error:
        raise ScoreError(f"{file}: {error}") from error


def missing(folder: Path) -> dict[str, int]:
    """Count the sessions without a result in each suite."""
    seed = json.loads((folder / "study.json").read_text(encoding="utf-8"))["seed"]
    done = {file.stem for file in (folder / "results").glob("*.json")}
    counts = {suite: sum(spec.name not in done for spec in specs(suite, seed)) for suite in SUITES}
    return {suite: count for suite, count in counts.items() if count}


def scored(folders: Sequence[Path]) -> Record:
    """The whole score of one test, or of several together, with every session's label and what was said of it."""
    outcomes, failed, lines = list[Outcome](), list[Record](), list[Record]()
    studies, left = list[Record](), Counter[str]()
    for folder in folders:
        own, wrong = opened(folder)
        studies.append(json.loads((folder / "study.json").read_text(encoding="utf-8")))
        left.update(missing(folder))
        said = [_line(o) for o in own] + [{"session": f["session"], "failed": True} for f in wrong]
        lines += said if len(folders) == 1 else [{"seed": studies[-1]["seed"], **line} for line in said]
        outcomes += own
        failed += wrong
    seeds = [study["seed"] for study in studies]
    if len(set(seeds)) < len(seeds):
        raise ScoreError(f"expected tests of different seeds; got {seeds}: sessions would count twice")
    return _strict(
        {
            "study": studies[0] if len(studies) == 1 else {"runs": studies},
            "missing": dict(left),
            "suites": summary(outcomes, failed),
            "sessions": lines,
        }
    )


def _line(o: Outcome) -> Record:
    hidden = [[e["name"], round(e["strength_g"], 3)] for e in o.label["effects"]]
    return {
        "session": o.label["session"],
        "law": o.label["contact_law"],
        "hidden": hidden,
        "extra": o.label["decoy"] or o.label["outside"] or o.label["protocol"],
        "verdict": o.verdict,
        "named": [[e.name, sorted(e.consistent_with)] for e in o.named],
        "closed": o.gap.get("closed"),
    }


def _strict(value: Any) -> Any:
    """The same with None for numbers that JSON does not have."""
    if isinstance(value, dict):
        return {key: _strict(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [_strict(item) for item in value]
    return None if isinstance(value, float) and not math.isfinite(value) else value


def _parser() -> argparse.ArgumentParser:
    raw = argparse.RawDescriptionHelpFormatter
    parser = argparse.ArgumentParser(
        prog="python -m benchmarks.blind score", description=__doc__, formatter_class=raw
    )
    add = parser.add_argument
    add(
        "folders",
        type=Path,
        nargs="+",
        metavar="DIR",
        help="what `run --out` wrote; several are scored together",
    )
    add("--out", type=Path, help="file for the score (JSON)")
    add("--markdown", type=Path, help="file for the tables; else they are printed")
    add("--figures", type=Path, help="folder for pictures of power and confusion (PNG)")
    add("--partial", action="store_true", help="open the labels of a test that is not whole")
    return parser


def main(arguments: Sequence[str] | None = None) -> int:
    """Scores a test; returns the exit status."""
    given = _parser().parse_args(arguments)
    try:
        for folder in given.folders:
            if not (folder / "study.json").exists():
                raise ScoreError(f"{folder}: expected a folder that `python -m benchmarks.blind run` wrote")
            if (left := missing(folder)) and not given.partial:
                counts = ", ".join(f"{suite} {count}" for suite, count in left.items())
                raise ScoreError(f"{folder}: not run yet: {counts}; run the rest, or give --partial")
        found = scored(given.folders)
    except ScoreError as error:
        print(error, file=sys.stderr)
        return 2
    if given.out:
        given.out.write_text(json.dumps(found, indent=1) + "\n", encoding="utf-8")
    if given.figures:
        given.figures.mkdir(parents=True, exist_ok=True)
        for name, figure in figures(found["suites"]).items():
            save(figure, given.figures / f"{name}.png")
    text = as_markdown(found["suites"])
    if given.markdown:
        given.markdown.write_text(text, encoding="utf-8")
    else:
        print(text)
    return 0
