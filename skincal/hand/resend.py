"""The timer by which an unanswered request is repeated: that of TCP (RFC 6298)."""

from __future__ import annotations

SHORTEST_S, LONGEST_S = 0.02, 0.2
"""Bounds of the time until a request is repeated; the longest one holds until an answer has been timed [s]."""


class ResendTimer:
    """Estimates how long an answer takes, from those to requests that were sent once.

    Answers to repeated requests tell no time, as nobody knows which of the requests they answer (Karn's algorithm).
    """

    def __init__(self) -> None:
        self._mean_s, self._spread_s = LONGEST_S, 0.0
        self._timed = False
        self._backoff = 1.0

    @property
    def wait_s(self) -> float:
        """Time after which a request is repeated [s]."""
        wait_s = self._backoff * (self._mean_s + 4 * self._spread_s)
        return min(max(wait_s, SHORTEST_S), LONGEST_S)

    def answered(self, took_s: float) -> None:
        """Take in the time of an answer to a request that was sent once [s]."""
        if self._timed:
            self._spread_s += (abs(took_s - self._mean_s) - self._spread_s) / 4
            self._mean_s += (took_s - self._mean_s) / 8
        else:
            self._mean_s, self._spread_s, self._timed = took_s, took_s / 2, True
        self._backoff = 1.0

    def repeated(self) -> None:
        """Wait twice as long from now on, until an answer is timed again."""
        self._backoff = min(2 * self._backoff, LONGEST_S / SHORTEST_S)
