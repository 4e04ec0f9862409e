"""Check of the hand's clock against ours: it must not stop, go back, jump, run ahead or fall behind."""

from __future__ import annotations

import math

from skincal.hand.errors import HandError
from skincal.hand.guard_options import GuardOptions

DRIFT = 1e-3
"""Largest relative difference of two clocks that run equally fast; cheap crystals keep a tenth of it."""

SLOWEST = 10.0
"""A simulated clock may be slower than ours by this factor while we wait for it, and faster without limit."""

JUMP_S = 0.1
"""Largest jump of the hand's clock over ours between two states, or five periods if that is more: a bus delivers in
bursts, and a busy computer looks late [s]."""


class ClockCheck:
    """Checker of the time of each state, one after the other.

    The lag is a leaky sum: the advance of our clock between two states less that of the hand's, never below zero. So it
    is the lag behind the earliest state, and clocks that differ by `DRIFT` do not add up over a long session.

    Args:
        options: limits.
        real_time: whether the hand's clock runs as fast as ours.
        period_s: time between two states [s].
        recorded: whether the states come from a recording, which may have gaps.
    """

    def __init__(
        self, options: GuardOptions, *, real_time: bool, period_s: float, recorded: bool = False
    ) -> None:
        self._options, self._real_time, self._recorded = options, real_time, recorded
        self._jump_s = max(JUMP_S, 5 * period_s)
        lag_s = math.inf if options.lag_s is None else options.lag_s
        # Slow calls of a simulated hand, as over a bad network, allow later states.
        self._lag_s = lag_s if real_time else max(lag_s, options.timeout_s / 2)
        self._last_s = self._now_s = self._advanced_s = math.nan
        self._behind_s = self._ahead_s = 0.0

    def __call__(self, time_s: float, now_s: float, waited_s: float) -> None:
        """Check a state's time.

        Args:
            time_s: the hand's clock [s].
            now_s: our clock at the arrival of the state [s].
            waited_s: time that the driver took for it [s].

        Raises:
            HandError: a violation.
        """
        if not math.isfinite(time_s):
            raise HandError(f"the hand's clock says {time_s}, which is not finite", "clock", value=time_s)
        if math.isnan(self._last_s):
            self._last_s, self._now_s, self._advanced_s = time_s, now_s, now_s
            return
        step_s, passed_s, last_s = time_s - self._last_s, now_s - self._now_s, self._last_s
        if step_s < 0:
            text = f"the hand's clock went back, from {last_s:.6f} s to {time_s:.6f} s"
            raise HandError(text, "clock", value=time_s, limit=last_s)
        self._last_s, self._now_s = time_s, now_s
        if step_s > 0:
            self._advanced_s = now_s
        for_s, limit_s = now_s - self._advanced_s, self._options.stale_s
        if for_s > limit_s:
            text = (
                f"the hand's clock has stood at {time_s:.6f} s for {for_s:.3g} s, the limit is {limit_s:g} s: "
                "the states are stale"
            )
            raise HandError(text, "clock", value=for_s, limit=limit_s)
        # A state whose answer was lost on its way comes late, and the next one does not.
        more_s = self._jump_s + (self._behind_s if self._real_time else 0.0)
        if step_s > passed_s + more_s and not self._recorded:
            text = (
                f"the hand's clock jumped by {step_s:.4g} s within {passed_s:.3g} s of ours; at most "
                f"{more_s:.3g} s more are allowed"
            )
            raise HandError(text, "clock", value=step_s, limit=passed_s + more_s)
        self._check_lag(step_s, passed_s, waited_s)

    def _check_lag(self, step_s: float, passed_s: float, waited_s: float) -> None:
        limit_s = self._lag_s
        if self._real_time:
            self._behind_s = max(0.0, self._behind_s + passed_s - (1 + DRIFT) * step_s)
            self._ahead_s = max(0.0, self._ahead_s + step_s - (1 + DRIFT) * passed_s)
        else:
            self._behind_s = max(0.0, self._behind_s + waited_s - SLOWEST * step_s)
        if self._behind_s > limit_s:
            behind_s = self._behind_s
            text = f"the states come {behind_s:.3g} s late, the limit is {limit_s:g} s: they are stale"
            raise HandError(text, "clock", value=behind_s, limit=limit_s)
        if self._ahead_s > limit_s:
            ahead_s = self._ahead_s
            text = (
                f"the hand's clock runs {ahead_s:.3g} s ahead of ours, the limit is {limit_s:g} s; the driver of a "
                "simulated hand says real_time = False"
            )
            raise HandError(text, "clock", value=ahead_s, limit=limit_s)
