"""What a slow, lossy link costs a policy: ``python -m benchmarks.remote_cost [--hands 20] [--sockets 1]``.

`marble-tactile-1` on reference hands with hidden truths: here, over a link with a delay, and over one that loses
messages besides. The link is simulated on the hand's own clock, which goes on while messages are under way: the numbers
do not depend on how busy the computer is. Requests are repeated as the driver ``remote`` does it. Each finished run is
kept beside the results, so that an interrupted benchmark goes on.

``--sockets N`` makes N runs over real sockets instead: the server of `serve-hand`, a proxy that delays and loses
messages, the driver ``remote``. There the hand's clock waits for its client.
"""

from __future__ import annotations

import argparse
import json
import threading
import time
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.lossy_proxy import Proxy, lossy
from skincal.deploy import deploy, marble_targets
from skincal.deploy.policy_run import Deployed
from skincal.envs.pinch import read_pinch
from skincal.envs.reference_hand import ReferenceHand
from skincal.errors import SkincalError
from skincal.hand.driver import HandCommand, HandDriver, HandState
from skincal.hand.errors import HandError
from skincal.hand.remote import RemoteDriver, ResendTimer
from skincal.hand.serve import HandServer
from skincal.train import Policy, policy_path, read_policy

RESULTS = Path(__file__).parent / "results" / "remote_cost.json"
LINKS = {"here": (0.0, 0.0), "5 ms": (0.005, 0.0), "20 ms": (0.02, 0.0), "20 ms, 1 % lost": (0.02, 0.01)}
"""Delay of a message each way [s], and share of messages that are lost."""
SILENCE_S = 0.8
"""After so long without an answer the driver takes the hand for lost [s]."""


class Clock:
    """A clock that goes on when it is told to."""

    def __init__(self) -> None:
        self.now_s = 0.0

    def monotonic(self) -> float:
        """Return the time [s]."""
        return self.now_s

    def sleep(self, time_s: float) -> None:
        """Let time pass [s]."""
        self.now_s += time_s


class Link(HandDriver):
    """A hand at the other end of a bad link, all on the hand's clock.

    Args:
        hand: keeps pace with a clock of its own.
        delay_s: of a message [s].
        lost: share of messages that are lost.
        seed: of what is lost.
    """

    name = "link"

    def __init__(self, hand: ReferenceHand, delay_s: float, lost: float, seed: int) -> None:
        self._hand, self._delay_s, self._lost = hand, delay_s, lost
        self.clock = hand.clock = Clock()
        self._rng = np.random.default_rng(seed)
        self._timers = {"observe": ResendTimer(), "act": ResendTimer()}

    @property
    def description(self) -> Any:
        """The hand."""
        return self._hand.description

    @property
    def period_s(self) -> float:
        """Time between two states [s]."""
        return self._hand.period_s

    def connect(self) -> None:
        """Connect, without messages."""
        self._hand.connect()

    def observe(self) -> HandState:
        """Ask for a state."""
        return self._ask("observe", self._hand.observe)

    def act(self, command: HandCommand) -> None:
        """Send a command."""
        self._ask("act", lambda: self._hand.act(command))

    def _ask(self, kind: str, do: Any) -> Any:
        """Ask until there is an answer; what was asked for is done once, when the first request arrives."""
        clock, timer, begun_s = self.clock, self._timers[kind], self.clock.now_s
        arrivals: list[float] = []
        result, done, sent = None, False, 0
        while True:
            sent, sent_s = sent + 1, clock.now_s
            if self._arrives():
                ready_s = sent_s + self._delay_s
                if not done:
                    clock.now_s = max(clock.now_s, ready_s)
                    result, done = do(), True
                    ready_s = clock.now_s
                if self._arrives():
                    arrivals.append(ready_s + self._delay_s)
            again_s = sent_s + timer.wait_s
            if arrivals and min(arrivals) <= again_s:
                clock.now_s = max(clock.now_s, min(arrivals))
                if sent == 1:
                    timer.answered(clock.now_s - begun_s)
                return result
            clock.now_s = max(clock.now_s, again_s)
            timer.repeated()
            if clock.now_s - begun_s > SILENCE_S:
                raise HandError(f"{kind}: no answer for {SILENCE_S} s", "lost")

    def _arrives(self) -> bool:
        return bool(self._rng.random() >= self._lost)

    def object_position_m(self) -> Any:
        """See :meth:`HandDriver.object_position_m`."""
        return self._hand.object_position_m()

    def stop(self) -> None:
        """Stop the hand."""
        self._hand.stop()

    def close(self) -> None:
        """End the session."""
        self._hand.close()


