"""Properties of the messages to a broker, and what those that it keeps say of other services."""

import asyncio
from contextlib import suppress
from pathlib import Path

import pytest

from beamtouch_service.access import Access
from beamtouch_service.outputs.mqtt.connection import Connection
from beamtouch_service.outputs.mqtt.contacts import ContactSender
from beamtouch_service.outputs.mqtt.failures import BrokerError
from beamtouch_service.outputs.mqtt.leftovers import Leftovers
from beamtouch_service.outputs.mqtt.messages import JSON, Kept, Topics, properties
from beamtouch_service.outputs.mqtt.publisher import make
from beamtouch_service.outputs.mqtt.section import MqttSection
from beamtouch_service.surfaces.pace import Pace
from beamtouch_service.surfaces.watch import Watch
from service.bench import Bench, parsed
from service.event_story import TOUCHING


@pytest.mark.promise(
    "docs/how-to/mqtt.md",
    "Each contact also has a message expiry: the limit of the surface, rounded up to whole seconds.",
)
@pytest.mark.parametrize(("stale_ms", "expiry_s"), [(1.0, 1), (500.0, 1), (1000.0, 1), (1001.0, 2), (60_000.0, 60)])
def test_a_contact_expires_at_the_broker_with_the_limit_of_its_surface(stale_ms: float, expiry_s: int) -> None:
    assert vars(properties(JSON, stale_ms))["MessageExpiryInterval"] == expiry_s


def test_an_event_does_not_expire() -> None:
    assert "MessageExpiryInterval" not in vars(properties(JSON))


@pytest.mark.parametrize(
    ("has_password", "has_tls", "is_told"), [(False, False, False), (True, False, True), (True, True, False)]
)
def test_a_password_without_tls_is_warned_of(tmp_path: Path, has_password: bool, has_tls: bool, is_told: bool) -> None:
    (tmp_path / "password").write_text("a long password\n")
    password = {"username": "u", "password_file": tmp_path / "password"} if has_password else {}
    section = MqttSection.model_validate({"host": "broker", "tls": has_tls} | password)
    warnings = make(section, ["press-7"], Access()).warnings
    assert [words.partition(":")[0] for words in warnings] == ["no TLS to the MQTT broker"] * is_told


class Broker:
    """A broker that takes so long to answer, or does not."""

    def __init__(self, bench: Bench, after_s: float, *, answers: bool) -> None:
        self._bench, self._after_s, self._answers = bench, after_s, answers

    async def confirm(self) -> None:
        self._bench.now_s += self._after_s
        if not self._answers:
            raise BrokerError("no answer")


@pytest.mark.parametrize(
    ("age_s", "after_s", "answers", "dropped"),
    [
        (0.0, 0.5, True, 0.0),
        (0.0, 0.51, True, 1.0),
        (0.0, 0.1, False, 1.0),
        (0.6, 0.1, True, 0.0),  # it was too old before
        (0.6, 0.1, False, 0.0),
    ],
)
@pytest.mark.anyio
async def test_a_contact_that_became_too_old_while_the_broker_did_not_answer_is_counted(
    bench: Bench, age_s: float, after_s: float, answers: bool, dropped: float
) -> None:
    (surface,) = bench.app.context.registry
    surface.receive(parsed(TOUCHING), bench.now_s - age_s)
    counts = bench.app.context.counts
    sender = ContactSender(bench.app.context, Topics("b"), 10.0, counts.counter("sent", "Sent."))
    watch = Watch([surface], Pace([surface], 0.1), bench.app.context.clock)
    broker = Broker(bench, after_s, answers=answers)
    with suppress(BrokerError):
        await sender._confirm(broker, watch)  # type: ignore[arg-type]
    assert counts.registry.get_sample_value("beamtouch_mqtt_contacts_dropped_total") == dropped


@pytest.mark.parametrize(
    ("owner", "text", "is_new", "is_told"),
    [
        ("two", b"online", True, True),
        ("two", b"online", False, True),  # it was connected before
        ("two", b"offline", True, True),
        ("two", b"offline", False, False),  # it is gone: perhaps this service, under its former client_id
        ("two", b"", True, False),
        ("one", b"online", True, False),
        (None, b"online", True, False),
    ],
)
def test_another_service_that_writes_to_the_same_topic_now_is_told_once(
    caplog: pytest.LogCaptureFixture, owner: str | None, text: bytes, is_new: bool, is_told: bool
) -> None:
    topics = Topics("hall")

    async def settle() -> None:
        connection = Connection(MqttSection(host="broker", prefix="hall", client_id="one"), None, None)
        leftovers = Leftovers(topics, ["press-7"], {}, "broker:1883")
        for _ in range(2):
            await leftovers._settle(connection, Kept(topics.status, text, owner, is_new))

    asyncio.run(settle())
    words = "MQTT broker broker:1883: another service (two) writes to hall/status, too; give each service a prefix of"
    assert [line.startswith(words) for line in caplog.messages] == [True] * is_told
