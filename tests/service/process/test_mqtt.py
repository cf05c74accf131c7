"""Contacts, events and the status of a service at a real broker."""

import json
import signal
from itertools import count

import pytest
from jinja2.sandbox import ImmutableSandboxedEnvironment

from beamtouch_common.commands import version
from service.bench import Row
from service.event_story import RESTING, TOUCHING
from service.process.broker import Subscriber
from service.process.conftest import Service
from service.process.mqtt_line import (
    CONTACT,
    EVENT,
    STATUS,
    Line,
    events,
    metric,
    now_batch,
    wait_connected,
    wait_for,
)


def states(subscriber: Subscriber) -> list[str]:
    """Return the states that arrived, without repetitions."""
    found = [one.get("state") or one["type"].rpartition(":")[2] for one in subscriber.of(CONTACT)]
    return [one for index, one in enumerate(found) if index == 0 or one != found[index - 1]]


@pytest.mark.promise(
    "docs/how-to/mqtt.md",
    "The content type of the message (an MQTT 5 property) is `application/json` or `application/problem+json`.",
    "the answer of `GET /surfaces/SURFACE/contact`",
)
def test_a_contact_is_the_answer_of_get_contact(line: Line) -> None:
    subscriber = line.broker.subscribe("-t", "beamtouch/#")
    service = line.start()
    wait_for(lambda: service.get("/contact").json() in subscriber.of(CONTACT))
    problem = next(one for one in subscriber.messages if one.topic == CONTACT)
    assert (problem.content["type"], problem.content_type) == (
        "urn:beamtouch:problem:no-samples",
        "application/problem+json",
    )
    service.post(now_batch(TOUCHING, sequence=1))
    wait_for(lambda: "contact" in states(subscriber))
    message = next(one for one in subscriber.messages if '"state"' in one.text)
    answer = service.get("/contact")
    assert list(message.content) == list(answer.json())
    assert message.content | {"age_ms": 0} == answer.json() | {"age_ms": 0}
    assert (message.content_type, message.is_retained) == ("application/json", False)
    assert 1 <= int(message.expiry_s) <= 60
    # A sample in the same state moves the figures; the next one is soon too old.
    service.post(now_batch([0.25, 0.5, 0.25], sequence=2))
    wait_for(lambda: any(one.get("sequence") == 2 for one in subscriber.of(CONTACT)))
    service.post(now_batch([0.25, 0.5, 0.25], sequence=3) | {"newest_age_ms": 59_500.0})
    wait_for(lambda: states(subscriber) == ["no-samples", "contact", "stale"])
    assert metric(service, 'messages_total{kind="contact"}') >= 4
    # The broker keeps no contact: a later subscriber gets none that may be too old.
    later = line.broker.subscribe("-t", "beamtouch/#")
    wait_for(lambda: len(later.of(CONTACT)) > 1)
    assert not [one for one in later.messages if one.is_retained and one.topic == CONTACT]


@pytest.mark.promise("docs/how-to/mqtt.md", "An event is sent when it has ended.")
def test_events_are_those_of_get_events_and_open_ones_wait(line: Line) -> None:
    subscriber = line.broker.subscribe("-t", EVENT)
    service = line.start()
    wait_connected(service)
    service.post(now_batch(RESTING, TOUCHING, TOUCHING, RESTING, TOUCHING, sequence=1))
    wait_for(lambda: len(subscriber.of(EVENT)) == 1)
    is_open, lifted = events(service)
    assert (is_open["end"], lifted["end"]) == ("open", "lift")
    assert subscriber.of(EVENT) == [lifted]
    service.post(now_batch(RESTING, sequence=6))
    wait_for(lambda: len(subscriber.of(EVENT)) == 2)
    assert subscriber.of(EVENT) == events(service)[::-1]
    wait_for(lambda: metric(service, "events_pending") == 0)


@pytest.mark.promise("docs/how-to/mqtt.md", "The broker sends `offline` when the connection ends, whatever the reason.")
@pytest.mark.parametrize("how", [signal.SIGKILL, signal.SIGTERM])
def test_the_broker_says_when_the_service_is_gone(line: Line, how: signal.Signals) -> None:
    subscriber = line.broker.subscribe("-t", "beamtouch/#")
    service = line.start()
    wait_for(lambda: subscriber.texts(STATUS) == ["online"])
    service.post(now_batch(TOUCHING, sequence=1))
    wait_for(lambda: "contact" in states(subscriber))
    _, errors = service.stop(how)
    assert "ERROR" not in errors
    wait_for(lambda: subscriber.texts(STATUS) == ["online", "offline"])

    # The broker keeps the statuses, and nothing that was a contact.
    later = line.broker.subscribe("-t", "beamtouch/#")
    wait_for(lambda: bool(later.messages))
    service = line.start()
    wait_for(lambda: later.texts(STATUS) == ["offline", "online"])
    kept = {one.topic: one.text for one in later.messages if one.is_retained}
    assert kept.keys() == {STATUS, "beamtouch/press-7/status"}
    assert kept[STATUS] == "offline"


