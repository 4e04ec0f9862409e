"""Worker processes for independent pieces of work."""

from __future__ import annotations

import multiprocessing
import os
import signal
import sys
import threading
from collections.abc import Generator
from concurrent.futures import ProcessPoolExecutor
from contextlib import contextmanager
from multiprocessing import resource_tracker
from multiprocessing.process import BaseProcess
from typing import TYPE_CHECKING

from skincal import compiling
from skincal.fitting.tasks import Mapper

if TYPE_CHECKING:
    from multiprocessing.synchronize import Semaphore

_THREAD_VARIABLES = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS")
_REQUESTS = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)
"""What may interrupt the first process, if it has handlers for it."""


def available_cores() -> int:
    """Return the number of cores that this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


@contextmanager
def mapper(workers: int | None = None, scheduler: str | None = None) -> Generator[Mapper]:
    """Yield a mapper that spreads work over processes of this machine, or over a cluster.

    Args:
        workers: how many processes; None for one a core; 1 for none but this one.
        scheduler: address of a Dask scheduler, whose workers are used instead; None: none.

    Yields:
        The mapper. Results come in the order of the arguments and do not depend on the number of workers. With several
        processes work begins at once, and what nobody has waited for at the end is dropped, errors in it included.
    """
    if scheduler is not None:
        from skincal.calibrate.cluster import cluster_mapper

        with cluster_mapper(scheduler) as spread:
            yield spread
        return
    count = available_cores() if workers is None else workers
    if count <= 1:
        yield map
        return
    # Workers are started afresh: a fork would copy the locks of threads that draw the progress.
    context = multiprocessing.get_context("spawn")
    with _one_thread_each():
        voice = context.Semaphore(0 if compiling.on_compile is None else 1)
        pool = ProcessPoolExecutor(count, mp_context=context, initializer=_begin, initargs=(voice,))
        try:
            _start(pool, count)
            yield pool.map
        finally:
            _end(pool)


def _begin(voice: Semaphore) -> None:
    """Leave Ctrl-C to the first process, with which a worker ends; the one that gets ``voice`` reports compiling."""
    if voice.acquire(block=False):
        compiling.on_compile = compiling.tell
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    threading.Thread(target=_end_with_first, daemon=True).start()


def _end_with_first() -> None:
    """End with the first process: one that is killed would leave its workers waiting for ever."""
    first = multiprocessing.parent_process()
    if first is not None:
        first.join()
        os._exit(1)


def _start(pool: ProcessPoolExecutor, count: int) -> None:
    """Start the workers with Ctrl-C blocked: while they import, they do not yet ignore it."""
    _begin_tracker()
    with interrupt_afterwards():
        before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
        try:
            with _without_main():
                for _ in range(count):  # each makes one process
                    pool.submit(os.getpid)
        finally:
            signal.pthread_sigmask(signal.SIG_SETMASK, before)


@contextmanager
def _without_main() -> Generator[None]:
    """Hide the main module's file from workers that start now.

    A worker would run it again: a script without an ``if __name__ == "__main__"`` would begin anew in each of them.
    All work that is sent to workers is a function of an installed module, so none needs it.
    """
    main = sys.modules["__main__"]
    hidden = {name: vars(main).pop(name) for name in ("__file__", "__spec__") if name in vars(main)}
    main.__spec__ = None
    try:
        yield
    finally:
        vars(main).update(hidden)


def _begin_tracker() -> None:
    """Start the resource tracker before the workers: later it would undo the block. It ignores a lost terminal."""
    if threading.current_thread() is not threading.main_thread():
        resource_tracker.ensure_running()
        return
    before = signal.signal(signal.SIGHUP, signal.SIG_IGN)
    try:
        resource_tracker.ensure_running()
    finally:
        signal.signal(signal.SIGHUP, before)


@contextmanager
def interrupt_afterwards() -> Generator[None]:
    """Hold back interrupts to the end of the block, so that no worker is left half started."""
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    came: list[int] = []
    handled = [number for number in _REQUESTS if callable(signal.getsignal(number))]
    before = {number: signal.signal(number, lambda number, _: came.append(number)) for number in handled}
    try:
        yield
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)
    if came:
        signal.raise_signal(came[0])


def _end(pool: ProcessPoolExecutor) -> None:
    """End the workers, even in the middle of their work.

    The order matters: the pool forgets its workers when it is shut down, and its thread complains of workers that are
    gone while it still has work that was cancelled, or when nobody holds the pool any longer.
    """
    processes: dict[int, BaseProcess] = getattr(pool, "_processes", None) or {}
    workers, thread = list(processes.values()), getattr(pool, "_executor_manager_thread", None)
    writer = getattr(getattr(pool, "_result_queue", None), "_writer", None)
    pool.shutdown(wait=False, cancel_futures=True)
    for worker in workers:
        worker.terminate()
    # The thread may wait for the rest of a result that a worker had half sent: it ends if nobody can send it any more.
    if writer is not None:
        writer.close()
    if isinstance(thread, threading.Thread):
        thread.join()


@contextmanager
def _one_thread_each() -> Generator[None]:
    """Give workers, which inherit the environment, one thread each for linear algebra."""
    before = {name: os.environ.get(name) for name in _THREAD_VARIABLES}
    os.environ.update(dict.fromkeys(_THREAD_VARIABLES, "1"))
    try:
        yield
    finally:
        for name, value in before.items():
            if value is None:
                os.environ.pop(name, None)
            else:
                os.environ[name] = value
