"""What the senders of MQTT make of contacts, statuses and events, and when they ask a broker again that refuses."""

import asyncio
import json
import ssl
from collections.abc import Awaitable, Callable
from typing import Any, cast

import pytest
from paho.mqtt.packettypes import PacketTypes
from paho.mqtt.properties import Properties
from paho.mqtt.reasoncodes import ReasonCode

from beamtouch_service.outputs.mqtt import events, statuses
from beamtouch_service.outputs.mqtt.answers import BrokerAnswers
from beamtouch_service.outputs.mqtt.connection import REFUSED_RETRY_S
from beamtouch_service.outputs.mqtt.contacts import ContactSender
from beamtouch_service.outputs.mqtt.events import EventSender
from beamtouch_service.outputs.mqtt.failures import BrokerError, RefusedError, reason_of, words_for
from beamtouch_service.outputs.mqtt.messages import Topics
from beamtouch_service.outputs.mqtt.section import MqttSection
from beamtouch_service.outputs.mqtt.statuses import StatusSender
from service.bench import Bench, parsed, surface_of
from service.event_story import RESTING, TOUCHING
from service.scripted_broker import Scripted

TOPICS = Topics("hall")


class Taking(Scripted):
    """A connection that notes the contacts and events that it takes."""

    def __init__(self, *, listeners: bool = True, failure: Exception | None = None) -> None:
        super().__init__()
        self.sent: list[tuple[str, dict[str, Any], str, float]] = []
        self.told: list[list[tuple[str, int]]] = []
        """Topic and id of the events of each call."""
        self._listeners, self._failure = listeners, failure

    async def send(self, topic: str, text: bytes, properties: Properties, timeout_s: float) -> None:
        self.sent.append((topic, json.loads(text), str(vars(properties)["ContentType"]), timeout_s))

    async def tell(self, *messages: tuple[str, bytes], properties: Properties) -> bool:
        assert vars(properties)["ContentType"] == "application/json"
        self.told.append([(topic, json.loads(text)["id"]) for topic, text in messages])
        if self._failure:
            raise self._failure
        return self._listeners


async def run_until(run: Callable[[Any], Awaitable[None]], connection: Scripted, is_done: Callable[[], bool]) -> None:
    """Let a sender run over a connection until then, and a while longer."""
    running = asyncio.ensure_future(run(connection))
    async with asyncio.timeout(30):
        for _ in iter(lambda: is_done() or running.done(), True):
            await asyncio.sleep(0.001)
    for _ in range(20):
        await asyncio.sleep(0)
    running.cancel()
    await asyncio.wait([running])


def test_a_contact_may_wait_until_it_is_too_old_and_a_problem_for_as_long(bench: Bench) -> None:
    (surface,) = bench.app.context.registry
    counts = bench.app.context.counts
    sender, connection = ContactSender(bench.app.context, TOPICS, 10.0, counts.counter("sent", "Sent.")), Taking()

    async def play() -> None:
        running = asyncio.ensure_future(sender.run(cast("Any", connection)))
        for later_s, batch in ((0.0, None), (0.0, parsed(TOUCHING)), (1.0, parsed(TOUCHING, sequence=2))):
            bench.now_s += later_s
            if batch:
                surface.receive(batch, bench.now_s - 0.2)
            for _ in range(20):
                await asyncio.sleep(0)
        running.cancel()

    asyncio.run(play())
    assert [(topic, kind) for topic, _, kind, _ in connection.sent] == [
        ("hall/press-7/contact", "application/problem+json"),
        *[("hall/press-7/contact", "application/json")] * 2,
    ]
    assert [content.get("sequence") for _, content, _, _ in connection.sent] == [None, 1, 2]
    assert [timeout_s for *_, timeout_s in connection.sent] == pytest.approx([0.5, 0.3, 0.3])
    assert connection.said == ["confirm"] * 3
    assert counts.registry.get_sample_value("beamtouch_sent_total") == 3


