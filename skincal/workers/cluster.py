"""A Dask cluster as a mapper: independent pieces of work on the workers of other machines."""

from __future__ import annotations

import platform
from collections.abc import Callable, Generator, Iterable, Sequence
from contextlib import contextmanager
from importlib.metadata import PackageNotFoundError, version
from typing import Any

from skincal.errors import InputError, Problem, WorkError, input_error, text_of
from skincal.fitting.tasks import Mapper
from skincal.version import __version__

CONNECT_S = 10
"""A scheduler answers within this time [s]."""
WORKERS_S = 30
"""A cluster that has just been started has its first worker within this time [s]."""
_PACKAGES = ("numpy", "scipy", "numba", "nlopt", "trimesh", "embreex")
"""Packages whose version decides the last digits of a result."""


@contextmanager
def cluster_mapper(address: str) -> Generator[Mapper]:
    """Yield a mapper that spreads work over the workers of a Dask scheduler.

    Results come in the order of the arguments. What a worker was doing when it died is done again by another. What
    nobody has waited for at the end is cancelled.

    Args:
        address: of the scheduler, ``tcp://host:8786``.

    Raises:
        InputError: Dask is not installed, the scheduler does not answer, or a worker has other versions.
        WorkError: the cluster has no workers, or one piece of work has killed several of them.
    """
    try:
        from distributed import Client, KilledWorker
    except ImportError:
        fix = "Install it with: pip install 'skincal[cluster]'"
        raise input_error("--scheduler", "the package dask[distributed]", "none", fix) from None
    try:
        client: Any = Client(address, timeout=CONNECT_S, set_as_default=False)
    except (OSError, ValueError) as error:
        expected = f"the address of a Dask scheduler that answers within {CONNECT_S} s"
        fix = "Start one with: dask scheduler; and on each machine: dask worker ADDRESS --nthreads 1"
        got = text_of(error, 120) or type(error).__name__
        raise input_error(f"--scheduler {address}", expected, got, fix) from None
    futures: list[Any] = []

    def spread(function: Callable[[Any], Any], arguments: Sequence[Any], /) -> Iterable[Any]:
        # Impure: the same piece of work may be asked for again, and its arguments are large to be hashed.
        begun = client.map(function, list(arguments), pure=False)
        futures.extend(begun)
        return _in_order(begun, futures)

    try:
        _require_workers(client, address)
        _require_versions(client.run(_versions))
        yield spread
    except KilledWorker as error:
        raise WorkError(f"--scheduler {address}: {error}. Have the workers enough memory?") from error
    finally:
        client.cancel(futures, force=True)
        client.close(timeout=CONNECT_S)


def _in_order(begun: Sequence[Any], all_begun: list[Any]) -> Generator[Any]:
    for future in begun:
        yield future.result()
        all_begun.remove(future)
        future.release()


def _require_workers(client: Any, address: str) -> None:
    try:
        client.wait_for_workers(1, timeout=WORKERS_S)
    except TimeoutError:
        raise WorkError(
            f"--scheduler {address}: expected at least one worker; got none in {WORKERS_S} s. "
            f"Start one with: dask worker {address} --nthreads 1"
        ) from None


def _versions() -> dict[str, str]:
    """Return the versions, in this process, of all that decides the last digits of a result."""
    found = {"skincal": __version__, "python": ".".join(platform.python_version_tuple()[:2])}
    for name in _PACKAGES:
        try:
            found[name] = version(name)
        except PackageNotFoundError:
            found[name] = "none"
    return found


def _require_versions(of_workers: dict[str, dict[str, str]]) -> None:
    """Refuse workers that would give other results.

    Raises:
        InputError: names the worker, the package and both versions, one line each.
    """
    own = _versions()
    problems = [
        Problem(f"worker {worker}", f"{name} {own[name]}, as here", f"{name} {there.get(name, 'none')}")
        for worker, there in of_workers.items()
        for name in own
        if there.get(name, "none") != own[name]
    ]
    if problems:
        raise InputError(problems)
