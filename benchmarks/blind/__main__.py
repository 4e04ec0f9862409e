"""``python -m benchmarks.blind make|run|score|held|pack|unpack``; each has ``--help``."""

from __future__ import annotations

import importlib
import sys
from collections.abc import Sequence

from benchmarks.blind import kept

VERBS = ("make", "run", "score", "held", "pack", "unpack")


def main(arguments: Sequence[str] | None = None) -> int:
    """Runs a verb; returns the exit status."""
    given = list(sys.argv[1:] if arguments is None else arguments)
    if not given or given[0] not in VERBS:
        print(f"usage: python -m benchmarks.blind {{{','.join(VERBS)}}} [--help]", file=sys.stderr)
        return 0 if given[:1] in (["-h"], ["--help"]) else 2
    if given[0] in ("pack", "unpack"):
        return kept.main(given[0], given[1:])
    module = importlib.import_module(f"benchmarks.blind.{given[0]}")
    return int(module.main(given[1:]))


if __name__ == "__main__":
    sys.exit(main())
