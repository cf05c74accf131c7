"""What a service does about messages that the broker keeps: its own that nobody needs, and those of others."""

import asyncio
import json
import logging
from contextlib import suppress

import pytest

from beamtouch_service.outputs.mqtt import discovery, leftovers
from beamtouch_service.outputs.mqtt.connection import Connection
from beamtouch_service.outputs.mqtt.failures import BrokerError, RefusedError
from beamtouch_service.outputs.mqtt.leftovers import Leftovers
from beamtouch_service.outputs.mqtt.messages import Kept, Topics
from beamtouch_service.outputs.mqtt.section import MqttSection
from service.scripted_broker import Scripted

TOPICS = Topics("hall")
STATUS = "hall/status"
DESCRIBED = "homeassistant/device/hall/press-7/config"
ASKED = ["subscribe hall/status", "subscribe hall/+/status", "subscribe homeassistant/device/hall/+/config"]
REFUSED, LOST = RefusedError("Not authorized"), BrokerError("the connection is lost")


def described(*components: str, **others: object) -> bytes:
    """Return a description with these components."""
    each = {name: {"platform": "sensor", "state_topic": "x"} for name in components}
    return json.dumps({"components": each | others}).encode()


def made(description: bytes | None = None) -> Leftovers:
    return Leftovers(TOPICS, ["press-7"], {DESCRIBED: description} if description else {}, "broker:1883")


def begin(one: Leftovers, *connections: Scripted) -> list[list[str]]:
    """Begin over each of these; return what was asked of them."""

    async def run() -> None:
        for connection in connections:
            connection.received = asyncio.Queue()
            with suppress(BrokerError):
                await one.begin(connection)  # type: ignore[arg-type]

    asyncio.run(run())
    return [connection.said for connection in connections]


def kept(topic: str, text: bytes = b"ready", owner: str | None = "one") -> Kept:
    return Kept(topic, text, owner, is_new=False)


@pytest.fixture(autouse=True)
def _all_lines(caplog: pytest.LogCaptureFixture) -> None:
    caplog.set_level(logging.INFO)


@pytest.mark.promise("docs/how-to/mqtt.md", "so a service removes only what it has retained itself.")
def test_of_what_the_broker_keeps_only_that_of_its_own_without_a_surface_goes(caplog: pytest.LogCaptureFixture) -> None:
    gone = "hall/press-8/status"
    messages = [
        kept("hall/press-7/status"),
        kept("hall/press-9/status", owner="two"),
        kept("hall/press-9/status", owner=None),
        kept("hall/press-6/status", b""),
        kept(gone),
        kept(DESCRIBED, owner=None),
    ]
    (said,) = begin(made(), Scripted(kept=messages))
    assert said == [*ASKED, "confirm", f"keep {gone}  application/json"]
    assert caplog.messages == [
        "MQTT broker broker:1883: removed hall/press-8/status, which this configuration no longer has"
    ]


def test_a_component_that_a_description_no_longer_has_is_removed_and_then_the_description_told_again() -> None:
    now = described("state", "problem")
    (same,) = begin(made(now), Scripted(kept=[kept(DESCRIBED, described("state"))]))
    assert same == [*ASKED, "confirm"]
    (said,) = begin(made(now), Scripted(kept=[kept(DESCRIBED, described("state", "zone_feed", "problem"))]))
    removing, again = (line.partition(" {")[2] for line in said[len(ASKED) + 1 :])
    assert json.loads("{" + removing.removesuffix(" application/json"))["components"] == {
        **json.loads(now)["components"],
        "zone_feed": {"platform": "sensor"},
    }
    assert again == now.decode()[1:] + " application/json"
    (of_another,) = begin(made(now), Scripted(kept=[kept(DESCRIBED, described("zone_feed"), "two")]))
    assert of_another == [*ASKED, "confirm"]


@pytest.mark.parametrize("text", [b"", b"offline", b"[]", b'{"components": []}', b'{"components": {"a": 7}}'])
def test_a_text_that_is_no_description_has_no_components(text: bytes) -> None:
    assert discovery.components(text) == {}


def test_components_are_those_with_more_than_a_platform() -> None:
    found = discovery.components(described("a", going={"platform": "sensor"}, on={"platform": "switch", "name": "b"}))
    assert found == {"a": "sensor", "on": "switch"}


