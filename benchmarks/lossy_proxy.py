"""A bad link: a proxy between a client and the server of a remote hand that delays, doubles and loses messages."""

from __future__ import annotations

import random
import threading
import time
from collections.abc import Callable
from typing import Any

import zmq

from skincal.hand.messages import REPLIES, REQUESTS, Message, decode

Fate = Callable[[Message, bool], list[float]]
"""Of a message, and whether it goes to the hand: after which times copies of it are passed on [s]."""


def lossy(delay_s: float, lost: float, seed: int = 0) -> Fate:
    """Delay every message, and lose a share of them."""
    generator = random.Random(seed)
    return lambda message, forth: [] if generator.random() < lost else [delay_s]


class Proxy:
    """Stands between client and hand and mistreats messages: a function says what becomes of each."""

    def __init__(self, address: str, fate: Fate) -> None:
        self._context = zmq.Context()
        self._front = self._context.socket(zmq.ROUTER)
        self._front.linger = 0
        port = self._front.bind_to_random_port("tcp://127.0.0.1")
        self.address = f"tcp://127.0.0.1:{port}"
        self._back, self._fate, self._to = {}, fate, address
        self._late: list[tuple[float, Any, list[bytes]]] = []
        self._end = threading.Event()
        self._thread = threading.Thread(target=self._run)

    def __enter__(self) -> Proxy:
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._end.set()
        self._thread.join()
        self._context.destroy(linger=0)

    def _run(self) -> None:
        while not self._end.is_set():
            if self._front.poll(1):
                client, data = self._front.recv_multipart()
                if client not in self._back:
                    socket = self._context.socket(zmq.DEALER)
                    socket.linger = 0
                    socket.connect(self._to)
                    self._back[client] = socket
                self._post(self._back[client], [data], forth=True)
            for client, socket in self._back.items():
                while socket.poll(0):
                    self._post(self._front, [client, socket.recv()], forth=False)
            now = time.monotonic()
            for item in [item for item in self._late if item[0] <= now]:
                self._late.remove(item)
                item[1].send_multipart(item[2])

    def _post(self, socket: Any, parts: list[bytes], *, forth: bool) -> None:
        for delay_s in self._fate(decode(parts[-1], (*REQUESTS, *REPLIES)), forth):
            self._late.append((time.monotonic() + delay_s, socket, parts))
