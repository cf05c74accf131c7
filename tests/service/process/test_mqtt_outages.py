"""A broker that is killed, frozen, started again or away: the service does not mind, and no event is missing."""

from __future__ import annotations

import itertools
import signal
import time
from typing import TYPE_CHECKING

import pytest

from free_ports import free_port
from service.process.mqtt_line import (
    CONTACT,
    EVENT,
    RESTING,
    STATUS,
    TOUCHING,
    Sender,
    events,
    metric,
    now_batch,
    wait_connected,
    wait_for,
)
from service.process.relay import Relay

if TYPE_CHECKING:
    from service.process.mqtt_line import Line

STALE_S = 1.0
FROZEN_S = 4.5
"""Several times STALE_S, and too short for the service to give the connection up: that drops what waits in it."""
SLOW_S = 2.0
"""For a message to reach the subscriber's file on a busy machine."""


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

    service = line.start()
    wait_for(lambda: metric(service, "events_pending") == 10)
    line.broker.start()
    # Nobody listens yet: the events wait a while for subscribers to return.
    wait_connected(service)
    subscriber = line.broker.subscribe("-t", EVENT)
    wait_for(lambda: metric(service, "events_pending") == 0)
    assert {one["id"]: one for one in subscriber.of(EVENT)} == {one["id"]: one for one in events(service)}
    _, errors = service.stop(signal.SIGTERM)
    assert errors.count("the service goes on and tries again") == 1
    assert errors.count("connected again after") == 1
    assert "ERROR" not in errors


@pytest.mark.long
@pytest.mark.parametrize("is_long", [False, True])
def test_a_frozen_broker_finds_no_old_contact_when_it_goes_on(line: Line, *, is_long: bool) -> None:
    subscriber = line.broker.subscribe("-t", "beamtouch/#")
    service = line.start(stale_ms=STALE_S * 1e3)
    sender = Sender(service)
    sender.start()
    wait_for(lambda: len(subscriber.of(EVENT)) >= 2)
    line.broker.signal(signal.SIGSTOP)
    count = len(subscriber.of(EVENT))
    time.sleep(FROZEN_S)  # the outage
    if is_long:
        wait_for(lambda: metric(service, "contacts_dropped_total") >= 1)
    wait_for(lambda: service.get("/contact").is_success)  # a starved sender may be late, too
    line.broker.signal(signal.SIGCONT)
    wait_for(lambda: len(subscriber.of(EVENT)) > count + 2)
    sender.stop()
    wait_for(lambda: metric(service, "events_pending") == 0)

    contacts = [one for one in subscriber.messages if one.topic == CONTACT and '"state"' in one.text]
    assert max(one.content["age_ms"] for one in contacts) <= STALE_S * 1e3
    # A busy machine may delay the way of a sample to the service: from its receipt on it counts.
    late = [one for one in contacts if one.at_s - sender.receipts[one.content["sequence"]] > STALE_S + SLOW_S]
    # The broker may freeze between its answer and the contact.
    assert len(late) <= 1
    wait_for(lambda: {one["id"] for one in events(service)} == {one["id"] for one in subscriber.of(EVENT)})
    assert subscriber.texts(STATUS)[-1] == "online"


def test_events_go_on_in_a_file_that_replaced_another(line: Line) -> None:
    subscriber = line.broker.subscribe("-t", EVENT)
    service = line.start()
    wait_connected(service)
    service.post(now_batch(RESTING, TOUCHING, RESTING, sequence=1))
    wait_for(lambda: len(subscriber.of(EVENT)) == 1)
    for path in line.folder.glob("events.db*"):
        path.unlink()
    # The record begins anew with a later batch, and learns then where its events go.
    sequence = itertools.count(4, 3)

    def arrives() -> bool:
        service.post(now_batch(RESTING, TOUCHING, RESTING, sequence=next(sequence)))
        return len(subscriber.of(EVENT)) > 1

    wait_for(arrives)


def test_a_broker_that_was_never_there(line: Line) -> None:
    port = free_port()
    service = line.start(port=port)
    service.post(now_batch(TOUCHING, sequence=1))
    assert service.get("/contact").json()["state"] == "contact"
    wait_for(lambda: metric(service, "connected") == 0)
    wait_for(lambda: "refused" in service.get("/health/ready").json()["missing"]["mqtt"])
    code, errors = service.stop(signal.SIGTERM)
    assert code == 0
    (said,) = [one for one in errors.splitlines() if f"127.0.0.1:{port}" in one]
    assert "refused" in said.lower()


@pytest.mark.long
def test_a_contact_that_the_socket_does_not_take_in_time_is_dropped(line: Line) -> None:
    """The broker answers, and then takes nothing: what has not left the service's machine must never leave it."""
    names = [f"press-{number}" for number in range(7, 47)]
    relay = Relay(line.broker.port)
    service = line.start(stale_ms=STALE_S * 1e3, port=relay.port, surfaces=names)
    for name in names[:5]:
        batch = now_batch(TOUCHING, sequence=1)
        assert service.post(batch, surface=name).status_code == 200
    relay.start()
    try:
        assert relay.is_over.wait(60)
        # Without a limit for each contact, an acknowledgement that does not come ends the connection after 5 s.
        assert relay.reset_s < STALE_S + SLOW_S
        assert len(relay.rest) <= relay.waiting_bytes < 10_000
        wait_connected(service)
    finally:
        relay.close()
    _, errors = service.stop(signal.SIGTERM)
    assert "it does not answer; the service goes on and tries again" in errors
