"""One connection to a broker: what it sends, and what the broker's answers become."""

import asyncio
from collections.abc import Awaitable, Callable

import pytest

from beamtouch_service.outputs.mqtt import connection
from beamtouch_service.outputs.mqtt.connection import Connection
from beamtouch_service.outputs.mqtt.failures import BrokerError, RefusedError
from beamtouch_service.outputs.mqtt.messages import JSON, Kept, properties
from beamtouch_service.outputs.mqtt.section import MqttSection
from service.small_broker import CONNECT, PUBLISH, SUBSCRIBE, UNSUBSCRIBE, SmallBroker

NOT_AUTHORIZED, NO_SUBSCRIBERS = 0x87, 0x10
KEPT = b"\x00\x0bhall/status\x1e\x26\x00\x11beamtouch-service\x00\x08" + b"somebody" + b"online"
"""A message of another service, as a subscriber gets it: topic, properties, text."""


def run(broker: SmallBroker, play: Callable[[Connection], Awaitable[None]], password: str | None = None) -> None:
    async def with_connection() -> None:
        keys = {"host": "127.0.0.1", "port": broker.port, "prefix": "hall", "client_id": "one"}
        one = Connection(MqttSection.model_validate(keys | ({"username": "u"} if password else {})), password, None)
        try:
            async with asyncio.timeout(30):
                await one.open()
                await play(one)
        finally:
            one.close()

    with broker:
        asyncio.run(with_connection())


async def nothing(_: Connection) -> None:
    """Do no more than connect."""


@pytest.mark.parametrize(("password", "flags"), [(None, 0x2E), ("secret", 0xEE)])
def test_a_connection_states_who_it_is_and_what_the_broker_is_to_say_when_it_ends(
    password: str | None, flags: int
) -> None:
    """Flags of MQTT 5: a clean start, and a will that is kept, of QoS 1; a user and a password."""
    broker = SmallBroker()
    run(broker, nothing, password)
    (packet,) = broker.of(CONNECT)
    assert packet.rest[:10] == b"\x00\x04MQTT\x05" + bytes([flags]) + b"\x00\x05"
    for text in (b"\x00\x03one", b"\x00\x0bhall/status", b"\x00\x07offline", b"beamtouch-service\x00\x03one"):
        assert text in packet.rest
    assert packet.rest.endswith(b"\x00\x01u\x00\x06secret" if password else b"\x00\x07offline")


def test_requests_are_answered_one_by_one() -> None:
    broker = SmallBroker()

    async def play(one: Connection) -> None:
        await one.confirm()
        await one.subscribe("hall/+/status")
        await one.keep("hall/status", b"online", "text/plain")
        assert await one.tell(("hall/a/event", b"1"), ("hall/b/event", b"2"), properties=properties(JSON)) is True
        await one.send("hall/a/contact", b"3", properties(JSON, 500.0), 60.0)
        await one.confirm()

    run(broker, play)
    assert [packet.kind for packet in broker.packets] == [0x10, 0xA2, 0x82, 0x33, 0x32, 0x32, 0x30, 0xA2]
    assert broker.of(UNSUBSCRIBE)[0].rest.endswith(b"\x00\x13hall/status/nothing")
    assert broker.of(SUBSCRIBE)[0].rest.endswith(b"\x00\x0dhall/+/status\x01")
    assert [packet.rest[-1:] for packet in broker.of(PUBLISH)] == [b"e", b"1", b"2", b"3"]


def test_whether_somebody_has_subscribed_is_in_the_acknowledgement() -> None:
    async def play(one: Connection) -> None:
        assert await one.tell(("hall/a/event", b"1"), properties=properties(JSON)) is False

    run(SmallBroker({PUBLISH: NO_SUBSCRIBERS}), play)


@pytest.mark.parametrize(
    ("kind", "words"),
    [
        (SUBSCRIBE, "Not authorized"),
        (PUBLISH, "Not authorized"),
        (CONNECT, "it refuses this client: not authorized; check mqtt.username and mqtt.password_file, and the rights"),
    ],
)
def test_a_refusal_has_the_reason_of_the_broker(kind: int, words: str) -> None:
    async def play(one: Connection) -> None:
        await (one.subscribe("a") if kind == SUBSCRIBE else one.keep("a", b"b", JSON))

    with pytest.raises(RefusedError, match=f"^{words}"):
        run(SmallBroker({kind: NOT_AUTHORIZED}), play)


def test_a_refusal_of_what_must_be_there_says_what_to_do() -> None:
    async def play(one: Connection) -> None:
        await one.require_kept("hall/status", b"online", "text/plain")

    words = r"^it refuses messages to hall/status \(Not authorized\); allow this user to write there$"
    with pytest.raises(RefusedError, match=words):
        run(SmallBroker({PUBLISH: NOT_AUTHORIZED}), play)


REQUESTS: list[tuple[int, Callable[[Connection], Awaitable[object]]]] = [
    (UNSUBSCRIBE, lambda one: one.confirm()),
    (SUBSCRIBE, lambda one: one.subscribe("a")),
    (PUBLISH, lambda one: one.keep("a", b"b", JSON)),
]


@pytest.mark.parametrize(("kind", "ask"), REQUESTS)
def test_a_broker_that_does_not_answer_is_told_from_one_that_ends_the_connection(
    monkeypatch: pytest.MonkeyPatch, kind: int, ask: Callable[[Connection], Awaitable[object]]
) -> None:
    async def play(one: Connection) -> None:
        await ask(one)

    with pytest.raises(BrokerError, match=r"^the connection is lost$"):
        run(SmallBroker(ends_at=kind), play)
    broker = SmallBroker({kind: None})

    async def wait(one: Connection) -> None:
        monkeypatch.setattr(connection, "ANSWER_S", 0.02)
        await ask(one)

    with pytest.raises(BrokerError, match=r"^it does not answer$"):
        run(broker, wait)


def test_who_watches_hears_of_the_end_and_every_request_after_it_fails() -> None:
    async def play(one: Connection) -> None:
        watching = asyncio.ensure_future(one.watch())
        with pytest.raises(BrokerError):
            await one.confirm()
        with pytest.raises(BrokerError, match=r"^the connection is lost$"):
            await watching
        with pytest.raises(BrokerError):
            await one.subscribe("a")

    run(SmallBroker(ends_at=UNSUBSCRIBE), play)


@pytest.mark.parametrize(("retain", "is_new"), [(0x31, False), (0x30, True)])
def test_a_message_that_the_broker_keeps_comes_with_its_owner(retain: int, is_new: bool) -> None:
    async def play(one: Connection) -> None:
        await one.subscribe("hall/status")
        assert await one.received.get() == Kept("hall/status", b"online", "somebody", is_new)

    run(SmallBroker(sends=bytes([retain, len(KEPT)]) + KEPT), play)


def test_where_nobody_listens_the_system_says_why() -> None:
    broker = SmallBroker()
    with broker:
        pass
    with pytest.raises(BrokerError, match=r"^Connection refused$"):
        asyncio.run(_open(broker.port))


async def _open(port: int) -> None:
    await Connection(MqttSection(host="127.0.0.1", port=port), None, None).open()