@pytest.mark.parametrize("has_descriptions", [True, False])
def test_what_may_not_be_read_is_a_line_once_if_it_matters(
    caplog: pytest.LogCaptureFixture, has_descriptions: bool
) -> None:
    one = made(described("state")) if has_descriptions else made()
    begin(one, *(Scripted(refused=dict.fromkeys(ASKED, REFUSED)) for _ in range(2)))
    topics = [STATUS, "hall/+/status", *(["homeassistant/device/hall/+/config"] * has_descriptions)]
    assert caplog.messages == [
        f"MQTT broker broker:1883: this user may not read {topic} (Not authorized); allow it, or what you remove here "
        "stays there"
        for topic in topics
    ]


def test_a_request_that_ends_the_connection_twice_in_a_row_is_made_no_more(caplog: pytest.LogCaptureFixture) -> None:
    cutting: dict[str, Exception] = {ASKED[1]: LOST}
    plan: list[dict[str, Exception]] = [cutting, {}, cutting, cutting, cutting]
    asked = begin(made(), *(Scripted(refused=dict(refused)) for refused in plan))
    whole, cut, without = [*ASKED, "confirm"], ASKED[:2], [ASKED[0], ASKED[2], "confirm"]
    assert asked == [cut, whole, cut, cut, without]
    assert caplog.messages == [
        "MQTT broker broker:1883: this user may not read hall/+/status (it ends the connection); allow it, or what you "
        "remove here stays there"
    ]


GONE = "keep hall/press-8/status"


@pytest.mark.parametrize(
    ("plan", "tries", "reason"),
    [
        ([REFUSED, REFUSED], [1, 0], "Not authorized"),
        ([LOST, LOST, LOST], [1, 1, 0], "it ends the connection"),
        ([LOST, None, LOST, LOST, LOST], [1, 1, 1, 1, 0], "it ends the connection"),
    ],
)
def test_what_the_broker_does_not_let_go_is_left_alone_and_named(
    caplog: pytest.LogCaptureFixture, plan: list[Exception | None], tries: list[int], reason: str
) -> None:
    connections = [
        Scripted(refused={GONE: failure} if failure else {}, kept=[kept("hall/press-8/status")]) for failure in plan
    ]
    assert [sum(line.startswith(GONE) for line in said) for said in begin(made(), *connections)] == tries
    assert [line for line in caplog.messages if "removed" not in line] == [
        f"MQTT broker broker:1883: it refuses messages to hall/press-8/status ({reason}), which is of no surface any "
        "more; remove it there"
    ]


class Heard(logging.Handler):
    """Notices the first line of the log."""

    def __init__(self, said: asyncio.Event) -> None:
        super().__init__()
        self._said = said

    def emit(self, _record: logging.LogRecord) -> None:
        self._said.set()


@pytest.mark.parametrize(
    ("message", "is_readable"),
    [
        (kept(STATUS, b"online"), True),
        (kept(STATUS, b"offline", "two"), False),
        (kept("hall/press-7/status"), False),
        (None, False),
    ],
)
def test_who_never_hears_its_own_status_may_not_read(
    caplog: pytest.LogCaptureFixture, monkeypatch: pytest.MonkeyPatch, message: Kept | None, is_readable: bool
) -> None:
    """Some brokers take a subscription that they do not serve."""
    monkeypatch.setattr(leftovers, "ANSWER_S", 0.01)

    async def run() -> None:
        connection = Scripted()
        if message:
            connection.received.put_nowait(message)
        if is_readable:
            connection.received.put_nowait(kept("hall/press-8/status"))
        running, said = asyncio.ensure_future(made().run(connection)), asyncio.Event()  # type: ignore[arg-type]
        logging.getLogger().addHandler(heard := Heard(said))
        async with asyncio.timeout(30):
            await said.wait()
        logging.getLogger().removeHandler(heard)
        running.cancel()

    asyncio.run(run())
    assert caplog.messages == [
        "MQTT broker broker:1883: removed hall/press-8/status, which this configuration no longer has"
        if is_readable
        else f"MQTT broker broker:1883: this user may not read {STATUS}; allow it, or what you remove here stays there"
    ]


def test_a_connection_has_the_identifier_of_the_configuration_or_the_prefix() -> None:
    async def owners() -> list[str]:
        sections = [MqttSection(host="b", prefix="hall", client_id=one) for one in ("press", None)]
        return [Connection(section, None, None).owner for section in sections]

    assert asyncio.run(owners()) == ["press", "hall"]
