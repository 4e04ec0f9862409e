"""A hand's side that answers anything at all: the client ends in time, with an error, and asks for a stop."""

from __future__ import annotations

import json
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from threading import Event, Thread
from threading import enumerate as threads
from typing import Any

import numpy as np
import pytest

from skincal.hand import GuardedHand, GuardOptions, remote
from skincal.hand.errors import HandError
from skincal.hand.messages import REQUESTS, VERSION, Message, decode, encode, state_body
from skincal.hand.remote import RemoteDriver
from skincal.robot import HandState, bundled_hand

zmq = pytest.importorskip("zmq", reason="needs skincal[remote]")

QUICK = GuardOptions(timeout_s=0.4)
"""Longer than a client is patient with silence, shorter than with a server that is always busy."""

Answer = Callable[[dict[str, Any]], list[bytes]]


@pytest.fixture(scope="module")
def state() -> dict[str, Any]:
    """A state of the bundled hand at rest, as a message has it."""
    home, zeros = bundled_hand().home_rad, np.zeros(6)
    return state_body(HandState(0.0, home, zeros, zeros, home, np.zeros(16), np.zeros(16), 20.0))


@contextmanager
def server(state: dict[str, Any], wrong: Answer, at: str) -> Iterator[tuple[str, list[str]]]:
    """A server that answers as it should, but from the second request of one kind on."""
    context, end, seen = zmq.Context(), Event(), list[str]()
    socket = context.socket(zmq.ROUTER)
    socket.linger = 0
    address = f"tcp://127.0.0.1:{socket.bind_to_random_port('tcp://127.0.0.1')}"

    def run() -> None:
        clock_s = state["time_s"]
        while not end.is_set():
            if not socket.poll(20):
                continue
            who, data = socket.recv_multipart()
            asked = decode(data, REQUESTS)
            seen.append(asked.kind)
            kind, body = "done", dict[str, Any]()
            if asked.kind == "hello":
                kind, body = "welcome", {"period_s": 0.01, "watchdog_s": 2.0}
            elif asked.kind == "observe":
                time.sleep(0.01)
                clock_s += 0.01
                stamps = [clock_s] * len(state["taxel_time_s"])
                kind, body = "state", {**state, "time_s": clock_s, "taxel_time_s": stamps}
            answer = Message(kind, asked.number, asked.session, body)
            parts = [encode(answer)]
            if asked.kind == at and (at == "hello" or seen.count(at) > 1):
                parts = wrong(
                    {"v": VERSION, "kind": kind, "id": asked.number, "session": asked.session, **body}
                )
            if parts:
                socket.send_multipart([who, *parts])

    thread = Thread(target=run)
    thread.start()
    try:
        yield address, seen
    finally:
        end.set()
        thread.join()
        socket.close()
        context.term()


def but(**changes: Any) -> Answer:
    return lambda answer: [json.dumps(answer | changes).encode()]


WRONG: dict[str, Answer] = {
    "nothing": lambda _: [],
    "an empty message": lambda _: [b""],
    "no JSON": lambda _: [b"{\xff"],
    "NaN": lambda answer: [json.dumps(answer | {"watchdog_s": float("nan")}).encode()],
    "lists without end": lambda _: [b"[" * 60_000],
    "too large": lambda _: [b"x" * 3_000_000],
    "an old number": but(id=0),
    "another session": but(session="another"),
    "always busy": but(kind="wait"),
    "a request": but(kind="act"),
    "another version": but(v="skincal-hand/2"),
    "an odd refusal": but(kind="refused", error=[], text={"a": 1}, joint=3, value="x", limit=[None]),
}
OF_STATES: dict[str, Answer] = {
    "angles of another shape": but(q_rad=[0.0]),
    "angles that are texts": but(q_rad=["0"] * 6),
    "angles that are not there": but(q_rad=None),
    "angles that are null": but(q_rad=[None] * 6),
    "angles beyond all bounds": but(q_rad=[1e308] * 6),
    "whole numbers of 400 digits": lambda answer: [json.dumps(answer).replace("0.0", "9" * 400).encode()],
    "an old clock": but(time_s=-1.0),
    "a clock of null": but(time_s=None),
    "taxels without end": but(taxels=[0] * 30_000),
}
OF_WELCOMES: dict[str, Answer] = {
    "no period": but(period_s=None),
    "a period of nothing": but(period_s=0.0),
    "a negative period": but(period_s=-1.0),
    "a period without end": but(period_s=1e308),
    "a period that is a text": but(period_s="x"),
}
CASES = [
    *(
        pytest.param(at, wrong, id=f"{at}, {name}")
        for at in ("observe", "act")
        for name, wrong in WRONG.items()
    ),
    *(pytest.param("observe", wrong, id=f"observe, {name}") for name, wrong in OF_STATES.items()),
    *(pytest.param("hello", wrong, id=f"hello, {name}") for name, wrong in (WRONG | OF_WELCOMES).items()),
]


@pytest.mark.parametrize(("at", "wrong"), CASES)
def test_any_answer_ends_in_an_error_and_a_stop(
    state: dict[str, Any], at: str, wrong: Answer, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(remote, "CONNECT_S", 0.5)
    monkeypatch.setattr(remote, "CALL_S", 0.5)
    before = set(threads())
    with server(state, wrong, at) as (address, seen):
        start_s = time.monotonic()
        driver = RemoteDriver(address, silence_s=0.3)
        with pytest.raises(HandError) as error, GuardedHand(driver, QUICK) as hand:
            for _ in range(4):
                hand.act(hand.nearest(hand.observe().q_desired_rad))
        assert len(str(error.value)) < 1000
        if at != "hello":
            assert time.monotonic() - start_s < 8.0 and "stop" in seen
            assert seen.count(at) > 1, "the answer before was right"
    # A call that had not come back is waited for, and what it held is given back.
    for thread in set(threads()) - before:
        thread.join(10.0)
    driver.close()
