"""Driver of a hand on another computer, by the messages of :mod:`skincal.hand.messages`.

A request without an answer is repeated with the same number, sooner the faster the link is; the server answers it
again and does nothing twice. Answers to earlier requests are discarded. If nothing arrives for ``silence_s``, the hand
is lost; the server's watchdog then stops it.
"""

from __future__ import annotations

import secrets
import time
from contextlib import suppress
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

from skincal.errors import input_error
from skincal.hand.driver import HandCommand, HandDriver, HandState
from skincal.hand.errors import HandError
from skincal.hand.messages import REPLIES, Message, MessageError, decode, encode, number, refusal_of, state_of
from skincal.hand.sockets import checked_address, client_keys, prepared, zmq_module
from skincal.robot import hand_named
from skincal.robot.description import HandDescription

if TYPE_CHECKING:
    import zmq


CALL_S, CONNECT_S, STOP_S = 5.0, 30.0, 0.4
"""Longest duration of a call, of connecting and of stopping while the server reports that it is busy [s]."""

MOST_SILENCE_S = 60.0
"""Largest time without an answer that may be asked for; the watchdog's largest [s]."""


class RemoteDriver(HandDriver):
    """The hand at an address.

    Args:
        address: address of the server.
        hand: description of the hand; the server must have the same.
        keys: folder with the keys of a client; needed for addresses of other computers.
        silence_s: time without an answer after which the hand is lost [s].

    Raises:
        InputError: the address needs keys, a file is invalid, or ``silence_s`` is out of bounds.
        WorkError: pyzmq is not installed.
    """

    name = "remote"

    def __init__(
        self,
        address: Annotated[str, "address of the server"] = "tcp://127.0.0.1:5555",
        *,
        hand: Annotated[str, "name of the hand, or its hand.toml; the same as the server's"] = "dlr_hand_2",
        keys: Annotated[Path | None, "folder client/ of a key pair, for other computers"] = None,
        silence_s: Annotated[float, "time without an answer after which the hand is lost [s]"] = 0.8,
    ) -> None:
        self._zmq = zmq_module()
        self._address = checked_address(address, keys=keys is not None, what="address")
        self._description = hand_named(hand)
        self._keys = None if keys is None else client_keys(keys)
        if not 0 < silence_s <= MOST_SILENCE_S:
            expected = f"a time above 0 s, {MOST_SILENCE_S:g} s at most"
            raise input_error('driver "remote", option silence_s', expected, silence_s)
        self._silence_s = silence_s
        self._context: zmq.Context[zmq.Socket[bytes]] | None = None
        self._socket: zmq.Socket[bytes] | None = None
        self._session = ""
        self._gone = False
        self._number = 0
        self._timers: dict[str, ResendTimer] = {}
        self._observed = 0
        self._period_s: float | None = None
        self._watchdog_s: float | None = None

    @property
    def description(self) -> HandDescription:
        """The hand by the client's description."""
        return self._description

    @property
    def period_s(self) -> float:
        """Time between two states [s]; the server reports it on connecting."""
        if self._period_s is None:
            raise HandError("period_s is known once the hand is connected", "order")
        return self._period_s

    def connect(self) -> None:
        """Connect to the hand, if it is free and has the same description."""
        self._shut()
        self._context = context = self._zmq.Context()
        self._session, self._number, self._gone = secrets.token_hex(16), 0, False
        hello = {"digest": self._description.digest, "hand": self._description.name}
        try:
            self._socket = prepared(context, self._zmq.DEALER, self._keys, self._address)
            welcome = self._ask("hello", hello, "welcome")
            self._period_s, self._watchdog_s = number(welcome, "period_s"), number(welcome, "watchdog_s")
            self.real_time = welcome.body.get("real_time") is not False
        except BaseException as error:
            self._shut()
            if isinstance(error, MessageError):
                raise HandError(str(error), "refused") from error
            raise

    def observe(self) -> HandState:
        """Return the next state, for which the server waits."""
        reply = self._ask("observe", {}, "state")
        try:
            state = state_of(reply)
        except MessageError as error:
            raise HandError(str(error), "state") from error
        self._observed = reply.number
        return state

    def act(self, command: HandCommand) -> None:
        """Send a command; the server refuses it if the state that it answers is no longer fresh."""
        angles = [float(q) for q in command.q_desired_rad]
        self._ask("act", {"q_desired_rad": angles, "answers": self._observed}, "done")

    def stop(self) -> None:
        """Stop the hand over a separate connection, so that it works while another call waits."""
        if not self._session:
            return
        context: zmq.Context[zmq.Socket[bytes]] = self._zmq.Context()
        socket = None
        try:
            socket = prepared(context, self._zmq.DEALER, self._keys, self._address)
            self._exchange(socket, Message("stop", 1, self._session), "done", STOP_S)
        except HandError as error:
            if error.kind != "lost":
                raise
            watchdog = "" if self._watchdog_s is None else f" within {self._watchdog_s:g} s"
            text = f"{str(error).rstrip('.')}. If the hand's side still runs, its watchdog stops the hand{watchdog}"
            raise HandError(text, "lost") from error
        finally:
            if socket is not None:
                socket.close()
            context.term()

    def close(self) -> None:
        """Release the hand, if the server still responds."""
        try:
            if self._socket is not None and not self._gone:
                self._ask("bye", {}, "done")
        except HandError as error:
            if error.kind not in ("lost", "refused"):
                raise
        finally:
            self._shut()

    def _shut(self) -> None:
        if self._socket is not None:
            self._socket.close()
        if self._context is not None:
            self._context.term()
        self._context, self._socket, self._session = None, None, ""

    def _ask(self, kind: str, body: dict[str, Any], expected: str) -> Message:
        if self._socket is None:
            raise HandError(f"{kind}: the hand is not connected", "order")
        self._number += 1
        request = Message(kind, self._number, self._session, body)
        return self._exchange(self._socket, request, expected, CONNECT_S if kind == "hello" else CALL_S)

    def _exchange(
        self, socket: zmq.Socket[bytes], request: Message, expected: str, limit_s: float
    ) -> Message:
        """Repeat a request until it is answered; return the answer."""
        start = heard = now = time.monotonic()
        silence_s = min(self._silence_s, limit_s)
        data, sent = encode(request), 0
        # A stop comes from any thread and shares no timer.
        own = ResendTimer()
        timer = own if request.kind == "stop" else self._timers.setdefault(request.kind, own)
        while True:
            with suppress(self._zmq.Again):  # the queue is full because nobody reads it: treat it as silence
                socket.send(data, self._zmq.NOBLOCK)
            sent += 1
            left_s = min(heard + silence_s, start + limit_s) - now
            reply = self._answer(socket, request, expected, min(timer.wait_s, left_s))
            now = time.monotonic()
            if reply is not None and reply.kind == "refused":
                raise refusal_of(reply)
            if reply is not None and reply.kind == expected:
                if sent == 1:
                    timer.answered(now - start)
                return reply
            timer.repeated()
            if reply is not None:
                heard = now
            if now - heard >= silence_s or now - start >= limit_s:
                self._gone = request.kind != "stop"
                raise self._lost(request.kind, now - heard)

    def _answer(
        self, socket: zmq.Socket[bytes], request: Message, expected: str, wait_s: float
    ) -> Message | None:
        """Return the answer to a request, or after the wait a message that the server is busy with it.

        Earlier answers, and those of other sessions, are discarded.
        """
        deadline, busy = time.monotonic() + wait_s, None
        while (left_s := deadline - time.monotonic()) > 0:
            if not socket.poll(max(1, int(left_s * 1e3))):
                continue
            try:
                reply = decode(socket.recv(), REPLIES)
            except MessageError as error:
                raise HandError(
                    f"{self._address} does not speak this protocol: {error}", "refused"
                ) from error
            own = (reply.number, reply.session) == (request.number, request.session)
            if not own and reply.session != "-":
                continue
            if reply.kind in (expected, "refused"):
                return reply
            busy = reply
        return busy

    def _lost(self, kind: str, silent_s: float) -> HandError:
        keys = "without keys" if self._keys is None else "with these keys"
        text = f"{self._address} has not answered {kind} for {silent_s:.2g} s"
        if kind == "hello":
            text += f": no server listens there, or none that admits a client {keys}"
        return HandError(text, "lost")


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
