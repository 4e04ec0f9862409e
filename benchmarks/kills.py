"""Kills every verb that writes at each of its write events, and looks at what is left.

    python benchmarks/kills.py [--verb NAME ...] [--out runs/kills]

Of each verb an input, a new output and one that replaces an earlier one (see ``tests/killing.py``): after a kill
inputs are as they were, the output is whole, the old one or absent, and the verb, run again, comes to the same. The
count goes on where an earlier call ended, in ``progress.json``.
"""

from __future__ import annotations

import argparse
import json
import sys
import time
from pathlib import Path
from tempfile import TemporaryDirectory

sys.path.insert(0, str(Path(__file__).parents[1]))
sys.path.insert(1, str(Path(__file__).parents[1] / "tests"))
sys.path.insert(2, str(Path(__file__).parents[1] / "tests" / "train"))

from tests.files.test_kills import CASES, VERBS, make_study


def main() -> None:
    """Runs the command."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--verb", action="append", choices=list(VERBS), help="this one only")
    parser.add_argument("--out", type=Path, default=Path("runs/kills"))
    arguments = parser.parse_args()
    arguments.out.mkdir(parents=True, exist_ok=True)
    file = arguments.out / "progress.json"
    done: dict[str, dict[str, int]] = json.loads(file.read_text()) if file.is_file() else {}
    for verb, way in CASES:
        name = f"{verb}, {way}"
        if arguments.verb and verb not in arguments.verb:
            continue
        kept = done.setdefault(name, {"events": -1, "kills": 0})
        if kept["kills"] == kept["events"]:
            continue
        with TemporaryDirectory(prefix="kills-") as scratch:
            begun = time.monotonic()
            study = make_study(Path(scratch), verb, way)
            if kept["events"] not in (-1, study.events):
                kept["kills"] = 0  # of other code
            kept["events"] = study.events
            print(f"{name}: {study.events} events, {time.monotonic() - begun:.0f} s", flush=True)
            for at in range(kept["kills"] + 1, study.events + 1):
                study.kill(at)
                kept["kills"] = at
                file.with_suffix(".part").write_text(json.dumps(done, indent=1))
                file.with_suffix(".part").replace(file)
            print(f"{name}: {study.events} kills, {time.monotonic() - begun:.0f} s", flush=True)
    print(f"{sum(one['kills'] for one in done.values())} kills; nothing was lost")


if __name__ == "__main__":
    main()
