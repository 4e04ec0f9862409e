"""A hand behind a socket: delays, losses, doubles, deaths, second clients, keys. Real sockets on this computer."""

from __future__ import annotations

import json
import os
import random
import signal
import socket
import struct
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hand_fakes import FakeHand, Hands, changed, tiny_description

from benchmarks.lossy_proxy import Fate, Proxy, lossy
from skincal.errors import InputError, WorkError
from skincal.hand import remote, serve, sockets
from skincal.hand.client_session import Session
from skincal.hand.driver import HandCommand
from skincal.hand.errors import HandError
from skincal.hand.guard import GuardedHand
from skincal.hand.guard_options import GuardOptions
from skincal.hand.messages import REPLIES, VERSION, Message, MessageError, decode, encode
from skincal.hand.remote import LONGEST_S, SHORTEST_S, RemoteDriver, ResendTimer
from skincal.hand.serve import HandServer, ServeOptions
from skincal.hand.sockets import checked_address, client_keys, hand_keys, make_keys
from skincal.robot import HandDescription, HandState

zmq = pytest.importorskip("zmq")

PATIENCE_S = 30.0
"""A busy machine is slow; no test waits for longer [s]."""

SERVE = ServeOptions(watchdog_s=0.4, command_age_s=0.2, guard=GuardOptions(timeout_s=0.3, stop_timeout_s=0.1))
SLACK_S = 0.25


@pytest.fixture(autouse=True)
def tiny(monkeypatch: pytest.MonkeyPatch) -> None:
    """The tiny hand on both sides."""
    monkeypatch.setattr(remote, "hand_named", lambda hand: tiny_description())


@contextmanager
def served(hands: Hands, options: ServeOptions = SERVE, **more: Any) -> Iterator[HandServer]:
    with HandServer(hands, more.pop("bind", "tcp://127.0.0.1:*"), options=options, **more) as server:
        thread = threading.Thread(target=server.run)
        thread.start()
        try:
            yield server
        finally:
            server.end()
            thread.join(5.0)
            assert not thread.is_alive()


def drive(hand: GuardedHand, periods: int) -> list[float]:
    times = []
    for k in range(periods):
        state = hand.observe()
        times.append(state.time_s)
        hand.act(HandCommand(state.q_desired_rad + 0.001 * (k % 2)))
    return times


def test_a_remote_hand_is_as_one_that_is_here() -> None:
    hands = Hands()
    with served(hands) as server:
        for _ in range(2):
            with GuardedHand(RemoteDriver(server.address)) as hand:
                times = drive(hand, 20)
                assert hand.period_s == 0.01
            np.testing.assert_allclose(np.diff(times), 0.01)
            assert len(hands.last.commands) == 20
            assert hands.last.calls[-2:] == ["stop", "close"]
    assert len(hands.made) == 2


def disordered() -> Fate:
    """Lose messages, double them, and bring copies late."""
    generator = random.Random(5)

    def fate(message: Message, forth: bool) -> list[float]:
        if message.kind == "stop":
            return [0.0]
        chance = generator.random()
        if chance < 0.06:
            return []
        if chance < 0.3:
            return [0.0, 0.005]
        return [0.25, 0.0] if chance < 0.36 else [0.0]

    return fate


@pytest.mark.parametrize(
    ("fate", "periods"), [(disordered(), 24), (lossy(0.02, 0.05, seed=1), 12)], ids=["disordered", "slow"]
)
def test_a_bad_link_changes_nothing(fate: Fate, periods: int) -> None:
    hands = Hands()
    options = ServeOptions(watchdog_s=3.0, command_age_s=2.0)
    with served(hands, options) as server, Proxy(server.address, fate) as proxy:
        with GuardedHand(RemoteDriver(proxy.address, silence_s=2.0), GuardOptions(timeout_s=3.0)) as hand:
            times = drive(hand, periods)
        # Every state is a step of the hand, every command was sent once, in order.
        np.testing.assert_allclose(np.diff(times), 0.01)
        assert len(hands.last.commands) == hands.last.calls.count("observe") == periods
        steps = np.diff([q[0] for q in hands.last.commands])
        np.testing.assert_allclose(steps, np.tile([0.001, 0.0], periods)[: periods - 1], atol=1e-12)


