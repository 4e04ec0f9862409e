"""Stopping a hand, or another rig, so that nothing cuts it short, and saying truly whether it was stopped."""

from __future__ import annotations

from collections.abc import Callable, Generator
from contextlib import contextmanager

from skincal.errors import quoted
from skincal.hand.worker import CallTimeoutError, call_and_leave, raised_by
from skincal.signals import held_back


def stopped(rig: str) -> str:
    """Return the statement that a rig was stopped, valid only after its ``stop`` returned."""
    return f"The {rig} was stopped."


STOPPED = stopped("hand")

HURRY_S = 2.0
"""Longest time for closing while somebody waits for the end [s]."""


class Stop:
    """The stop of a rig: what is said of the rig follows from this alone.

    Args:
        stop: the driver's ``stop``.
        timeout_s: longest time of a call [s].
        name: the driver's name.
        rig: the kind of rig.

    Attributes:
        asked: it was called: the rig is to move no more.
        trouble: what went wrong with the last call; empty: it returned, the rig is stopped; None: neither is known.
    """

    def __init__(self, stop: Callable[[], None], timeout_s: float, name: str, rig: str = "hand") -> None:
        self._stop, self._timeout_s, self.name, self.rig = stop, timeout_s, name, rig
        self.asked = False
        self.trouble: str | None = None

    def __call__(self) -> str:
        """Call the driver's ``stop``, a second time if it raises; this is not interrupted. Return the trouble."""
        self.asked = True
        trouble, power = "", f"Cut the {self.rig}'s power."
        with held_back():
            for _ in range(2):
                try:
                    call_and_leave(self._stop, self._timeout_s, f"stop {self.name}")
                    trouble = ""
                    break
                except CallTimeoutError:
                    trouble = f"stop() did not return within {self._timeout_s:g} s! {power}"
                    break
                except Exception as error:
                    trouble = f"stop() failed! {quoted(raised_by(error))}. {power}"
        self.trouble = trouble
        return trouble


_NOTED: list[dict[tuple[str, str], Stop]] = []


@contextmanager
def stops_noted() -> Generator[dict[tuple[str, str], Stop]]:
    """Yield the stops of the rigs that are connected during a block, by kind and name: the last one of each."""
    noted: dict[tuple[str, str], Stop] = {}
    _NOTED.append(noted)
    try:
        yield noted
    finally:
        _NOTED.remove(noted)


def note_stop(stop: Stop) -> None:
    """Note the stop of a rig that is about to be connected."""
    for noted in _NOTED:
        noted[stop.rig, stop.name] = stop
