"""Worker processes for independent pieces of work."""

from __future__ import annotations

import gc
import multiprocessing
import os
import signal
import sys
import threading
from collections import deque
from collections.abc import Callable, Generator, Iterable, Sequence
from concurrent.futures import Future, ProcessPoolExecutor
from contextlib import contextmanager
from importlib import import_module
from multiprocessing import resource_tracker
from multiprocessing.process import BaseProcess
from typing import TYPE_CHECKING, Any

from skincal.signals import held_back

if TYPE_CHECKING:
    from skincal.fitting.tasks import Mapper

_THREAD_VARIABLES = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS")
_COLLECTIONS = (200_000, 20, 20)
"""Thresholds of garbage collection that leave of its time, a fifteenth of a fit's with Python's own, a quarter."""


def available_cores() -> int:
    """Return the number of cores that this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def import_modules(names: Sequence[str]) -> None:
    """Import modules, so that a worker has them before it gets work."""
    for name in names:
        import_module(name)


@contextmanager
def mapper(workers: int | Mapper | None = None, scheduler: str | None = None) -> Generator[Mapper]:
    """Yield a mapper that spreads work over processes of this machine, or over a cluster.

    Args:
        workers: how many processes, this one included; None for one a core; 1 for none but this one; or a mapper that
            is open, and stays so.
        scheduler: address of a Dask scheduler, whose workers are used instead; None: none.

    Yields:
        The mapper. Results come in the order of the arguments and do not depend on the number of workers. With several
        processes work begins at once, and what nobody has waited for at the end is dropped, errors in it included.
    """
    if callable(workers):
        yield workers
        return
    if scheduler is not None:
        from skincal.workers.cluster import cluster_mapper

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
        pool = ProcessPoolExecutor(count - 1, mp_context=context, initializer=_begin)
        try:
            _start(pool, count - 1)
            yield lambda function, arguments: _Shared(pool, count - 1, function, arguments).results()
        finally:
            _end(pool)


class _Shared:
    """Work that this process shares with its workers: each takes the first piece that nobody has begun."""

    def __init__(
        self,
        pool: ProcessPoolExecutor,
        workers: int,
        function: Callable[[Any], Any],
        arguments: Iterable[Any],
    ) -> None:
        self._pool, self._function, self._arguments = pool, function, list(arguments)
        self._left, self._lock = deque(range(len(self._arguments))), threading.Lock()
        self._futures: dict[int, Future[Any]] = {}
        for _ in range(workers):
            self._give()

    def results(self) -> Generator[Any]:
        """Yield the results in order, and work while there is something left to begin."""
        for number in range(len(self._arguments)):
            while number not in self._futures or not self._futures[number].done():
                with self._lock:
                    own = self._left.popleft() if self._left else None
                if own is None:
                    break
                done: Future[Any] = Future()
                self._futures[own] = done
                try:
                    done.set_result(self._function(self._arguments[own]))
                except Exception as error:  # raised when it is its turn
                    done.set_exception(error)
            yield self._futures.pop(number).result()

    def _give(self) -> None:
        """Give the next piece to a worker that has none."""
        with self._lock:
            if not self._left:
                return
            number = self._left[0]
            try:
                future = self._pool.submit(self._function, self._arguments[number])
            except RuntimeError:  # the workers are gone
                return
            self._left.popleft()
            self._futures[number] = future
        future.add_done_callback(self._next)

    def _next(self, done: Future[Any]) -> None:
        # After a failure the pool may be ending, and holds its lock.
        if not done.cancelled() and done.exception() is None:
            self._give()


@contextmanager
def rare_collections() -> Generator[None]:
    """Look for garbage less often, in a process that loads and makes much that is none."""
    before = gc.get_threshold()
    gc.set_threshold(*_COLLECTIONS)
    try:
        yield
    finally:
        gc.set_threshold(*before)


def _begin() -> None:
    """Leave Ctrl-C to the first process, with which a worker ends."""
    gc.set_threshold(*_COLLECTIONS)
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    threading.Thread(target=_end_with_first, daemon=True).start()


def _end_with_first() -> None:
    """End with the first process: one that is killed would leave its workers waiting for ever."""
    first = multiprocessing.parent_process()
    if first is not None:
        first.join()
        os._exit(1)


def _start(pool: ProcessPoolExecutor, count: int) -> None:
    """Start the workers with Ctrl-C blocked: while they import, they do not yet ignore it.

    What would end this process comes afterwards, so that no worker is left half started.
    """
    _begin_tracker()
    with held_back():
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
def one_blas_thread() -> Generator[None]:
    """Give linear algebra of this process one thread, which is what worker processes and the command line have.

    Several round differently, and on small matrices they cost more than they bring, much more on busy cores.
    """
    from threadpoolctl import threadpool_limits  # pyright: ignore[reportMissingTypeStubs]

    with threadpool_limits(1, "blas"):
        yield


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