def test_a_late_command_is_refused_and_stops_the_hand() -> None:
    hands = Hands()

    def fate(message: Message, forth: bool) -> list[float]:
        late = message.kind == "act" and hands.last.ticks >= 3
        return [0.3] if late else [0.0]

    with served(hands) as server, Proxy(server.address, fate) as proxy:
        with pytest.raises(HandError) as caught, GuardedHand(RemoteDriver(proxy.address)) as hand:
            drive(hand, 10)
        assert caught.value.kind == "command"
        assert "after the state that it answers, the limit is 0.2 s" in str(caught.value)
        assert len(hands.last.commands) == 2
        assert hands.last.stopped_at is not None


def test_an_error_at_the_hands_side_is_reported_with_its_reason() -> None:
    hands = Hands(lambda: FakeHand(changed(tau_nm=np.array([0, 1.6]))))
    with served(hands) as server:
        with pytest.raises(HandError) as caught, GuardedHand(RemoteDriver(server.address)) as hand:
            drive(hand, 10)
        assert caught.value.kind == "torque"
        assert (caught.value.joint, caught.value.value, caught.value.limit) == ("finger", 1.6, 1.5)
        assert "joint finger: measured torque is 1.6 N m" in str(caught.value)
        assert caught.value.stopped is True
        assert hands.last.stopped_at is not None


def test_the_force_is_limited_at_the_hands_side() -> None:
    hands = Hands()
    force = lambda description: lambda state: 9.0  # noqa: E731
    with served(hands, contact_force=force) as server:
        with (
            pytest.raises(HandError, match="contact force is 9 N"),
            GuardedHand(RemoteDriver(server.address)) as hand,
        ):
            drive(hand, 2)
        assert hands.last.stopped_at is not None


def test_no_client_waits_for_a_force_check_that_is_slow_to_make() -> None:
    def force(description: HandDescription) -> Callable[[HandState], float]:
        del description
        time.sleep(0.5)  # longer than a client is patient, as compiling may take
        return lambda state: 0.0

    hands = Hands()
    with (
        served(hands, contact_force=force) as server,
        GuardedHand(RemoteDriver(server.address, silence_s=0.25)) as hand,
    ):
        drive(hand, 2)
    assert hands.last.stopped_at is not None


def test_a_driver_that_hangs_there_is_stopped_there() -> None:
    hands = Hands(lambda: FakeHand(hang={"observe": 1.5}))
    with served(hands) as server:
        start = time.monotonic()
        with pytest.raises(HandError) as caught, GuardedHand(RemoteDriver(server.address)) as hand:
            drive(hand, 10)
        assert caught.value.kind == "timeout"
        assert "observe() did not return within 0.3 s" in str(caught.value)
        assert hands.last.stopped_at is not None
        assert hands.last.stopped_at - start < 0.3 + 3 * SLACK_S


def test_stop_comes_through_while_another_call_waits() -> None:
    hands = Hands(lambda: FakeHand(hang={"observe": 0.25}, after=0))
    with served(hands) as server, RemoteDriver(server.address) as driver:
        timer = threading.Timer(0.05, driver.stop)
        start = time.monotonic()
        timer.start()
        driver.observe()
        assert hands.last.stopped_at is not None
        assert hands.last.stopped_at - start < 0.05 + SLACK_S
        timer.join(PATIENCE_S)


