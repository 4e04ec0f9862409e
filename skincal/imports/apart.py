"""Reading of foreign formats in a separate process, with bounds on its memory and its time.

A damaged file can make the libraries that read such formats crash, take all memory, or hang. The separate process
protects the caller from all of this.
"""

from __future__ import annotations

import os
import pickle
import signal
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any, Final, TypeVar

from skincal.bounded import UnreadableError, memory_bytes
from skincal.errors import quoted

Value = TypeVar("Value")

MOST_BYTES: Final = 8 << 30
"""Memory for one file on a machine that has twice as much; else half of the machine's memory."""

LEAST_BYTES: Final = 2 << 30
"""Least memory, below which the libraries cannot be loaded."""

LONGEST_S: Final = 60.0
BYTES_PER_S: Final = 1e5
"""Processor time for a file: a minute, plus its size over this rate [byte/s]; the slowest bags take a tenth of that."""

WAIT: Final = 10.0
"""The wall-clock limit is so many times the processor time, as other processes are at work too."""

_CHILD: Final = (
    "import pickle, sys; sys.path[:] = pickle.load(sys.stdin.buffer); "
    "from skincal.imports.apart import answer; answer()"
)


def apart(read: Callable[..., Value], path: Path, *arguments: Any) -> Value:
    """Return the result of a function on a file, or a folder of files, computed in a separate process.

    The function is one of a module, and called with the file and the arguments; they and the result are pickled.

    Raises:
        UnreadableError: the process crashed, or the file needs more memory or time than allowed.
        Exception: what the function raised.
    """
    most = min(MOST_BYTES, max(LEAST_BYTES, memory_bytes() // 2))
    files = path.iterdir() if path.is_dir() else [path]
    longest_s = LONGEST_S + sum(file.stat().st_size for file in files if file.is_file()) / BYTES_PER_S
    asked = pickle.dumps(sys.path) + pickle.dumps((most, int(longest_s) + 1, read, path, arguments))
    one_thread = dict.fromkeys(("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS"), "1")
    command = [sys.executable, "-P", "-c", _CHILD]
    try:
        done = subprocess.run(
            command, input=asked, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, env=os.environ | one_thread,
            timeout=WAIT * longest_s, check=False,
        )  # fmt: skip
    except subprocess.TimeoutExpired:
        done = None
    if done is None or done.returncode == -signal.SIGXCPU:
        raise UnreadableError(f"a file that is read within {longest_s:.0f} s", "one that is not")
    try:
        value, error = pickle.loads(done.stdout)
    except Exception:  # the process ended before or while it answered
        ended = f"signal {-done.returncode}" if done.returncode < 0 else f"status {done.returncode}"
        got = f"one that crashes the library that reads it ({ended})"
        raise UnreadableError("a whole file", got) from None
    if isinstance(error, MemoryError):
        raise UnreadableError(f"a file that is read in {most >> 20} MiB of memory", "one that needs more")
    if error is not None:
        raise error
    return value


def answer() -> None:
    """Run the function in the other process, and send its result."""
    most, longest_s, read, path, arguments = pickle.load(sys.stdin.buffer)
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C is for the calling process, which ends this one
    sink = os.fdopen(os.dup(1), "wb")
    os.dup2(2, 1)  # output of a library is not part of the answer
    _limit(most, longest_s)
    try:
        found: tuple[Any, BaseException | None] = read(path, *arguments), None
        data = pickle.dumps(found)
    except MemoryError:
        data = pickle.dumps((None, MemoryError()))
    except Exception as error:
        data = pickle.dumps((None, _sendable(error)))
    with sink:
        sink.write(data)


def _limit(most_bytes: int, longest_s: int) -> None:
    try:
        import resource
    except ImportError:  # Windows
        return
    used = resource.getrusage(resource.RUSAGE_SELF)
    ends_s = int(used.ru_utime + used.ru_stime) + longest_s
    for kind, most in ((resource.RLIMIT_AS, most_bytes), (resource.RLIMIT_CPU, ends_s)):
        hard = resource.getrlimit(kind)[1]
        resource.setrlimit(kind, (most if hard == resource.RLIM_INFINITY else min(most, hard), hard))


def _sendable(error: Exception) -> Exception:
    try:
        pickle.loads(pickle.dumps(error))
    except Exception:
        return ValueError(quoted(error))
    return error
