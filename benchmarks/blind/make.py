"""Makes one session with something hidden in it, to look at by hand.

    python -m benchmarks.blind make --effect hysteresis --g 0.5 --law layer --seed 3 --open --out DIR

writes a dataset to DIR and its label beside the tables: ``label.json`` with ``--open``, else ``label.sealed``.
"""

from __future__ import annotations

import argparse
import json
import sys
from collections.abc import Sequence
from pathlib import Path

from benchmarks.blind.truth.body import LAWS
from benchmarks.blind.truth.catalogue import EFFECTS
from benchmarks.blind.truth.session import make_session
from benchmarks.blind.truth.spec import Spec
from benchmarks.blind.truth.writing import sealed, write_session

PROTOCOLS = ("full", "raster", "static")


def _parser() -> argparse.ArgumentParser:
    raw = argparse.RawDescriptionHelpFormatter
    parser = argparse.ArgumentParser(
        prog="python -m benchmarks.blind make", description=__doc__, formatter_class=raw
    )
    add = parser.add_argument
    add("--suite", default="one", help="part of the session's name and seed (default one)")
    add("--effect", action="append", default=[], choices=list(EFFECTS), help="to hide; may come twice")
    add("--g", action="append", default=[], type=float, help="strength of each effect (default 0.5)")
    add("--law", choices=(*LAWS, "half_space"), default="layer", help="of the contact (default layer)")
    add("--protocol", choices=PROTOCOLS, default="full", help="default full")
    add("--seed", type=int, default=0)
    add("--open", action="store_true", help="write the label for everyone to read")
    add("--out", type=Path, required=True, help="folder that is not there yet")
    return parser


def main(arguments: Sequence[str] | None = None) -> int:
    """Makes the session; returns the exit status."""
    parser = _parser()
    given = parser.parse_args(arguments)
    if given.out.exists():
        parser.error(f"--out: {given.out} is there already; give a folder that is not")
    strengths = given.g or [0.5]
    if len(strengths) not in (1, len(given.effect)) and given.effect:
        parser.error(
            f"--g: expected one, or one for each of {len(given.effect)} effects; got {len(strengths)}"
        )
    strengths = strengths if len(strengths) > 1 else strengths * len(given.effect)
    spec = Spec(
        given.suite,
        given.seed,
        0,
        given.law,
        given.protocol,
        tuple(zip(given.effect, strengths, strict=False)),
    )
    session = make_session(spec)
    write_session(session, given.out)
    if given.open:
        (given.out / "label.json").write_text(json.dumps(session.label, indent=1) + "\n", encoding="utf-8")
    else:
        content, digest = sealed(session.label)
        (given.out / "label.sealed").write_bytes(content)
        print(f"label sealed, SHA-256 {digest}", file=sys.stderr)
    print(given.out)
    return 0