def test_a_client_that_falls_silent_loses_the_hand() -> None:
    hands = Hands()
    with served(hands) as server:
        silent = RemoteDriver(server.address)
        silent.connect()
        silent.observe()
        start = time.monotonic()
        other = RemoteDriver(server.address)
        with pytest.raises(HandError, match="another client has the hand") as caught:
            other.connect()
        assert caught.value.kind == "refused"
        first = hands.last
        while first.calls[-1] != "close" and time.monotonic() - start < PATIENCE_S:
            time.sleep(0.01)
        assert first.stopped_at is not None
        assert first.stopped_at - start < SERVE.watchdog_s + SLACK_S
        assert first.calls[-1] == "close"
        time.sleep(0.05)  # the session ends after that
        other.connect()
        other.observe()
        assert hands.last is not first
        with pytest.raises(HandError, match="no such session") as caught:
            silent.observe()
        assert caught.value.kind == "lost"
        other.close()
        silent.close()


@pytest.mark.parametrize("fault", [{"hang": {"stop": 5.0}}, {"raises": {"stop": OSError("cable")}}])
def test_a_hand_that_cannot_be_stopped_is_given_to_nobody(fault: dict[str, Any]) -> None:
    hands = Hands(lambda: FakeHand(**fault))
    with suppress(HandError), HandServer(hands, "tcp://127.0.0.1:*", options=SERVE) as server:
        client = RemoteDriver(server.address)
        threading.Thread(
            target=lambda: (client.connect(), client.observe())
        ).start()  # and is never heard again
        threading.Timer(6.0, server.end).start()
        with pytest.raises(HandError, match="Cut the hand's power") as caught:
            server.run()
        assert caught.value.stopped is False and len(hands.made) == 1
    with suppress(HandError):
        client.close()


def test_a_message_of_another_session_does_nothing() -> None:
    hands = Hands()
    with served(hands, ServeOptions(watchdog_s=PATIENCE_S, command_age_s=PATIENCE_S)) as server:
        driver = RemoteDriver(server.address)
        driver.connect()
        state = driver.observe()
        with zmq.Context() as context, context.socket(zmq.DEALER) as wire:
            wire.linger, wire.rcvtimeo = 0, int(1000 * PATIENCE_S)
            wire.connect(server.address)
            old = [
                Message("act", 9, "another", {"q_desired_rad": [0, 0], "answers": 2}),
                Message("stop", 9, "another"),
            ]
            for message in old:
                wire.send(encode(message))
                assert decode(wire.recv(), REPLIES).kind == "refused"
            for data in (b"garbage", b"", json.dumps({"v": VERSION, "kind": "act"}).encode()):
                wire.send(data)
                assert decode(wire.recv(), REPLIES).kind == "refused"
        assert hands.last.commands == []
        assert hands.last.stopped_at is None
        driver.act(HandCommand(state.q_desired_rad))
        driver.close()


def test_a_session_does_no_request_that_it_does_not_know() -> None:
    with zmq.Context() as context, context.socket(zmq.PAIR) as wire:
        session = Session("one", FakeHand(), ServeOptions(), None, wire)
        for kind in ("welcome", "stop", "move"):
            with pytest.raises(MessageError, match=f'expected a request of a session; got "{kind}"'):
                session._do(Message(kind, 1, "one"))  # pyright: ignore[reportPrivateUsage]
        session.end()


def test_an_older_version_is_reported(monkeypatch: pytest.MonkeyPatch) -> None:
    with served(Hands()) as server:
        monkeypatch.setattr(
            remote, "encode", lambda message: encode(message).replace(b"skincal-hand/1", b"skincal-hand/0")
        )
        with pytest.raises(HandError, match="expected a message of version"):
            RemoteDriver(server.address).connect()


def test_another_hand_is_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    with served(Hands()) as server:
        monkeypatch.setattr(remote, "hand_named", lambda hand: replace(tiny_description(), digest="ff" * 32))
        with pytest.raises(HandError, match=r"both need the same hand\.toml"):
            RemoteDriver(server.address).connect()


def test_nobody_there() -> None:
    driver = RemoteDriver("tcp://127.0.0.1:9", silence_s=0.3)
    start = time.monotonic()
    with pytest.raises(HandError, match=r"has not answered hello for .* no server listens there") as caught:
        driver.connect()
    assert caught.value.kind == "lost"
    assert time.monotonic() - start < 0.3 + SLACK_S
    with pytest.raises(HandError, match="not connected"):
        driver.observe()
    with pytest.raises(HandError, match="period_s is known once"):
        _ = driver.period_s
    driver.stop()
    driver.close()


