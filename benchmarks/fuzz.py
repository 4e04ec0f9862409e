"""Damages valid inputs of every reader and looks what it makes of them.

    python benchmarks/fuzz.py [--inputs 1000000] [--seed 0] [--out runs/fuzz] [--reader NAME] [--coverage]

A reader may accept an input, or refuse it with an error that names the file. Anything else is a fault: another
exception, more than 10 s, more than 4 GiB. Each is kept under ``faults/`` with its input and traceback. The count goes
on where an earlier call ended, in ``progress.json``. ``--coverage`` lets atheris guide the damage by the lines that it
reaches (``pip install atheris``), for one reader.
"""

from __future__ import annotations

import argparse
import gc
import hashlib
import json
import random
import resource
import signal
import sys
import time
import traceback
import warnings
from collections import Counter
from contextlib import ExitStack
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING, Any

sys.path.insert(0, str(Path(__file__).parents[1]))
sys.path.insert(1, str(Path(__file__).parents[1] / "tests"))

if TYPE_CHECKING:
    from benchmarks.fuzz_readers import Reader

LIMIT_S, LIMIT_BYTES = 10, 4 << 30
BATCH = 200
"""Inputs of one reader in a row; so many are counted at once."""


class SlowError(Exception):
    """A reader that took too long."""


def _too_long(*_: Any) -> None:
    raise SlowError(f"more than {LIMIT_S} s")


def run_one(reader: Reader, folder: Path, name: str, content: bytes) -> str | None:
    """The traceback of a fault; None where there is none."""
    signal.setitimer(signal.ITIMER_REAL, LIMIT_S)
    try:
        reader.attack(folder, name, content)
    except BaseException as error:
        if isinstance(error, KeyboardInterrupt):
            raise
        return traceback.format_exc()
    finally:
        signal.setitimer(signal.ITIMER_REAL, 0)
    return None


def kind_of(trace: str) -> str:
    """Return the key of a fault: its exception, and the last line of skincal in its traceback."""
    own = [line.strip() for line in trace.splitlines() if "/skincal/" in line]
    kind = trace.strip().splitlines()[-1].partition(":")[0]
    return f"{kind} at {own[-1].split('/skincal/')[-1] if own else '?'}"


def keep_fault(out: Path, reader: Reader, name: str, content: bytes, trace: str) -> None:
    """Keeps an input that a reader failed on, one of a kind."""
    digest = hashlib.sha256(f"{reader.name} {kind_of(trace)}".encode()).hexdigest()[:12]
    folder = out / "faults" / digest
    if not folder.exists():
        folder.mkdir(parents=True)
        (folder / Path(name).name).write_bytes(content)
        (folder / "fault.txt").write_text(f"{reader.name}, {name}\n{kind_of(trace)}\n\n{trace}")
        print(f"fault: {reader.name}, {name}: {kind_of(trace)}", flush=True)


def main() -> None:
    """Runs the command."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--inputs", type=int, default=1_000_000)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--out", type=Path, default=Path("runs/fuzz"))
    parser.add_argument("--reader", help="one reader only")
    parser.add_argument("--coverage", action="store_true", help="guided by atheris; needs --reader")
    arguments = parser.parse_args()
    warnings.simplefilter("ignore")
    signal.signal(signal.SIGALRM, _too_long)
    resource.setrlimit(resource.RLIMIT_AS, (LIMIT_BYTES, LIMIT_BYTES))
    chosen = load(coverage=arguments.coverage)
    if arguments.reader:
        chosen = {arguments.reader: chosen[arguments.reader]}
    arguments.out.mkdir(parents=True, exist_ok=True)
    if arguments.coverage:
        guided(arguments, *chosen.values())
    else:
        unguided(arguments, list(chosen.values()))


def load(*, coverage: bool) -> dict[str, Reader]:
    """All readers; what they import of skincal tells its lines to atheris."""
    with ExitStack() as stack:
        if coverage:
            import atheris  # pyright: ignore[reportMissingImports]

            stack.enter_context(atheris.instrument_imports(include=["skincal"]))
        from benchmarks.fuzz_readers import readers

        return readers()


def unguided(arguments: argparse.Namespace, chosen: list[Reader]) -> None:
    """Inputs of all readers in turn, quick ones more often, until there are enough."""
    from benchmarks.fuzz_readers import damaged

    file = arguments.out / "progress.json"
    kept: dict[str, Any] = json.loads(file.read_text()) if file.is_file() else {}
    done, faults, spent = (Counter(kept.get(name, {})) for name in ("inputs", "faults", "cpu_s"))
    while done.total() < arguments.inputs:
        # Half of the time goes to the readers with the fewest inputs, half to those that took the least time.
        by = done if random.Random(done.total()).random() < 0.5 else spent
        reader = min(chosen, key=lambda one: by[one.name])
        begun = time.process_time()
        with TemporaryDirectory(
            prefix="fuzz-", dir="/dev/shm" if Path("/dev/shm").is_dir() else None
        ) as scratch:
            for i in range(BATCH):
                rng = random.Random(f"{arguments.seed} {reader.name} {done[reader.name] + i}")
                name, content = damaged(rng, reader)
                trace = run_one(reader, Path(scratch), name, content)
                if trace is not None:
                    faults[reader.name] += 1
                    keep_fault(arguments.out, reader, name, content, trace)
        gc.collect()
        done[reader.name] += BATCH
        spent[reader.name] += time.process_time() - begun
        state = {"seed": arguments.seed, "inputs": done, "faults": faults, "cpu_s": spent}
        file.with_suffix(".part").write_text(json.dumps(state, indent=1, sort_keys=True))
        file.with_suffix(".part").replace(file)
    kinds = len(list((arguments.out / "faults").glob("*")))
    print(f"{done.total()} inputs to {len(done)} readers: {faults.total()} faults of {kinds} kinds")


def guided(arguments: argparse.Namespace, reader: Reader) -> None:
    """Inputs of one reader that libFuzzer makes of those that reached new lines."""
    import atheris  # pyright: ignore[reportMissingImports]

    names = [name for name in reader.files if name not in reader.fixed]
    corpus = arguments.out / "corpus" / reader.name.replace(", ", "-")
    corpus.mkdir(parents=True, exist_ok=True)
    for i, name in enumerate(names):
        (corpus / f"sample-{i}").write_bytes(bytes([i]) + reader.files[name])
    with TemporaryDirectory(prefix="fuzz-") as scratch:

        def attack(data: bytes) -> None:
            name = names[data[0] % len(names)] if data else names[0]
            trace = run_one(reader, Path(scratch), name, data[1:])
            if trace is not None:
                keep_fault(arguments.out, reader, name, data[1:], trace)

        atheris.Setup([sys.argv[0], f"-runs={arguments.inputs}", "-max_len=20000", str(corpus)], attack)
        atheris.Fuzz()


if __name__ == "__main__":
    main()
