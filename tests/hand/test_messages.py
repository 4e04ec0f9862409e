"""Messages of a remote hand: what goes in comes out, and anything else is refused with a reason."""

from __future__ import annotations

import json

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from skincal.hand.driver import HandState
from skincal.hand.errors import HandError
from skincal.hand.messages import (
    REPLIES,
    REQUESTS,
    VERSION,
    Message,
    MessageError,
    decode,
    encode,
    number,
    numbers,
    refusal_body,
    refusal_of,
    state_body,
    state_of,
)
from skincal.robot.description import ARRAYS

GOOD = {"v": VERSION, "kind": "act", "id": 3, "session": "s", "q_desired_rad": [0.1, 0.2], "answers": 2}


def test_a_state_comes_back_to_the_last_bit() -> None:
    generator = np.random.default_rng(3)
    values = {name: generator.normal(size=5) for name in ARRAYS}
    values["taxels"][2] = np.nan
    sent = HandState(time_s=1 / 3, temperature_c=float("nan"), **values)
    got = state_of(decode(encode(Message("state", 7, "abc", state_body(sent))), REPLIES))
    assert got.time_s == sent.time_s
    assert np.isnan(got.temperature_c)
    for name in ARRAYS:
        np.testing.assert_array_equal(getattr(got, name), getattr(sent, name))
        assert getattr(got, name).dtype == np.float64


def test_an_error_comes_back() -> None:
    sent = HandError("joint a: too far", "joint_limit", joint="a", value=1.5, limit=1.0)
    got = refusal_of(decode(encode(Message("refused", 7, "abc", refusal_body(sent))), REPLIES))
    assert (got.kind, got.joint, got.value, got.limit) == ("joint_limit", "a", 1.5, 1.0)
    assert str(got) == "the hand's side: joint a: too far"
    odd = refusal_of(Message("refused", 1, "s", {"error": "mood", "value": "much", "joint": 3}))
    assert (odd.kind, odd.joint, odd.value) == ("refused", None, None)


@pytest.mark.parametrize(
    ("data", "reason"),
    [
        (b"", "expected JSON"),
        (b"\xff\xfe", "expected JSON"),
        (b"[" * 100_000, "expected at most 65536 bytes"),
        (b"[" * 60_000, "expected JSON"),
        (b"[1, 2]", "expected a JSON object; got list"),
        (b'{"v": NaN}', "NaN is not JSON"),
        (
            {**GOOD, "v": "skincal-hand/2"},
            "expected a message of version \"skincal-hand/1\"; got 'skincal-hand/2'",
        ),
        ({**GOOD, "kind": "pickle"}, "expected a kind of hello, observe"),
        ({**GOOD, "kind": ["act"]}, "expected a kind of"),
        ({**GOOD, "id": -1}, "id: expected a whole number"),
        ({**GOOD, "id": True}, "id: expected a whole number"),
        ({**GOOD, "id": 1.5}, "id: expected a whole number"),
        ({**GOOD, "session": ""}, "session: expected a text"),
        ({**GOOD, "session": "x" * 65}, "session: expected a text"),
        ({**GOOD, "q_desired_rad": [10**400]}, "expected whole numbers of 64 bits"),
    ],
)
def test_what_is_no_message_is_refused(data: object, reason: str) -> None:
    with pytest.raises(MessageError) as caught:
        decode(data if isinstance(data, bytes) else json.dumps(data).encode(), REQUESTS)
    assert reason in str(caught.value)
    assert len(str(caught.value)) < 250


@pytest.mark.parametrize("value", ["[]", 3, ["a"], [[1.0]], [True], [10**18], {}])
def test_a_field_that_is_no_list_of_numbers(value: object) -> None:
    message = decode(json.dumps({**GOOD, "q_desired_rad": value}).encode(), REQUESTS)
    with pytest.raises(MessageError, match="act, q_desired_rad: expected a list of numbers"):
        numbers(message, "q_desired_rad")


def test_a_field_that_is_missing() -> None:
    with pytest.raises(MessageError, match="state, time_s: expected a number or null; got nothing"):
        number(Message("state", 1, "s"), "time_s")


@given(st.binary(max_size=200))
def test_no_bytes_do_any_harm(data: bytes) -> None:
    with pytest.raises(MessageError):
        decode(data, REQUESTS)
