"""A client's session at the server: its requests, in order, each done once."""

from __future__ import annotations

import time
from dataclasses import dataclass
from queue import Empty, SimpleQueue
from threading import Lock, Thread
from typing import TYPE_CHECKING, Any

from skincal.errors import quoted
from skincal.hand.checks import ContactForce
from skincal.hand.driver import HandCommand, HandDriver
from skincal.hand.errors import HandError
from skincal.hand.guard import GuardedHand
from skincal.hand.messages import Message, MessageError, number, numbers, refusal_body, state_body

if TYPE_CHECKING:
    from skincal.hand.serve import ServeOptions


MOST_WAITING = 8
"""Requests of a client that wait for their turn; a client that waits for its answers has one."""


@dataclass(frozen=True)
class Reply:
    """A message with its destination."""

    client: bytes
    message: Message


class Outbox:
    """Replies for the loop that sends them, which they wake."""

    def __init__(self, replies: SimpleQueue[Reply], context: Any, zmq: Any) -> None:
        self._replies, self._context, self._zmq = replies, context, zmq
        self._wake: Any = None

    def put(self, reply: Reply) -> None:
        """Add a reply, from the loop's own thread."""
        self._replies.put(reply)

    def put_and_wake(self, reply: Reply) -> None:
        """Add a reply from another thread, always the same."""
        self._replies.put(reply)
        try:
            if self._wake is None:
                self._wake = self._context.socket(self._zmq.PUSH)
                self._wake.linger = 0
                self._wake.connect("inproc://replies")
            self._wake.send(b"", self._zmq.NOBLOCK)
        except self._zmq.ZMQError:
            # The server has ended meanwhile; nobody waits for the reply.
            return

    def close(self) -> None:
        """Close the outbox to the other thread."""
        if self._wake is not None:
            self._wake.close()


class Session:
    """Executor of one client's requests, in a separate thread, so that a stop gets through at any time.

    Args:
        contact_force: computes the contact force; None: not checked.

    Attributes:
        over: whether the hand has been given back.
        trouble: failure of the last stop, which the client may not be there to hear of.
    """

    def __init__(
        self,
        token: str,
        driver: HandDriver,
        options: ServeOptions,
        contact_force: ContactForce | None,
        replies: Outbox,
    ) -> None:
        self.token = token
        self.over = False
        self.trouble: HandError | None = None
        self._options = options
        self._hand = GuardedHand(driver, options.guard_options, contact_force)
        self._replies = replies
        self._connected = False
        self._given_back = False
        self._requests: SimpleQueue[Message | None] = SimpleQueue()
        self._lock = Lock()
        self._number = 0
        self._heard_s = time.monotonic()
        self._client = b""
        self._last: Message | None = None
        self._observed = (0, 0.0)
        self._thread = Thread(target=self._work, name=f"session {driver.name}", daemon=True)
        self._thread.start()

    def takes(self, message: Message) -> bool:
        """Return whether a request is answered: a finished session answers only its last request and stop."""
        with self._lock:
            return not self.over or message.kind == "stop" or message.number <= self._number

    def request(self, client: bytes, message: Message) -> None:
        """Handle a request: do a new one, answer the last one again, ignore late older ones."""
        self._heard_s = time.monotonic()
        if message.kind == "stop":
            self._stop(client, message)
            return
        with self._lock:
            self._client = client
            if message.number > self._number and self._requests.qsize() >= MOST_WAITING:
                return  # nobody asks for more before an answer; what is dropped is asked for again
            if message.number > self._number:
                self._number, self._last = message.number, None
                self._requests.put(message)
            elif message.number == self._number:
                again = self._last or Message("wait", message.number, self.token)
                self._replies.put(Reply(client, again))

    def end(self, wait_s: float = 3.0) -> None:
        """Stop the hand and release it."""
        try:
            self._hand.stop()
        finally:
            self._requests.put(None)
            self._thread.join(wait_s)

    def _stop(self, client: bytes, message: Message) -> None:
        try:
            self._hand.stop()
            reply = Message("done", message.number, self.token)
        except HandError as error:
            reply = Message("refused", message.number, self.token, refusal_body(error))
        self._replies.put(Reply(client, reply))

    def _work(self) -> None:
        try:
            while (message := self._next()) is not None:
                reply = self._done(message)
                with self._lock:
                    self._last, client = reply, self._client
                self._replies.put_and_wake(Reply(client, reply))
                if message.kind == "bye" or self._hand.failure is not None or not self._connected:
                    break
        finally:
            self._give_back()
            self._answer_rest()
            self._replies.close()

    def _next(self) -> Message | None:
        """Return the next request; None if the session is over, or its client has fallen silent.

        The guard's watchdog no longer acts once the hand has been stopped; so the session checks for silence itself.
        """
        while True:
            try:
                return self._requests.get(timeout=self._options.watchdog_s / 4)
            except Empty:
                silent_s = time.monotonic() - self._heard_s
                if self._hand.failure is not None or silent_s > self._options.watchdog_s:
                    return None

    def _done(self, message: Message) -> Message:
        """Do a request; return the reply."""
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
        return Message("refused", message.number, self.token, refusal_body(refusal))

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
        if message.kind == "bye":
            # The hand is free for the next client when this client receives the reply.
            self._give_back()
            self.over = True
        return "done", {}

    def _check_fresh(self, message: Message) -> None:
        """Refuse a command whose state is too old, such as one that was delayed on its way."""
        answers, (observed, sent_s) = number(message, "answers"), self._observed
        age_s, limit_s = time.monotonic() - sent_s, self._options.command_age_s
        if answers != observed:
            raise HandError(
                f"the command answers message {answers:g}; the last state was {observed}", "command"
            )
        if age_s > limit_s:
            text = (
                f"the command came {age_s:.3g} s after the state that it answers, the limit is {limit_s:g} s"
            )
            raise HandError(text, "command", value=age_s, limit=limit_s)

    def _give_back(self) -> None:
        """Stop the hand and close it; a second call does nothing."""
        if self._given_back:
            return
        self._given_back = True
        self._stop_quietly()
        try:
            self._hand.close()
        except HandError:
            # The reply, or the failure of the guard, has reported this.
            return

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
                    body = refusal_body(HandError("the session is over", "lost"))
                    self._last = Message("refused", message.number, self.token, body)
                self._replies.put_and_wake(Reply(self._client, self._last))

    def _stop_quietly(self) -> None:
        """Stop the hand; the server reports a failure, and so does the client's own stop."""
        try:
            self._hand.stop()
            self.trouble = None
        except HandError as error:
            self.trouble = error
