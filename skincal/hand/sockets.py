"""ZeroMQ sockets for a remote hand: loopback without keys, any other address with a key pair on both sides.

Keys are CURVE certificates in two folders. ``hand/`` stays on the hand's computer: its own key ``hand.key_secret``,
and in ``allowed/`` the public keys of all clients that may move it. ``client/`` goes to the client, with its own key
``client.key_secret`` and the public key of the hand, ``hand.key``.
"""

from __future__ import annotations

import importlib
import ipaddress
import re
import struct
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from skincal.bounded import UnreadableError, read_bytes
from skincal.errors import InputError, WorkError, input_error
from skincal.files import reason, whole_folder
from skincal.hand.messages import MAX_BYTES

if TYPE_CHECKING:
    import zmq

HANDSHAKE_MS = 5000
"""Longest time from the beginning of a connection until both sides have shown their keys [ms]."""

LAST_PORT = 65535

INSTALL = "pip install 'skincal[remote]'"


def zmq_module() -> Any:
    """Return the module ``zmq``.

    Raises:
        WorkError: pyzmq is not installed.
    """
    try:
        zmq = importlib.import_module("zmq")
        importlib.import_module("zmq.auth.thread")
    except ImportError as error:
        raise WorkError(f"a remote hand needs pyzmq, which is not installed: {INSTALL}") from error
    return zmq


@dataclass(frozen=True)
class Keys:
    """Keys of one side, and those that it trusts.

    Attributes:
        public: own public key.
        secret: own secret key.
        server: public key of the hand, at a client; None at the hand.
        allowed: public keys of the clients, at the hand.
    """

    public: bytes
    secret: bytes
    server: bytes | None = None
    allowed: frozenset[bytes] = frozenset()

    def callback(self, domain: str, key: bytes) -> bool:
        """Return whether ZeroMQ may admit a client."""
        return key in self.allowed


def make_keys(folder: Path, *, force: bool = False) -> None:
    """Write a key pair for a hand and one for a client that it trusts.

    Raises:
        InputError: the folder exists.
        WorkError: pyzmq is not installed.
    """
    auth = zmq_module().auth
    with whole_folder(folder, force=force, marker="hand/hand.key_secret") as out:
        hand, client = out / "hand", out / "client"
        (hand / "allowed").mkdir(parents=True)
        client.mkdir()
        for place, name in ((hand, "hand"), (client, "client")):
            # create_certificates writes the secret with the process's mask; nobody else may read it, even for a moment.
            place.chmod(0o700)
            _, secret = auth.create_certificates(place, name)
            Path(secret).chmod(0o600)
        (hand / "hand.key").replace(client / "hand.key")
        (client / "client.key").replace(hand / "allowed" / "client.key")
        (out / "README.txt").write_text(README, encoding="utf-8")


def hand_keys(folder: Path) -> Keys:
    """Return the keys of the server from its folder.

    Raises:
        InputError: a file in it is not a key.
    """
    public, secret = _key_pair(folder / "hand.key_secret")
    allowed = folder / "allowed"
    clients = sorted(allowed.glob("*.key"))
    if not clients:
        fix = "Put the public key (NAME.key) of every client that may move the hand there."
        raise input_error(str(allowed), "at least one public key of a client", "none", fix)
    return Keys(public, secret, allowed=frozenset(_certificate(path)[0] for path in clients))


def client_keys(folder: Path) -> Keys:
    """Return the keys of a client from its folder.

    Raises:
        InputError: a file in it is not a key.
    """
    public, secret = _key_pair(folder / "client.key_secret")
    return Keys(public, secret, server=_certificate(folder / "hand.key")[0])


def checked_address(address: str, *, keys: bool, what: str) -> str:
    """Return an address after checking it.

    Args:
        address: ``tcp://HOST:PORT`` or ``ipc://FILE``.
        keys: whether there is a key pair.
        what: name of the option, for errors.

    Raises:
        InputError: the address is invalid, or would need keys.
    """
    scheme, _, rest = address.partition("://")
    host, colon, port = rest.rpartition(":")
    if scheme == "ipc" and rest:
        return address
    # ZeroMQ takes a port beyond the last one for another port.
    is_port = port == "*" or (re.fullmatch("[0-9]{1,5}", port) is not None and int(port) <= LAST_PORT)
    if scheme != "tcp" or not colon or not host or not is_port:
        raise input_error(what, "an address such as tcp://127.0.0.1:5555", f'"{address}"')
    if not keys and not _is_loopback(host):
        expected = "a loopback address (tcp://127.0.0.1:PORT), or keys for any other"
        fix = "`skincal hand keys --out keys` makes a pair for both sides."
        raise input_error(what, expected, f'"{address}" without keys', fix)
    return address