def more(hand: HandDriver) -> dict[str, Any]:
    """What else a run is told: of a simulated link the guard sees the same clock."""
    return {"clock": hand.clock.monotonic} if isinstance(hand, Link) else {}


def figures(make: Any, policy: Policy, duration_s: float) -> dict[str, Any]:
    """A run on a hand, in numbers."""
    begun, hand = time.monotonic(), make()
    try:
        found: Deployed = deploy(
            policy, hand, read_pinch(None), marble_targets("circle", duration_s),
            object_width_m=0.012, speed_rad_per_s=0.3, **more(hand),
        )  # fmt: skip
    except SkincalError as error:
        return {"held": False, "stopped": str(error), "wall_s": time.monotonic() - begun}
    late = found.error_m[20:]
    return {
        "held": found.lost_s is None,
        "error_m": float(np.nanmean(late)) if np.isfinite(late).any() else None,
        "missed": found.missed,
        "steps": found.steps,
        "jitter_s": found.jitter_s,
        "longest_s": float(found.period_s.max()),
        "command_s": float(np.median(np.diff([state.time_s for state in found.record.states]))),
        "wall_s": time.monotonic() - begun,
    }


def over_sockets(policy: Policy, seed: int, duration_s: float) -> dict[str, Any]:
    """A run over real sockets and a proxy; the hand's clock waits for its client."""
    delay_s, lost = LINKS["20 ms, 1 % lost"]
    with HandServer(lambda: ReferenceHand(seed=seed), "tcp://127.0.0.1:*") as server:
        thread = threading.Thread(target=server.run)
        thread.start()
        try:
            with Proxy(server.address, lossy(delay_s, lost, seed)) as proxy:
                return figures(lambda: RemoteDriver(proxy.address), policy, duration_s)
        finally:
            server.end()
            thread.join(5.0)


def tell(name: str, runs: list[dict[str, Any]]) -> str:
    errors = np.array([one["error_m"] for one in runs if one.get("error_m") is not None])
    ended = [one for one in runs if "jitter_s" in one]
    held, stopped = sum(one["held"] for one in runs), sum("stopped" in one for one in runs)
    steps = sum(one["steps"] for one in ended)
    jitter, longest, command = (
        1e3 * np.array([one[key] for one in ended]) for key in ("jitter_s", "longest_s", "command_s")
    )
    means = np.random.default_rng(0).choice(errors, (2000, len(errors))).mean(axis=1)
    low, high = 1e3 * np.quantile(means, [0.025, 0.975])
    return (
        f"| {name} | {held} of {len(runs)} ({stopped} stopped) | {1e3 * errors.mean():.2f} mm ({low:.2f} to "
        f"{high:.2f}) | {np.median(command):.0f} ms | {np.median(jitter):.1f} ms, {longest.max():.0f} ms | "
        f"{sum(one['missed'] for one in ended)} of {steps} |"
    )


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--hands", type=int, default=20, help="hidden hands for each link")
    parser.add_argument("--sockets", type=int, default=0, help="runs over real sockets, instead")
    parser.add_argument("--policy", default="marble-tactile-1")
    parser.add_argument("--duration-s", type=float, default=8.0)
    asked = parser.parse_args()
    policy = read_policy(policy_path(asked.policy))
    kept: dict[str, Any] = json.loads(RESULTS.read_text(encoding="utf-8")) if RESULTS.exists() else {}

    def once(key: str, make: Any) -> dict[str, Any]:
        if key not in kept:
            kept[key] = make()
            RESULTS.write_text(json.dumps(kept, indent=0) + "\n", encoding="utf-8")
        return kept[key]

    print("| link | held | error from 2 s on | a command every | jitter, longest step | steps missed |")
    print("|---|---|---|---|---|---|")
    if asked.sockets:
        runs = [
            once(
                f"sockets {asked.policy} {asked.duration_s:g} {seed}",
                lambda s=seed: over_sockets(policy, s, asked.duration_s),
            )
            for seed in range(asked.sockets)
        ]
        print(tell("20 ms, 1 % lost, over sockets", runs))
        return
    for name, (delay_s, lost) in LINKS.items():
        runs = [
            once(
                f"{name} {asked.policy} {asked.duration_s:g} {seed}",
                lambda s=seed, d=delay_s, q=lost: figures(
                    lambda: Link(ReferenceHand(seed=s), d, q, s), policy, asked.duration_s
                ),
            )
            for seed in range(asked.hands)
        ]
        print(tell(name, runs), flush=True)


if __name__ == "__main__":
    main()
