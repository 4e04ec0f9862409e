"""A client's session at the server: its requests, in order, each done once."""

from __future__ import annotations

import time
from contextlib import suppress
from queue import Empty, SimpleQueue
from threading import Lock, Thread
from typing import TYPE_CHECKING, Any

from skincal.errors import quoted
from skincal.hand.driver import HandCommand, HandDriver
from skincal.hand.errors import HandError
from skincal.hand.guard import ContactForce, GuardedHand
from skincal.hand.messages import Message, MessageError, encode, number, numbers, refusal_body, state_body
from skincal.hand.sockets import zmq_module

if TYPE_CHECKING:
    import zmq

    from skincal.hand.serve import ServeOptions


MOST_WAITING = 8
"""Requests of a client that wait for their turn; a client that waits for its answers has one."""

LONGEST_END_S = 3.0
"""Longest time for which the end of a session is waited for [s]."""


class Session:
    """Executor of one client's requests, in a separate thread, so that a stop gets through at any time.

    Args:
        contact_force: computes the contact force; None: not checked.
        wire: socket to the server's loop, on which the session's thread sends replies, each after its client's name.

    Attributes:
        over: whether the hand has been released.
        trouble: failure of the last stop, which the client may not be there to receive.
    """

    def __init__(
        self,
        token: str,
        driver: HandDriver,
        options: ServeOptions,
        contact_force: ContactForce | None,
        wire: zmq.Socket[bytes],
    ) -> None:
        self.token = token
        self.over = False
        self.trouble: HandError | None = None
        self._options = options
        self._hand = GuardedHand(driver, options.guard_options, contact_force)
        self._wire = wire
        self._connected = False
        self._released = False
        self._requests: SimpleQueue[Message | None] = SimpleQueue()
        self._lock = Lock()
        self._number = 0
        self._request_s = time.monotonic()
        self._client = b""
        self._last: Message | None = None
        self._observed = (0, 0.0)
        self._thread = Thread(target=self._work, name=f"session {driver.name}", daemon=True)
        self._thread.start()

    def accepts(self, message: Message) -> bool:
        """Return whether a request is answered: a finished session answers only its last request and stop."""
        with self._lock:
            return not self.over or message.kind == "stop" or message.number <= self._number

    def request(self, client: bytes, message: Message) -> Message | None:
        """Handle a request: do a new one, answer the last one again, ignore late older ones.

        Return the reply; None: it comes later, or not at all.
        """
        self._request_s = time.monotonic()
        if message.kind == "stop":
            return self._stop(message)
        with self._lock:
            self._client = client
            if message.number == self._number:
                return self._last or Message("wait", message.number, self.token)
            # Nobody asks for more before an answer; what is dropped is asked for again.
            if message.number > self._number and self._requests.qsize() < MOST_WAITING:
                self._number, self._last = message.number, None
                self._requests.put(message)
        return None

    def end(self) -> None:
        """Stop the hand and release it."""
        try:
            self._hand.stop()
        finally:
            self._requests.put(None)
            self._thread.join(LONGEST_END_S)

    def _stop(self, message: Message) -> Message:
        try:
            self._hand.stop()
        except HandError as error:
            return self._refusal(message, error)
        return Message("done", message.number, self.token)

    def _refusal(self, message: Message, error: HandError) -> Message:
        return Message("refused", message.number, self.token, refusal_body(error))

    def _work(self) -> None:
        try:
            while (message := self._next()) is not None:
                reply = self._reply_to(message)
                with self._lock:
                    self._last, client = reply, self._client
                self._send(client, reply)
                if message.kind == "bye" or self._hand.failure is not None or not self._connected:
                    break
        finally:
            self._release()
            self._answer_rest()
            self._wire.close()

    def _send(self, client: bytes, message: Message) -> None:
        zmq = zmq_module()
        with suppress(zmq.ZMQError):  # the server has ended meanwhile; nobody waits for the reply
            self._wire.send_multipart([client, encode(message)], zmq.NOBLOCK)

    def _next(self) -> Message | None:
        """Return the next request; None if the session is over, or its client has fallen silent.

        The guard's watchdog no longer acts once the hand has been stopped; so the session checks for silence itself.
        """
        while True:
            try:
                return self._requests.get(timeout=self._options.watchdog_s / 4)
            except Empty:
                silent_s = time.monotonic() - self._request_s
                if self._hand.failure is not None or silent_s > self._options.watchdog_s:
                    return None

    def _reply_to(self, message: Message) -> Message:
        try:
            kind, body = self._do(message)
            return Message(kind, message.number, self.token, body)
        except MessageError as error:
            refusal = HandError(str(error), "refused")
        except HandError as error:
            refusal = error
        except Exception as error:
            refusal = HandError(quoted(error), "driver")
        self._stop_quietly()
        return self._refusal(message, refusal)

    def _do(self, message: Message) -> tuple[str, dict[str, Any]]:
        hand = self._hand
        if message.kind == "hello":
            hand.connect()
            self._connected = True
            times = {"period_s": hand.period_s, "watchdog_s": self._options.watchdog_s}
            return "welcome", {**times, "real_time": hand.real_time}
        if message.kind == "observe":
            state = hand.observe()
            self._observed = (message.number, time.monotonic())
            return "state", state_body(state)
        if message.kind == "act":
            self._check_fresh(message)
            hand.act(HandCommand(numbers(message, "q_desired_rad")))
            return "done", {}
        if message.kind == "bye":
            # The hand is free for the next client when this client receives the reply.
            self._release()
            self.over = True
            return "done", {}
        raise MessageError(f'expected a request of a session; got "{message.kind}"')

    def _check_fresh(self, message: Message) -> None:
        """Refuse a command whose state is too old, such as one that was delayed on its way."""
        answers, (observed, sent_s) = number(message, "answers"), self._observed
        age_s, limit_s = time.monotonic() - sent_s, self._options.command_age_s
        if answers != observed:
            text = f"the command answers message {answers:g}; the last state was {observed}"
            raise HandError(text, "command")
        if age_s > limit_s:
            text = (
                f"the command came {age_s:.3g} s after the state that it answers, the limit is {limit_s:g} s"
            )
            raise HandError(text, "command", value=age_s, limit=limit_s)

    def _release(self) -> None:
        """Stop the hand and close it; a second call does nothing."""
        if self._released:
            return
        self._released = True
        self._stop_quietly()
        with suppress(HandError):  # the reply, or the failure of the guard, has reported it
            self._hand.close()

    def _answer_rest(self) -> None:
        """Answer the requests that came in while the session was ending."""
        with self._lock:
            self.over = True
            while not self._requests.empty():
                message = self._requests.get()
                if message is None:
                    continue
                self._last = Message("done", message.number, self.token)
                if message.kind != "bye":
                    self._last = self._refusal(message, HandError("the session is over", "lost"))
                self._send(self._client, self._last)

    def _stop_quietly(self) -> None:
        """Stop the hand; the server reports a failure, and so does the client's own stop."""
        try:
            self._hand.stop()
            self.trouble = None
        except HandError as error:
            self.trouble = error
