"""Damages valid inputs of every reader and looks what it makes of them.

    python benchmarks/fuzz.py [--inputs 1000000] [--seed 0] [--out runs/fuzz] [--reader NAME] [--coverage]

A reader may accept an input, or refuse it with an error that names the file. Anything else is a fault: another
exception, more than 10 s, more than 4 GiB, the end of the process (these three not where skincal has a process of its
own read the file; here it is this one). Each is kept under ``faults/`` with its input and traceback. The count goes on
where an earlier call ended, in ``progress.json``. Every reader gets ``--least`` inputs; the rest go to all for the same
time, so that quick ones get more. ``--coverage`` lets atheris guide the damage by the lines that it reaches
(``pip install atheris``), for one reader.
"""

from __future__ import annotations

import argparse
import hashlib
import json
import logging
import os
import random
import resource
import select
import signal
import sys
import traceback
import warnings
from collections import Counter
from collections.abc import Callable
from contextlib import ExitStack
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING, Any

sys.path.insert(0, str(Path(__file__).parents[1]))
sys.path.insert(1, str(Path(__file__).parents[1] / "tests"))

if TYPE_CHECKING:
    from benchmarks.fuzz_readers import Reader

LIMIT_S, LIMIT_BYTES = 10, 4 << 30
BATCH = 500
"""Inputs of one reader in a row, in a process of their own; so many are counted at once."""


class SlowError(Exception):
    """A reader that took too long."""


def _too_long(*_: Any) -> None:
    raise SlowError(f"more than {LIMIT_S} s")


def run_one(reader: Reader, folder: Path, name: str, content: bytes) -> str | None:
    """The traceback of a fault; None where there is none."""
    signal.setitimer(signal.ITIMER_REAL, LIMIT_S)
    try:
        reader.attack(folder, name, content)
    except KeyboardInterrupt:
        raise
    except BaseException as error:
        if reader.apart and isinstance(error, SlowError):
            return None
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
    parser.add_argument("--least", type=int, default=4_000, help="inputs that every reader gets")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--out", type=Path, default=Path("runs/fuzz"))
    parser.add_argument("--reader", help="one reader only")
    parser.add_argument("--coverage", action="store_true", help="guided by atheris; needs --reader")
    arguments = parser.parse_args()
    warnings.simplefilter("ignore")
    logging.disable()
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
    """Inputs of all readers in turn, until there are enough."""
    file = arguments.out / "progress.json"
    kept: dict[str, Any] = json.loads(file.read_text()) if file.is_file() else {}
    done, faults, spent = (Counter(kept.get(name, {})) for name in ("inputs", "faults", "cpu_s"))
    while done.total() < arguments.inputs:
        few = [one for one in chosen if done[one.name] < arguments.least]
        by = done if few else spent
        reader = min(few or chosen, key=lambda one: by[one.name])
        begun = _cpu_s()
        faults[reader.name] += run_batch(arguments.out, reader, arguments.seed, done[reader.name])
        done[reader.name] += BATCH
        spent[reader.name] += _cpu_s() - begun
        state = {**kept, "seed": arguments.seed, "inputs": done, "faults": +faults, "cpu_s": spent}
        file.with_suffix(".part").write_text(json.dumps(state, indent=1, sort_keys=True))
        file.with_suffix(".part").replace(file)
    kinds = len(list((arguments.out / "faults").glob("*")))
    print(f"{done.total()} inputs to {len(done)} readers: {faults.total()} faults of {kinds} kinds")


def _cpu_s() -> float:
    times = os.times()
    return times.user + times.system + times.children_user + times.children_system


def run_batch(out: Path, reader: Reader, seed: int, first: int) -> int:
    """Gives a reader ``BATCH`` inputs, in forks that are watched; returns how many were faults."""
    from benchmarks.fuzz_readers import damaged

    def made(number: int) -> tuple[str, bytes]:
        return damaged(random.Random(f"{seed} {reader.name} {number}"), reader)

    def work(number: int, folder: Path) -> bool:
        name, content = made(number)
        trace = run_one(reader, folder, name, content)
        if trace is not None:
            keep_fault(out, reader, name, content, trace)
        return trace is not None

    faults, number, end = 0, first, first + BATCH
    memory = "/dev/shm" if Path("/dev/shm").is_dir() else None
    while number < end:
        with TemporaryDirectory(prefix="fuzz-", dir=memory) as scratch:
            found, number, why = _watched(lambda i, place=Path(scratch): work(i, place), number, end)
        faults += found
        if why:
            number += 1
        if why and not reader.apart:
            faults += 1
            keep_fault(out, reader, *made(number - 1), why)
    return faults


def _watched(work: Callable[[int], bool], first: int, end: int) -> tuple[int, int, str]:
    """Does numbered pieces of work in a fork; returns faults, the number that it came to, and why not to the end."""
    read, write = os.pipe()
    child = os.fork()
    if not child:
        try:
            for number in range(first, end):
                os.write(write, b"x" if work(number) else b".")
        finally:
            os._exit(0)
    os.close(write)
    faults = done = 0
    why = ""
    while first + done < end:
        # The fork's own alarm ends what Python runs; code of libraries that never comes back is ended from here.
        if not select.select([read], [], [], 6 * LIMIT_S)[0]:
            os.kill(child, signal.SIGKILL)
            why = f"NeverBackError: no answer in {6 * LIMIT_S} s"
            break
        answers = os.read(read, BATCH)
        if not answers:
            break
        done, faults = done + len(answers), faults + answers.count(b"x")
    os.close(read)
    status = os.waitstatus_to_exitcode(os.waitpid(child, 0)[1])
    if not why and first + done < end:
        why = f"ProcessEndedError: status {status}"
    return faults, first + done, why


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