@pytest.mark.promise(
    "docs/how-to/mqtt.md",
    "`channels` are those that are the cause",
    "The broker retains the last one.",
)
def test_the_status_names_a_channel_that_is_out_and_is_kept_until_it_is_back(line: Line) -> None:
    topic, sequence = "beamtouch/press-7/status", count(1)
    subscriber = line.broker.subscribe("-t", topic)
    service = line.start(degraded_after_s=0.5)

    def is_told(word: str, *out: str) -> bool:
        """Send a sample, in which s3 is missing if it is to be out; return whether the newest status says so."""
        quality = ["good", "good", "missing" if out else "good"]
        row: Row = [0.0, 0.0, None if out else 0.0]
        service.post(now_batch(row, sequence=next(sequence), quality=quality))
        return subscriber.of(topic)[-1:] == [{"surface": "press-7", "status": word, "channels": list(out)}]

    wait_for(lambda: is_told("ready"))
    wait_for(lambda: is_told("channels-out", "s3"))
    later = line.broker.subscribe("-t", topic)
    wait_for(lambda: later.of(topic) == subscriber.of(topic)[-1:])
    wait_for(lambda: is_told("ready"))


@pytest.mark.promise(
    "docs/how-to/mqtt.md",
    (
        "A broker that the record does not know yet gets the events from the start of the service on, or all with "
        "`send_recorded_events`."
    ),
)
@pytest.mark.promise(
    "docs/reference/service-configuration.md",
    "Also send a new broker the events that were recorded before.",
)
def test_events_from_before_are_sent_only_where_that_is_asked_for(line: Line) -> None:
    subscriber = line.broker.subscribe("-t", "+/press-7/event")

    def record(service: Service, sequence: int, messages: int) -> None:
        service.post(now_batch(RESTING, TOUCHING, RESTING, sequence=sequence))
        wait_for(lambda: len(subscriber.messages) == messages)
        wait_for(lambda: metric(service, "events_pending") == 0)
        service.stop(signal.SIGTERM)

    record(line.start('prefix = "first"'), 1, messages=1)
    record(line.start('prefix = "second"'), 4, messages=2)
    service = line.start('prefix = "third"', "send_recorded_events = true")
    wait_for(lambda: len(subscriber.messages) == 4)
    found = [(one.topic.partition("/")[0], one.content["id"]) for one in subscriber.messages]
    assert found == [("first", 1), ("second", 2), ("third", 1), ("third", 2)]
    service.stop(signal.SIGTERM)
    # What it has acknowledged does not come again, and it goes on after its last one.
    record(line.start('prefix = "first"'), 7, messages=6)
    assert [one.content["id"] for one in subscriber.messages[4:]] == [2, 3]


@pytest.mark.promise(
    "docs/how-to/mqtt.md",
    "on if the contact is `inside`, off if `outside`, and otherwise unknown.",
    "and `problem`, which is on unless the status is `ready`.",
)
def test_home_assistant_learns_of_each_surface(line: Line) -> None:
    zones = '[surfaces.press-7.zones."in.feed"]\nfrom_mm = 0\nto_mm = 100\n'
    service = line.start("home_assistant_discovery = true", sections=zones)
    wait_connected(service)
    subscriber = line.broker.subscribe("-t", "homeassistant/#")
    wait_for(lambda: bool(subscriber.messages))
    (found,) = subscriber.messages
    assert (found.is_retained, found.topic) == (True, "homeassistant/device/beamtouch/press-7/config")
    said = json.loads(found.text)
    assert said["origin"]["sw_version"] == version()
    assert (said["availability_topic"], said["payload_not_available"]) == (STATUS, "offline")
    position = said["components"]["position"]
    assert (position["platform"], position["state_topic"], position["unit_of_measurement"]) == ("sensor", CONTACT, "mm")
    assert position["value_template"] == "{{ value_json.position_mm | default(none) }}"
    assert position["expire_after"] == 3
    problem = said["components"]["problem"]
    assert (problem["platform"], problem["state_topic"]) == ("binary_sensor", "beamtouch/press-7/status")
    assert problem["value_template"] == "{{ 'OFF' if value_json.status == 'ready' else 'ON' }}"
    assert len({one["unique_id"] for one in said["components"].values()}) == 5
    zone = said["components"]["zone_in.feed"]
    assert (zone["platform"], zone["state_topic"], zone["expire_after"]) == ("binary_sensor", CONTACT, 3)
    # Home Assistant renders it in such an environment, and takes "None" for unknown.
    template = ImmutableSandboxedEnvironment().from_string(zone["value_template"])
    for answer, shown in (("inside", "ON"), ("outside", "OFF"), ("unsure", "None"), (None, "None")):
        assert template.render(value_json={"zones": {"in.feed": answer}}) == shown
    assert template.render(value_json={"title": "Stale"}) == "None"