def prepared(
    context: zmq.Context[zmq.Socket[bytes]], kind: int, keys: Keys | None, connect: str | None = None
) -> zmq.Socket[bytes]:
    """Return a socket that drops pending messages when closed, refuses large messages, and uses the keys, if any.

    It is connected if an address is given.
    """
    socket = context.socket(kind)
    try:
        socket.linger = 0
        socket.maxmsgsize = MAX_BYTES
        socket.heartbeat_ivl, socket.heartbeat_timeout = 500, 2000
        # Connections that say nothing hold places that others need.
        socket.handshake_ivl = HANDSHAKE_MS
        if keys is not None:
            socket.curve_publickey, socket.curve_secretkey = keys.public, keys.secret
            if keys.server is None:
                socket.curve_server = True
            else:
                socket.curve_serverkey = keys.server
        if connect is not None:
            socket.connect(connect)
    except BaseException:
        # An open socket would keep its context from ending, for ever.
        socket.close()
        raise
    return socket


def _is_loopback(host: str) -> bool:
    if host == "localhost":
        return True
    try:
        return ipaddress.ip_address(host.strip("[]")).is_loopback
    except ValueError:
        return False


def _key_pair(path: Path) -> tuple[bytes, bytes]:
    """Return a public and secret key that belong to each other."""
    public, secret = _certificate(path)
    if secret is None:
        raise _no_key(path, "a key file with a secret key", "a public key alone")
    if zmq_module().curve_public(secret) != public:
        raise _no_key(path, "a public and a secret key that are a pair", "keys of two pairs")
    return public, secret


def _certificate(path: Path) -> tuple[bytes, bytes | None]:
    """Public and secret key of a file, each of the form that ZeroMQ takes: with others its sockets fail, or hang.

    It is read here, as pyzmq's own reader opens pipes and devices too.
    """
    try:
        content = read_bytes(path, MAX_BYTES)
    except UnreadableError:
        raise _no_key(path, "a key file", "a large one") from None
    except OSError as error:
        raise _no_key(path, "a key file", reason(error)) from None
    keys = {key[1]: key[2] for line in content.splitlines() if (key := _KEY.match(line))}
    for name, key in keys.items():
        if not _is_z85(key):
            got = f"{len(key)} letters" if len(key) != KEY_LENGTH else "others"
            raise _no_key(path, f"a {name.decode()}-key of {KEY_LENGTH} letters of Z85", got)
    if b"public" not in keys:
        raise _no_key(path, "a key file", "no public key in it")
    return keys[b"public"], keys.get(b"secret")


def _is_z85(key: bytes) -> bool:
    """Return whether bytes are a key of 32 bytes in Z85 (ZeroMQ RFC 32)."""
    try:
        importlib.import_module("zmq.utils.z85").decode(key)
    except (ValueError, KeyError, struct.error):
        return False
    return len(key) == KEY_LENGTH


def _no_key(path: Path, expected: str, got: str) -> InputError:
    fix = "`skincal hand keys --out keys` makes a pair; give hand/ to serve-hand and client/ to the driver remote."
    return input_error(str(path), expected, got, fix)


KEY_LENGTH = 40

_KEY = re.compile(rb"""\s*(public|secret)-key\s*=[ \t'"]*(.*?)[ \t'"]*$""")
"""A line of a CURVE certificate (ZPL) that holds a key."""

README = """Keys of a remote hand, made by `skincal hand keys`.

hand/    stays on the hand's computer:   skincal serve-hand --bind tcp://ADDRESS:PORT --keys hand
client/  goes to the client's computer:  --driver remote --driver-option address=tcp://ADDRESS:PORT
                                         --driver-option keys=client

Copy client/ over a private channel, and keep the files *.key_secret secret. Every client whose public
key is in hand/allowed may move the hand; to revoke this, remove the file and restart serve-hand.
"""
