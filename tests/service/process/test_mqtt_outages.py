"""A broker that is killed, frozen, started again or away: the service does not mind, and no event is missing."""

import signal
import time

import pytest

from service.event_story import RESTING, TOUCHING
from service.process.mqtt_line import (
    CONTACT,
    EVENT,
    STATUS,
    Line,
    Sender,
    events,
    metric,
    now_batch,
    wait_connected,
    wait_for,
)
from service.process.stalling_relay import StallingRelay

STALE_S = 1.0
WITHOUT_OTHER_LIMITS = (
    "from beamtouch_service.outputs.mqtt import connection; connection.ANSWER_S = connection.KEEPALIVE_S = 600"
)
"""A missing acknowledgement and a missing sign of life end a connection, too: here only after the test."""


@pytest.mark.promise(
    "docs/how-to/mqtt.md",
    "What the broker has not acknowledged is sent again, also after a restart of the service if `events.file` is set.",
    "an event that reached no subscriber is repeated until it reaches one",
)
def test_events_of_an_outage_arrive_when_the_broker_is_back(line: Line) -> None:
    service = line.start()
    wait_connected(service)
    line.broker.kill()
    wait_for(lambda: metric(service, "connected") == 0)
    for sequence in range(1, 41, 4):
        service.post(now_batch(RESTING, TOUCHING, RESTING, RESTING, sequence=sequence))
    assert service.get("/contact").json()["state"] == "clear"
    wait_for(lambda: metric(service, "events_pending") == 10)
    # The service itself goes, too.
    _, errors = service.stop(signal.SIGKILL)
    assert errors.count("the service goes on and tries again") == 1
    assert errors.count(f"{line.broker.port}: connected; topics beamtouch/...") == 1

    service = line.start()
    wait_for(lambda: metric(service, "events_pending") == 10)
    line.broker.start()
    # Nobody listens yet: the events wait a while for subscribers to return.
    wait_connected(service)
    subscriber = line.broker.subscribe("-t", EVENT)
    wait_for(lambda: metric(service, "events_pending") == 0)
    # The broker has them all; the subscriber may be reading still.
    wait_for(lambda: len(subscriber.of(EVENT)) >= 10)
    assert {one["id"]: one for one in subscriber.of(EVENT)} == {one["id"]: one for one in events(service)}
    _, errors = service.stop(signal.SIGTERM)
    assert errors.count("the service goes on and tries again") == 1
    assert errors.count("connected again after") == 1
    assert "ERROR" not in errors


@pytest.mark.promise(
    "docs/how-to/mqtt.md",
    "Outages that follow each other within a minute, for the same reason, are counted in the next line.",
)
def test_services_that_take_each_others_connection_fill_no_log(line: Line) -> None:
    services = [line.start(), line.start()]
    wait_for(lambda: line.broker.log.count("already connected, closing old connection") >= 6)
    for service in services:
        _, errors = service.stop(signal.SIGTERM)
        reasons = [one.partition("WARNING")[2] for one in errors.splitlines() if "tries again" in one]
        assert len(reasons) == len(set(reasons)) >= 1
        assert errors.count("connected again after") <= len(reasons)


@pytest.mark.promise(
    "docs/how-to/mqtt.md",
    "The service never queues a contact, and none leaves it older than the limit of its surface",
    "Only contacts that were written in the moment in which a broker froze, at most one per surface, can arrive late.",
)
@pytest.mark.long
@pytest.mark.parametrize("is_long", [False, pytest.param(True, marks=pytest.mark.soak)])
def test_a_frozen_broker_finds_no_old_contact_when_it_goes_on(line: Line, *, is_long: bool) -> None:
    """Neither in an outage that is too short for the service to give the connection up, nor in a longer one."""
    subscriber = line.broker.subscribe("-t", "beamtouch/#")
    service = line.start(stale_ms=STALE_S * 1e3)
    sender = Sender(service)
    sender.start()
    wait_for(lambda: len(subscriber.of(EVENT)) >= 2)

    line.broker.signal(signal.SIGSTOP)
    count, begin = len(subscriber.of(EVENT)), max(sender.receipts)
    # Many contacts would be due, and most of them become too old.
    wait_for(lambda: max(sender.receipts) > begin + 60)
    wait_for(lambda: time.time() - sender.receipts[begin] > 2 * STALE_S)
    if is_long:
        wait_for(lambda: metric(service, "contacts_dropped_total") >= 1)
    end = max(sender.receipts)
    line.broker.signal(signal.SIGCONT)
    wait_for(lambda: len(subscriber.of(EVENT)) > count + 2)
    sender.stop()
    wait_for(lambda: metric(service, "events_pending") == 0)

    contacts = [one for one in subscriber.of(CONTACT) if "state" in one]
    assert max(one["age_ms"] for one in contacts) <= STALE_S * 1e3
    # The broker may freeze between its answer and a contact. No other one that came meanwhile is sent afterwards.
    assert len({one["sequence"] for one in contacts if begin < one["sequence"] < end}) <= 1
    wait_for(lambda: {one["id"] for one in events(service)} == {one["id"] for one in subscriber.of(EVENT)})
    assert subscriber.texts(STATUS)[-1] == "online"


@pytest.mark.promise(
    "docs/how-to/mqtt.md",
    "contacts that were due but not sent: the broker did not answer before they were too old",
)
@pytest.mark.long
def test_a_contact_that_the_socket_does_not_take_in_time_is_dropped(line: Line) -> None:
    """The broker answers, and then takes nothing: what has not left the service's machine must never leave it."""
    names = [f"press-{number}" for number in range(7, 47)]
    relay = StallingRelay(line.broker.port)
    service = line.start(stale_ms=STALE_S * 1e3, port=relay.port, surfaces=names, code=WITHOUT_OTHER_LIMITS)
    for name in names[:5]:
        batch = now_batch(TOUCHING, sequence=1)
        assert service.post(batch, surface=name).status_code == 200
    relay.start()
    try:
        assert relay.is_over.wait(60)
        assert relay.is_reset
        assert len(relay.rest) <= relay.waiting_bytes < 10_000
        wait_connected(service)
    finally:
        relay.close()
    _, errors = service.stop(signal.SIGTERM)
    assert "it does not answer; the service goes on and tries again" in errors
