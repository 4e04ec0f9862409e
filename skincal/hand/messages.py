"""Messages between a remote hand and its client: small JSON objects, one per message.

Every message is one ZeroMQ frame of UTF-8 JSON, at most 64 KiB, and holds

``v``
    ``"skincal-hand/1"``; another version is refused.
``kind``
    the kind, see below.
``id``
    whole number: requests count up within a session; a reply has that of its request.
``session``
    text: the session, chosen at random by the client.

and, by kind, of requests:

``hello``
    ``digest``: SHA-256 of the hand's description; ``hand``: its name.
``observe``, ``stop``, ``bye``
    no further fields.
``act``
    ``q_desired_rad``; ``answers``: the ``id`` of the ``observe`` whose state the command answers.

and of replies:

``welcome``
    ``period_s``; ``watchdog_s``: a client that is silent for this long loses the hand; ``real_time``: false where the
    hand's clock does not run as fast as ours, as it is simulated; true where it is left out.
``state``
    the fields of a :class:`~skincal.hand.driver.HandState`.
``done``, ``wait``
    no further fields; ``wait`` answers a repeated request that is still in progress.
``refused``
    ``error``: the kind of a :class:`~skincal.hand.errors.HandError`; ``text``; ``joint``, ``value``, ``limit`` or null.

NaN is sent as ``null``. A client that repeats a request, with the same id, gets the same answer; nothing is done
twice. No content is ever executed or unpickled.
"""

from __future__ import annotations

import json
import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, cast

import numpy as np

from skincal.bounded import UnreadableError, parse_json
from skincal.bounded import decode as decode_text
from skincal.hand.driver import HandState
from skincal.hand.errors import KINDS, HandError, HandErrorKind
from skincal.model.arrays import FloatArray
from skincal.robot.description import ARRAYS, NUMBERS

VERSION = "skincal-hand/1"
MAX_BYTES = 65536
REQUESTS = ("hello", "observe", "act", "stop", "bye")
REPLIES = ("welcome", "state", "done", "wait", "refused")


class MessageError(ValueError):
    """Bytes that are not a message; the text says what was expected and what came."""


@dataclass(frozen=True)
class Message:
    """One message.

    Attributes:
        kind: one of ``REQUESTS`` or ``REPLIES``.
        number: the field ``id``.
        session: session of the message.
        body: fields of its kind.
    """

    kind: str
    number: int
    session: str
    body: Mapping[str, Any] = field(default_factory=dict[str, Any])


def encode(message: Message) -> bytes:
    """Return a message as bytes."""
    head = {"v": VERSION, "kind": message.kind, "id": message.number, "session": message.session}
    return json.dumps({**head, **message.body}, allow_nan=False, separators=(",", ":")).encode()


def decode(data: bytes, kinds: tuple[str, ...]) -> Message:
    """Return bytes as a message of one of some kinds.

    Raises:
        MessageError: the bytes are not such a message.
    """
    if len(data) > MAX_BYTES:
        raise MessageError(f"expected at most {MAX_BYTES} bytes; got {len(data)}")
    try:
        content: object = parse_json(decode_text(data), parse_constant=_no_constant)
    except UnreadableError as error:
        raise MessageError(f"expected JSON; got {data[:40]!r} ({error})") from None
    if not isinstance(content, dict):
        raise MessageError(f"expected a JSON object; got {type(content).__name__}")
    body = cast(dict[str, Any], content)
    version, kind = body.pop("v", None), body.pop("kind", None)
    if version != VERSION:
        raise MessageError(f'expected a message of version "{VERSION}"; got {version!r:.40}')
    if kind not in kinds:
        raise MessageError(f"expected a kind of {', '.join(kinds)}; got {kind!r:.40}")
    number, session = body.pop("id", None), body.pop("session", None)
    if not isinstance(number, int) or isinstance(number, bool) or not 0 <= number < 2**53:
        raise MessageError(f"id: expected a whole number; got {number!r:.40}")
    if not isinstance(session, str) or not 0 < len(session) <= 64:
        raise MessageError(f"session: expected a text of at most 64 letters; got {session!r:.40}")
    return Message(cast(str, kind), number, session, body)


def state_body(state: HandState) -> dict[str, Any]:
    """Return the fields of a ``state`` message."""
    body: dict[str, Any] = {name: _null(getattr(state, name)) for name in NUMBERS}
    return body | {name: [_null(value) for value in getattr(state, name).tolist()] for name in ARRAYS}


def state_of(message: Message) -> HandState:
    """Return the state of a ``state`` message; the guard checks its shapes.

    Raises:
        MessageError: a field is missing or not a number.
    """
    fields: dict[str, Any] = {name: number(message, name) for name in NUMBERS}
    fields |= {name: numbers(message, name) for name in ARRAYS}
    return HandState(**fields)


def refusal_body(error: HandError) -> dict[str, Any]:
    """Return the fields of a ``refused`` message."""
    value, limit = (None if x is None else _null(x) for x in (error.value, error.limit))
    return {"error": error.kind, "text": str(error), "joint": error.joint, "value": value, "limit": limit}


def refusal_of(message: Message) -> HandError:
    """Return the error of a ``refused`` message."""
    body = message.body
    kind, joint = body.get("error"), body.get("joint")
    value, limit = (
        float(x) if x is not None and _is_number(x) else None for x in map(body.get, ("value", "limit"))
    )
    return HandError(
        f"the hand's side: {body.get('text')}",
        cast(HandErrorKind, kind) if kind in KINDS else "refused",
        joint=joint if isinstance(joint, str) else None,
        value=value,
        limit=limit,
    )


def number(message: Message, name: str) -> float:
    """Return a number of a message's body; null is NaN."""
    value = message.body.get(name, MISSING)
    if not _is_number(value):
        raise _wrong(message, name, "a number or null")
    return math.nan if value is None else float(value)


def numbers(message: Message, name: str) -> FloatArray:
    """Return a list of numbers of a message's body, as an array (k,); null is NaN."""
    value = message.body.get(name, MISSING)
    if not isinstance(value, list) or not all(_is_number(item) for item in cast(list[Any], value)):
        raise _wrong(message, name, "a list of numbers or nulls")
    return np.array(value, dtype=np.float64)


MISSING = object()


def _wrong(message: Message, name: str, expected: str) -> MessageError:
    value = message.body.get(name, MISSING)
    got = "nothing" if value is MISSING else f"{value!r:.60}"
    return MessageError(f"{message.kind}, {name}: expected {expected}; got {got}")


def _is_number(value: Any) -> bool:
    if value is None or isinstance(value, float):
        return True
    # A whole number of a thousand digits is valid JSON, but not a float.
    return isinstance(value, int) and not isinstance(value, bool) and abs(value) < 2**53


def _null(value: float) -> float | None:
    return float(value) if math.isfinite(value) else None


def _no_constant(name: str) -> Any:
    raise ValueError(f"{name} is not JSON")