@pytest.mark.slow
def test_a_server_that_ends_is_a_lost_connection() -> None:
    hands = Hands()
    with pytest.raises(HandError) as caught:  # noqa: SIM117
        with served(hands) as server, GuardedHand(RemoteDriver(server.address, silence_s=0.4)) as hand:
            drive(hand, 5)
            server.end()
            start = time.monotonic()
            drive(hand, 5)
    assert caught.value.kind == "lost"
    assert "has not answered observe" in str(caught.value)
    # Silence; then two stops, each tried twice, that nobody answers.
    assert time.monotonic() - start < 0.4 + 4 * remote.STOP_S + 3 * SLACK_S
    assert hands.last.stopped_at is not None


SERVER = """
import sys
sys.path.insert(0, {tests!r})
from hand_fakes import FakeHand
from skincal.hand.serve import HandServer
with HandServer(FakeHand, "tcp://127.0.0.1:*") as server:
    print(server.address, flush=True)
    server.run()
"""


def test_a_server_that_is_killed(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(remote, "STOP_S", 0.1)
    code = SERVER.format(tests=str(Path(__file__).parent))
    process = subprocess.Popen([sys.executable, "-c", code], stdout=subprocess.PIPE, text=True)
    assert process.stdout is not None
    try:
        address = process.stdout.readline().strip()
        with pytest.raises(HandError) as caught, GuardedHand(RemoteDriver(address, silence_s=0.4)) as hand:
            drive(hand, 5)
            os.kill(process.pid, signal.SIGKILL)
            killed = time.monotonic()
            drive(hand, 5)
        assert time.monotonic() - killed < 0.4 + 4 * remote.STOP_S + 3 * SLACK_S
        assert caught.value.kind == "lost"
        assert caught.value.stopped is False
        assert "its watchdog stops the hand within 2 s" in str(caught.value)
        assert "Cut the hand's power" in str(caught.value)
    finally:
        process.kill()
        process.wait()
        process.stdout.close()


CLIENT = """
import sys, time
sys.path.insert(0, {tests!r})
from hand_fakes import tiny_description
from skincal.hand import remote
remote.hand_named = lambda hand: tiny_description()
driver = remote.RemoteDriver({address!r})
driver.connect()
while True:
    driver.observe()
    print("alive", flush=True)
    time.sleep(0.05)
"""


def test_a_client_that_is_killed() -> None:
    hands = Hands()
    with served(hands, replace(SERVE, guard=GuardOptions())) as server:
        code = CLIENT.format(tests=str(Path(__file__).parent), address=server.address)
        process = subprocess.Popen([sys.executable, "-c", code], stdout=subprocess.PIPE, text=True)
        assert process.stdout is not None
        assert process.stdout.readline() == "alive\n"
        os.kill(process.pid, signal.SIGKILL)
        killed = time.monotonic()
        process.wait()
        process.stdout.close()
        while hands.last.stopped_at is None and time.monotonic() - killed < 3.0:
            time.sleep(0.01)
        assert hands.last.stopped_at is not None
        assert hands.last.stopped_at - killed < SERVE.watchdog_s + SLACK_S


@pytest.mark.parametrize(
    "address", ["tcp://0.0.0.0:5555", "tcp://*:5555", "tcp://192.168.1.4:5555", "tcp://hand:5555"]
)
def test_other_computers_need_keys(address: str) -> None:
    with pytest.raises(InputError, match="without keys") as caught:
        checked_address(address, keys=False, what="address")
    assert "skincal hand keys" in str(caught.value)
    assert checked_address(address, keys=True, what="address") == address
    with pytest.raises(InputError, match="without keys"):
        RemoteDriver(address)
    with pytest.raises(InputError, match="without keys"):
        HandServer(Hands(), address)


@pytest.mark.parametrize(
    "address",
    [
        "127.0.0.1:5555",
        "tcp://127.0.0.1",
        "udp://127.0.0.1:1",
        "tcp://:1",
        "ipc://",
        "x",
        "tcp://127.0.0.1:65536",
        "tcp://127.0.0.1:٣",
    ],
)
def test_what_is_no_address(address: str) -> None:
    with pytest.raises(InputError, match="expected an address such as"):
        checked_address(address, keys=True, what="address")


@pytest.mark.parametrize(
    "address", ["tcp://127.0.0.1:1", "tcp://localhost:1", "tcp://[::1]:1", "tcp://127.3.2.1:*", "ipc://a"]
)
def test_this_computer_needs_no_keys(address: str) -> None:
    assert checked_address(address, keys=False, what="address") == address


@pytest.fixture
def keys(tmp_path: Path) -> Path:
    """A folder of keys for a hand and a client."""
    make_keys(tmp_path / "keys")
    return tmp_path / "keys"


def test_with_keys_those_who_are_known_come_in_and_others_do_not(tmp_path: Path, keys: Path) -> None:
    make_keys(tmp_path / "others")
    hands = Hands()
    with served(hands, keys=hand_keys(keys / "hand")) as server:
        with GuardedHand(RemoteDriver(server.address, keys=keys / "client")) as hand:
            drive(hand, 3)
        first = hands.last
        # No keys; keys of somebody else; the right server key, but a client that is not allowed.
        mixed = tmp_path / "mixed"
        mixed.mkdir()
        for name, folder in (("client.key_secret", "others"), ("hand.key", "keys")):
            (mixed / name).write_bytes((tmp_path / folder / "client" / name).read_bytes())
        for wrong in (None, tmp_path / "others" / "client", mixed):
            with pytest.raises(HandError, match="none that admits a client") as caught:
                RemoteDriver(server.address, keys=wrong, silence_s=0.1).connect()
            assert caught.value.kind == "lost"
        assert hands.last is first
        # A client with keys does not talk to a server that cannot show the hand's.
    with served(hands) as server, pytest.raises(HandError, match="none that admits"):
        RemoteDriver(server.address, keys=keys / "client", silence_s=0.1).connect()


def test_a_client_that_does_not_wait_for_answers_fills_no_memory() -> None:
    hands = Hands(lambda: FakeHand(hang={"observe": 0.05}))
    with served(hands) as server:
        driver = RemoteDriver(server.address)
        driver.connect()
        session = server._session  # pyright: ignore[reportPrivateUsage]
        assert session is not None
        for number in range(2, 5000):
            session.request(b"x", Message("observe", number, session.token))
        waiting = session._requests.qsize()  # pyright: ignore[reportPrivateUsage]
        driver.stop()
        driver.close()
    assert waiting <= 8


def raw(server: HandServer) -> socket.socket:
    """A connection that has not said anything; what the server says is read."""
    return socket.create_connection(("127.0.0.1", int(server.address.rpartition(":")[2])), timeout=5)


GREETING = b"\xff\0\0\0\0\0\0\0\1\x7f\3\0" + b"NULL".ljust(20, b"\0") + bytes(32)
READY = b"\x05READY\x0bSocket-Type\0\0\0\x06DEALER"


def test_a_message_without_end_stops_the_hand_and_ends(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(serve, "MOST_BYTES", 32 << 20)
    hands = Hands()
    patient = ServeOptions(watchdog_s=PATIENCE_S)
    with HandServer(hands, "tcp://127.0.0.1:*", options=patient) as server:
        driver = RemoteDriver(server.address, silence_s=PATIENCE_S)
        noticed = threading.Event()

        def attack() -> None:
            try:
                driver.connect()
                before.clear()  # what was there before the server began is none of its own
                with suppress(OSError), raw(server) as wire:
                    wire.settimeout(PATIENCE_S)
                    # Who says all at once, before the other side has answered, is turned away.
                    wire.sendall(GREETING)
                    wire.recv(64, socket.MSG_WAITALL)
                    wire.sendall(b"\x04" + bytes([len(READY)]) + READY)
                    wire.recv(len(READY))
                    for _ in range(2500):
                        wire.sendall(b"\x03" + struct.pack(">Q", 60_000) + bytes(60_000))
                    noticed.wait(PATIENCE_S)
            finally:
                server.end()

        before = bytearray(os.urandom(1 << 20) * 200)
        attacker = threading.Thread(target=attack)
        attacker.start()
        with pytest.raises(HandError, match=r"32 MiB of memory .* The hand was stopped"):
            server.run()
        noticed.set()
    attacker.join(PATIENCE_S)
    driver._shut()  # nobody is there to take leave of
    assert hands.last.stopped_at is not None


def test_a_connection_that_says_nothing_holds_no_place(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(sockets, "HANDSHAKE_MS", 200)
    with served(Hands()) as server, raw(server) as wire:
        start = time.monotonic()
        while wire.recv(4096):
            pass
        assert time.monotonic() - start < 2.0


def test_keys_are_read_once(keys: Path) -> None:
    """Files added to the folder later are never opened: at a pipe the authenticator would wait for ever."""
    read = hand_keys(keys / "hand")
    (keys / "hand" / "allowed" / "client.key").unlink()
    with served(Hands(), keys=read) as server, RemoteDriver(server.address, keys=keys / "client") as driver:
        driver.observe()


def test_keys_are_private_and_kept(keys: Path) -> None:
    files = sorted(str(path.relative_to(keys)) for path in keys.rglob("*") if path.is_file())
    of_client, of_hand = ["client/client.key_secret", "client/hand.key"], ["hand/allowed/client.key"]
    assert files == [".skincal.json", "README.txt", *of_client, *of_hand, "hand/hand.key_secret"]
    for path in keys.rglob("*.key_secret"):
        assert path.stat().st_mode & 0o077 == 0
    with pytest.raises(InputError, match="existing folder"):
        make_keys(keys)
    secret = client_keys(keys / "client").secret.decode()
    assert all(secret not in path.read_text() for path in keys.rglob("*.key"))


def test_key_folders_that_are_wrong(keys: Path) -> None:
    with pytest.raises(InputError, match=r"client\.key_secret: expected a key file"):
        client_keys(keys / "hand")
    (keys / "hand" / "allowed" / "client.key").unlink()
    with pytest.raises(InputError, match="expected at least one public key of a client"):
        hand_keys(keys / "hand")


def test_an_address_that_is_taken() -> None:
    with (
        served(Hands()) as server,
        pytest.raises(HandError, match="cannot listen at"),
        HandServer(Hands(), server.address),
    ):
        pass


def test_without_pyzmq_the_error_says_how_to_get_it(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "zmq", None)
    with pytest.raises(WorkError, match=r"pip install 'skincal\[remote\]'"):
        sockets.zmq_module()


def _stop(driver: RemoteDriver) -> None:
    driver.observe()
    driver.stop()


def _refused(driver: RemoteDriver) -> None:
    state = driver.observe()
    driver._observed = 1  # an old one
    with pytest.raises(HandError, match="answers message"):
        driver.act(HandCommand(state.q_desired_rad))


def _moved(driver: RemoteDriver) -> None:
    driver.act(HandCommand(driver.observe().q_desired_rad))


@pytest.mark.parametrize("last", [lambda driver: None, RemoteDriver.observe, _moved, _stop, _refused])
def test_the_hand_is_free_again_whatever_its_client_did_last(last: Callable[[RemoteDriver], object]) -> None:
    options = replace(SERVE, watchdog_s=0.2)
    with served(Hands(), options) as server:
        dead = RemoteDriver(server.address)
        dead.connect()
        last(dead)
        dead._shut()
        start, free = time.monotonic(), False
        while not free and time.monotonic() - start < options.watchdog_s + 4 * SLACK_S:
            other = RemoteDriver(server.address)
            try:
                other.connect()
                free = True
                other.close()
            except HandError:
                time.sleep(0.05)
        assert free


def test_a_client_learns_whether_the_hand_runs_in_real_time() -> None:
    for real_time in (True, False):
        with served(Hands(lambda real_time=real_time: FakeHand(real_time=real_time, pace_s=0.01))) as server:
            driver = RemoteDriver(server.address)
            assert driver.real_time
            driver.connect()
            assert driver.real_time is real_time
            driver.close()


def test_making_a_driver_may_fail_or_hang_without_end(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("skincal.hand.serve.MAKE_S", 0.1)
    made = iter([FakeHand, lambda: time.sleep(0.5), lambda: exec("raise SystemExit(0)"), FakeHand])
    with served(Hands(lambda: next(made)())) as server:
        for text in ("", "not created within 0.1 s", "SystemExit", ""):
            driver = RemoteDriver(server.address)
            if text:
                with pytest.raises(HandError, match=text):
                    driver.connect()
            else:
                driver.connect()
                driver.close()


BAD_KEYS = {
    "cut": (lambda key: key[:-1], "a secret-key of 40 letters of Z85"),
    "other letters": (lambda key: key[:-1] + b" ", "a secret-key of 40 letters of Z85"),
    "too large": (lambda key: b"#" * 40, "a secret-key of 40 letters of Z85"),
    "of another pair": (lambda key: zmq.curve_keypair()[1], "that are a pair"),
}


@pytest.mark.parametrize(("change", "text"), BAD_KEYS.values(), ids=BAD_KEYS)
def test_keys_are_checked_when_they_are_read(change: Callable[[bytes], bytes], text: str, keys: Path) -> None:
    for side, read in (("client", client_keys), ("hand", hand_keys)):
        path = keys / side / f"{side}.key_secret"
        secret = path.read_bytes().split(b'secret-key = "')[1].split(b'"')[0]
        path.write_bytes(path.read_bytes().replace(secret, change(secret)))
        with pytest.raises(InputError) as caught:
            read(path.parent)
        assert str(path) in str(caught.value)
        assert text in str(caught.value)


@pytest.mark.parametrize("content", [b"", b"public-key", b'public-key = "short"', bytes(100_000)])
def test_the_keys_of_others_are_checked_too(content: bytes, keys: Path) -> None:
    for path, read in (
        (keys / "client" / "hand.key", client_keys),
        (keys / "hand" / "allowed" / "client.key", hand_keys),
    ):
        path.write_bytes(content)
        with pytest.raises(InputError) as caught:
            read(keys / path.relative_to(keys).parts[0])
        assert str(path) in str(caught.value)


def test_untimed_link_is_given_the_longest_time() -> None:
    assert ResendTimer().wait_s == LONGEST_S


def test_steady_link_is_given_little_more_than_it_takes() -> None:
    timer = ResendTimer()
    for _ in range(30):
        timer.answered(0.04)
    assert 0.04 <= timer.wait_s < 0.045


def test_an_unsteady_link_is_given_more() -> None:
    steady, unsteady = ResendTimer(), ResendTimer()
    for k in range(30):
        steady.answered(0.05)
        unsteady.answered(0.03 if k % 2 else 0.07)
    assert unsteady.wait_s > 0.07 > steady.wait_s


def test_repeats_wait_longer_until_an_answer_is_timed() -> None:
    timer = ResendTimer()
    for _ in range(30):
        timer.answered(0.04)
    before = timer.wait_s
    timer.repeated()
    assert timer.wait_s == pytest.approx(2 * before)
    for _ in range(9):
        timer.repeated()
    assert timer.wait_s == LONGEST_S
    timer.answered(0.04)
    assert timer.wait_s == pytest.approx(before, rel=0.1)


def test_the_fastest_link_is_given_some_time() -> None:
    timer = ResendTimer()
    for _ in range(50):
        timer.answered(1e-4)
    assert timer.wait_s == SHORTEST_S
