"""The server of a remote hand: one client at a time, behind its own guard.

The guard here enforces the limits a second time, next to the hand, and is the watchdog: if no request has come for
``watchdog_s`` - the client died or hangs, or the network is gone - the hand is stopped and released.
"""

from __future__ import annotations

import os
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass, field, replace
from pathlib import Path
from threading import Event
from types import TracebackType
from typing import Any, NoReturn, Self

from skincal.bounded import memory_bytes
from skincal.errors import SkincalError, text_of
from skincal.hand.calls import STOPPED, CallExitError, CallTimeoutError, call_and_leave
from skincal.hand.client_session import Session
from skincal.hand.driver import HandDriver
from skincal.hand.errors import HandError
from skincal.hand.guard import ContactForce
from skincal.hand.guard_options import GuardOptions
from skincal.hand.messages import REQUESTS, Message, MessageError, decode, encode, refusal_body
from skincal.hand.sockets import Keys, checked_address, prepared, zmq_module
from skincal.robot import HandDescription, check_limits

POLL_MS = 100
REPLIES = "inproc://replies"
MOST_BYTES = min(1 << 30, memory_bytes() // 4)
"""Memory that a server may take after it has begun; a driver that needs more loads it before [bytes]."""

MAKE_S = 10.0
"""Longest time to create a driver for later clients [s]."""


@dataclass(frozen=True)
class ServeOptions:
    """Options of the server.

    Attributes:
        watchdog_s: time of a client's silence after which the hand is stopped [s].
        command_age_s: largest age of the state that a command answers; later commands are refused [s].
        guard: limits and times of the guard; its ``idle_s`` is the watchdog's.
    """

    watchdog_s: float = 2.0
    command_age_s: float = 0.5
    guard: GuardOptions = field(default_factory=GuardOptions)

    @property
    def guard_options(self) -> GuardOptions:
        """Return the options of the guard, with the watchdog."""
        return replace(self.guard, idle_s=self.watchdog_s)


class HandServer:
    """Server of a hand: a context manager that binds and unbinds.

    Args:
        make: creates the driver; called for every client, so that each finds a fresh hand.
        bind: address to listen at; ``tcp://127.0.0.1:*`` takes any free port.
        keys: keys of the server; needed for addresses of other computers.
        options: times.
        contact_force: creates the function that computes the contact force; None: not checked here.

    Raises:
        InputError: the address needs keys, or the limits of the hand are beyond those of any finger.
        WorkError: pyzmq is not installed, or the address is taken.
    """

    def __init__(
        self,
        make: Callable[[], HandDriver],
        bind: str = "tcp://127.0.0.1:5555",
        *,
        keys: Keys | None = None,
        options: ServeOptions | None = None,
        contact_force: Callable[[HandDescription], ContactForce] | None = None,
    ) -> None:
        self._zmq = zmq_module()
        self._bind = checked_address(bind, keys=keys is not None, what="--bind")
        self._make, self._keys, self._options = make, keys, options or ServeOptions()
        self._driver: HandDriver | None = make()
        self._description = self._driver.description
        # Now, as it may have to compile: clients wait for less than that.
        self._force = None if contact_force is None else contact_force(self._description)
        check_limits(self._description, beyond=self._options.guard.beyond_limits)
        self._session: Session | None = None
        self._authenticator: Any = None
        self._ended = Event()
        self.sessions = 0
        self.address = bind

    def __enter__(self) -> Self:
        """Bind."""
        zmq = self._zmq
        self._context = zmq.Context()
        try:
            if self._keys is not None:
                self._authenticator = zmq.auth.thread.ThreadAuthenticator(self._context)
                self._authenticator.start()
                self._authenticator.configure_curve_callback(domain="*", credentials_provider=self._keys)
            self._socket = prepared(self._context, zmq.ROUTER, self._keys)
            self._socket.bind(self._bind)
            self._replies = self._context.socket(zmq.PULL)
            self._replies.bind(REPLIES)
        except zmq.ZMQError as error:
            self._unbind()
            raise HandError(f"cannot listen at {self._bind}: {text_of(error)}", "refused") from error
        self.address = str(self._socket.get_string(zmq.LAST_ENDPOINT)).rstrip("\0")
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        """Stop the hand, release it, and unbind."""
        try:
            if self._session is not None:
                self._session.end()
        finally:
            self._unbind()

    def run(self, *, sessions: int | None = None) -> None:
        """Serve until :meth:`end` is called, or until a number of sessions have ended.

        Raises:
            HandError: a client is gone, and the hand could not be stopped; or messages without an end fill the memory.
        """
        least_bytes = _taken_bytes()
        poller = self._zmq.Poller()
        poller.register(self._socket, self._zmq.POLLIN)
        poller.register(self._replies, self._zmq.POLLIN)
        while not self._ended.is_set():
            ready = dict(poller.poll(POLL_MS))
            if self._socket in ready:
                parts = self._socket.recv_multipart()
                self._handle(parts[0], parts[-1])
            while self._replies.poll(0):
                self._send(self._replies.recv_multipart())
            taken_bytes = _taken_bytes()
            least_bytes = min(least_bytes, taken_bytes)  # what was there before may be freed meanwhile
            if taken_bytes - least_bytes > MOST_BYTES:
                self._overrun()
            over = self._session is None or self._session.over
            if over and self._session is not None and self._session.trouble is not None:
                raise self._session.trouble
            if sessions is not None and over and self.sessions >= sessions:
                return

    def _overrun(self) -> NoReturn:
        """End before the system kills this process, and with it whatever could stop the hand.

        ZeroMQ bounds the parts of a message and the number of whole messages, but not the number of parts.
        """
        if self._session is not None:
            self._session.end()
        text = (
            f"this server has taken {MOST_BYTES >> 20} MiB of memory since it began, as a client that sends a message "
            f"without an end makes it do. {STOPPED} Find out who it was, and start the server again."
        )
        raise HandError(text, "refused", stopped=True)

    def end(self) -> None:
        """Make :meth:`run` return; callable from any thread."""
        self._ended.set()

    def _handle(self, client: bytes, data: bytes) -> None:
        try:
            message = decode(data, REQUESTS)
        except MessageError as error:
            self._refuse(client, Message("hello", 0, "-"), str(error))
            return
        session = self._session
        mine = session is not None and session.token == message.session
        if message.kind == "hello" and not mine:
            self._welcome(client, message)
        elif session is None or not mine or not session.accepts(message):
            text = "there is no such session: it is over, or the server was restarted"
            self._refuse(client, message, text, "lost")
        elif (reply := session.request(client, message)) is not None:
            self._send([client, encode(reply)])

    def _welcome(self, client: bytes, message: Message) -> None:
        """Start a session, if the hand is free and the descriptions agree."""
        digest, description = message.body.get("digest"), self._description
        if self._session is not None and not self._session.over:
            text = "another client has the hand; it is free when that client closes it or falls silent"
            self._refuse(client, message, text)
            return
        if digest != description.digest:
            text = (
                f'the hand here is "{description.name}" (SHA-256 {description.digest[:12]}...), the client\'s is '
                f'"{message.body.get("hand")}" ({str(digest)[:12]}...): both need the same hand.toml and URDF'
            )
            self._refuse(client, message, text)
            return
        try:
            # The loop goes on, whatever happens while another one is made.
            driver = self._driver or call_and_leave(self._make, MAKE_S, "make a driver")
            self._driver = None
        except (SkincalError, CallTimeoutError, CallExitError) as error:
            self._refuse(client, message, text_of(error) or f"the driver was not created within {MAKE_S:g} s")
            return
        self.sessions += 1
        wire = self._context.socket(self._zmq.PUSH)
        wire.linger = 0
        wire.connect(REPLIES)
        self._session = Session(message.session, driver, self._options, self._force, wire)
        self._session.request(client, message)

    def _refuse(self, client: bytes, message: Message, text: str, kind: Any = "refused") -> None:
        body = refusal_body(HandError(text, kind))
        self._send([client, encode(Message("refused", message.number, message.session, body))])

    def _send(self, frames: list[bytes]) -> None:
        # The client is gone, or does not read: it repeats the request, or the watchdog stops the hand.
        with suppress(self._zmq.ZMQError):
            self._socket.send_multipart(frames, self._zmq.NOBLOCK)

    def _unbind(self) -> None:
        if self._authenticator is not None:
            self._authenticator.stop()
        self._context.destroy(linger=0)


def _taken_bytes() -> int:
    """Return the memory that this process holds; 0 where the system does not tell."""
    try:
        return int(Path("/proc/self/statm").read_text().split()[1]) * os.sysconf("SC_PAGE_SIZE")
    except OSError:
        return 0
