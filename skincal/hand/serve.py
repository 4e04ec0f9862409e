"""The hand's side of a remote hand: one client at a time, behind a guard of its own.

The guard here keeps the limits a second time, next to the hand, and is the watchdog: when no request has come for
``watchdog_s`` - the client died, hangs, or the network is gone - the hand is stopped and given back.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from queue import Empty, SimpleQueue
from threading import Event
from types import TracebackType
from typing import Any, Self

from skincal.errors import SkincalError
from skincal.hand.checks import ContactForce
from skincal.hand.driver import HandDriver
from skincal.hand.errors import HandError
from skincal.hand.messages import REQUESTS, Message, MessageError, decode, encode, refusal_body
from skincal.hand.options import GuardOptions
from skincal.hand.session import Outbox, Reply, Session
from skincal.hand.sockets import Keys, checked_address, prepared, zmq_module
from skincal.hand.worker import CallExitError, CallTimeoutError, Worker
from skincal.robot import HandDescription, check_limits

POLL_MS = 100
MAKE_S = 10.0
"""Making a driver may take so long, for a second client and later ones [s]."""


@dataclass(frozen=True)
class ServeOptions:
    """How a hand is served.

    Attributes:
        watchdog_s: the hand is stopped when its client sends nothing for so long [s].
        command_age_s: a command that answers a state which was sent longer ago is refused [s].
        guard: limits and times of the guard; its ``idle_s`` is the watchdog's.
    """

    watchdog_s: float = 2.0
    command_age_s: float = 0.5
    guard: GuardOptions = field(default_factory=GuardOptions)

    @property
    def guard_options(self) -> GuardOptions:
        """Those of the guard, with the watchdog."""
        return replace(self.guard, idle_s=self.watchdog_s)


class HandServer:
    """Serves a hand until told to end; a context manager that binds and unbinds.

    Args:
        make: makes the driver; called anew for every client, so that each finds the hand fresh.
        bind: address to listen at; ``tcp://127.0.0.1:*`` takes any free port.
        keys: keys of the hand's side; needed for any address that is not of this computer.
        options: times.
        contact_force: makes the function that tells the contact force; None: it is not checked here.

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
        self._contact_force = contact_force
        self._driver: HandDriver | None = make()
        self._description = self._driver.description
        check_limits(self._description, beyond=self._options.guard.beyond_limits)
        self._session: Session | None = None
        self._authenticator: Any = None
        self._replies: SimpleQueue[Reply] = SimpleQueue()
        self._ended = Event()
        self.sessions = 0
        self.address = bind

    def __enter__(self) -> Self:
        """Binds."""
        zmq = self._zmq
        self._context = zmq.Context()
        try:
            if self._keys is not None:
                self._authenticator = zmq.auth.thread.ThreadAuthenticator(self._context)
                self._authenticator.start()
                self._authenticator.configure_curve_callback(domain="*", credentials_provider=self._keys)
            self._socket = prepared(self._context, zmq.ROUTER, self._keys)
            self._socket.bind(self._bind)
            self._wake = self._context.socket(zmq.PULL)
            self._wake.bind("inproc://replies")
        except zmq.ZMQError as error:
            self._unbind()
            raise HandError(f"cannot listen at {self._bind}: {error}", "refused") from error
        self.address = str(self._socket.get_string(zmq.LAST_ENDPOINT)).rstrip("\0")
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        """Stops the hand, gives it back, and unbinds."""
        try:
            if self._session is not None:
                self._session.end()
        finally:
            self._unbind()

    def run(self, *, sessions: int | None = None) -> None:
        """Serves until :meth:`end` is called, or so many sessions are over."""
        poller = self._zmq.Poller()
        poller.register(self._socket, self._zmq.POLLIN)
        poller.register(self._wake, self._zmq.POLLIN)
        while not self._ended.is_set():
            ready = dict(poller.poll(POLL_MS))
            if self._wake in ready:
                self._wake.recv()
            if self._socket in ready:
                parts = self._socket.recv_multipart()
                self._handle(parts[0], parts[-1])
            self._send_replies()
            over = self._session is None or self._session.over
            if sessions is not None and over and self.sessions >= sessions:
                return

    def end(self) -> None:
        """Lets :meth:`run` return; from any thread."""
        self._ended.set()

    def _handle(self, client: bytes, data: bytes) -> None:
        try:
            message = decode(data, REQUESTS)
        except MessageError as error:
            nobody = Message("refused", 0, "-", refusal_body(HandError(str(error), "refused")))
            self._send(Reply(client, nobody))
            return
        session = self._session
        mine = session is not None and session.token == message.session
        if message.kind == "hello" and not mine:
            self._welcome(client, message)
        elif session is None or not mine or not session.takes(message):
            text = "there is no such session: it is over, or the hand's side has been started anew"
            self._refuse(client, message, text, "lost")
        else:
            session.request(client, message)

    def _welcome(self, client: bytes, message: Message) -> None:
        """Begins a session, if the hand is free and it is the same hand."""
        digest, description = message.body.get("digest"), self._description
        if self._session is not None and not self._session.over:
            text = "another client has the hand; it is free when that one closes it or falls silent"
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
            driver, self._driver = self._driver or self._made(), None
        except (SkincalError, CallTimeoutError, CallExitError) as error:
            self._refuse(client, message, str(error) or f"the driver was not made within {MAKE_S:g} s")
            return
        force = None if self._contact_force is None else self._contact_force(description)
        self.sessions += 1
        replies = Outbox(self._replies, self._context, self._zmq)
        self._session = Session(message.session, driver, self._options, force, replies)
        self._session.request(client, message)

    def _made(self) -> HandDriver:
        """Another driver; whatever its making does, the loop goes on."""
        worker = Worker("make a driver")
        try:
            return worker.call(self._make, timeout_s=MAKE_S)
        finally:
            worker.end()

    def _refuse(self, client: bytes, message: Message, text: str, kind: Any = "refused") -> None:
        body = refusal_body(HandError(text, kind))
        self._send(Reply(client, Message("refused", message.number, message.session, body)))

    def _send_replies(self) -> None:
        while True:
            try:
                self._send(self._replies.get_nowait())
            except Empty:
                return

    def _send(self, reply: Reply) -> None:
        try:
            self._socket.send_multipart([reply.client, encode(reply.message)], self._zmq.NOBLOCK)
        except self._zmq.ZMQError:
            # The client is gone, or takes nothing: it asks again, or the watchdog stops the hand.
            return

    def _unbind(self) -> None:
        if self._authenticator is not None:
            self._authenticator.stop()
        self._context.destroy(linger=0)