def test_a_status_is_sent_at_first_and_when_it_changes(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(statuses, "LOOK_S", 0.0)
    bench = Bench(surface_of(), surface_of("press-8"))
    connection, sender = Scripted(), StatusSender(bench.app.context, TOPICS)

    async def play() -> None:
        await run_until(sender.run, connection, lambda: len(connection.said) == 2)
        bench.app.context.registry.named("press-8").receive(parsed(RESTING), bench.now_s)
        await run_until(sender.run, connection, lambda: len(connection.said) == 4)

    asyncio.run(play())
    found = [line.partition(" {")[0] for line in connection.said]
    assert found == ["keep hall/press-7/status", "keep hall/press-8/status"] * 2
    assert ['"status": "ready"' in line for line in connection.said] == [False, False, False, True]


def test_a_broker_that_refuses_a_status_is_asked_again_only_after_half_a_minute_also_by_the_next_connection(
    monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    assert REFUSED_RETRY_S == 30.0
    monkeypatch.setattr(statuses, "LOOK_S", 0.0)
    bench = Bench(surface_of(), surface_of("press-8"))
    refused: dict[str, Exception] = {"keep hall/press-7/status": RefusedError("Not authorized")}
    one, other, sender = Scripted(refused=refused), Scripted(), StatusSender(bench.app.context, TOPICS)

    async def play() -> None:
        await run_until(sender.run, one, lambda: bool(caplog.messages))
        await run_until(sender.run, other, lambda: True)

    asyncio.run(play())
    assert (len(one.said), other.said) == (1, [])
    assert caplog.messages == [
        "the MQTT broker refuses messages to hall/press-7/status (Not authorized); allow this user to write there"
    ]


def sender_of(bench: Bench, monkeypatch: pytest.MonkeyPatch) -> EventSender:
    """Return a sender of two events, which does not pause before it sends them again."""
    monkeypatch.setattr(events, "RETRY_S", 0.0)
    bench.send(RESTING, TOUCHING, RESTING, TOUCHING, RESTING)
    assert bench.get("/events").status_code == 200
    section = MqttSection(host="broker", prefix="hall", send_recorded_events=True)
    return EventSender(bench.app.context, section, TOPICS, bench.app.context.counts.counter("sent", "Sent."))


def counted(bench: Bench) -> tuple[float | None, float | None]:
    """Return how many events are pending, and how many are acknowledged."""
    value = bench.app.context.counts.registry.get_sample_value
    return value("beamtouch_mqtt_events_pending"), value("beamtouch_sent_total")


BOTH = [("hall/press-7/event", 1), ("hall/press-7/event", 2)]


@pytest.mark.parametrize(("return_s", "found"), [(3600.0, (2, 0)), (-1.0, (0, 2))])
def test_events_without_a_subscriber_are_sent_again_until_those_of_before_have_had_time_to_return(
    bench: Bench, monkeypatch: pytest.MonkeyPatch, return_s: float, found: tuple[float, float]
) -> None:
    assert events.RETURN_S == 10.0
    monkeypatch.setattr(events, "RETURN_S", return_s)
    connection, sender = Taking(listeners=False), sender_of(bench, monkeypatch)

    async def play() -> None:
        await sender.count_pending()
        assert counted(bench) == (2, 0)
        is_again = found == (2, 0)
        await run_until(
            sender.run, connection, lambda: len(connection.told) > 1 if is_again else counted(bench) == (0, 2)
        )

    assert bench.event_loop is not None
    bench.event_loop.call(play)
    assert counted(bench) == found
    assert connection.told[:2] == [BOTH] * (2 if found == (2, 0) else 1)


def test_a_broker_that_refuses_events_is_asked_again_only_after_half_a_minute_also_by_the_next_connection(
    bench: Bench, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    one, other = Taking(failure=RefusedError("Not authorized")), Taking()
    sender = sender_of(bench, monkeypatch)

    async def play() -> None:
        await run_until(sender.run, one, lambda: bool(caplog.messages))
        await run_until(sender.run, other, lambda: True)

    assert bench.event_loop is not None
    bench.event_loop.call(play)
    assert (one.told, other.told, counted(bench)) == ([BOTH], [], (2, 0))
    assert caplog.messages == [
        "the MQTT broker refuses events (Not authorized); allow this user to write to hall/+/event"
    ]


def test_an_answer_that_comes_too_late_or_never_is_told_and_the_first_loss_counts() -> None:
    async def play() -> None:
        answers, good = BrokerAnswers(), ReasonCode(PacketTypes.PUBACK)
        answers.give(1, good)  # nobody waits for it
        waiting = answers.expect(2)
        answers.give(2, good)
        answers.give(2, None)
        assert await answers.wait(waiting, 1.0) is good
        with pytest.raises(BrokerError, match=r"^it does not answer$"):
            await answers.wait(answers.expect(3), 0.0)
        answers.give(3, good)
        with_no_reason = answers.expect(4)
        answers.give(4, None)
        with pytest.raises(BrokerError, match=r"^the connection is lost$"):
            await answers.wait(with_no_reason, 1.0)
        both = answers.expect(5), answers.expect(6)
        answers.lose("no route")
        answers.lose("another")
        for one in both:
            with pytest.raises(BrokerError, match=r"^no route$"):
                await answers.wait(one, 1.0)

    asyncio.run(play())


def certificate_error(code: int) -> ssl.SSLCertVerificationError:
    error = ssl.SSLCertVerificationError("verify failed")
    error.verify_code, error.verify_message = code, "it is so."
    return error


@pytest.mark.parametrize(
    ("error", "words"),
    [
        (TimeoutError(), "it does not answer"),
        (ConnectionRefusedError(111, "Connection refused"), "Connection refused"),
        (OSError("no such thing"), "no such thing"),
        (ssl.SSLError(1, "wrong version"), "wrong version"),
        (certificate_error(9), "certificate verify failed: it is so; renew it, or check the clock of this machine"),
        (certificate_error(10), "certificate verify failed: it is so; renew it, or check the clock of this machine"),
        (certificate_error(8), "certificate verify failed: it is so; check mqtt.ca_file"),
        (certificate_error(11), "certificate verify failed: it is so; check mqtt.ca_file"),
    ],
)
def test_why_no_connection_could_be_made(error: OSError, words: str) -> None:
    assert reason_of(error) == words


def test_a_reason_of_the_standard_has_words_of_ours_and_another_one_its_own() -> None:
    assert words_for("Keep alive timeout") == "it does not answer"
    assert words_for("Server busy") == "Server busy"


@pytest.mark.parametrize(("tls", "port", "found"), [(False, None, 1883), (True, None, 8883), (True, 1884, 1884)])
def test_a_broker_has_the_port_of_the_standard(tls: bool, port: int | None, found: int) -> None:
    assert MqttSection(host="b", tls=tls, port=port).broker_port == found
