"""Contacts and events over OPC UA, as a client reads and subscribes to them."""

import asyncio
import json
from datetime import UTC, datetime, timedelta
from itertools import pairwise
from pathlib import Path
from typing import Any

import pytest
from asyncua import Client, Node, ua

from beamtouch_service.outputs.opcua import events
from service.bench import FIGURES, START_US, Row, batch_of
from service.process.opcua_client import Changes, connected, read, start
from support.programs.broken import broken
from support.running.waiting import wait_until

from .conftest import Service, StartService

REST: Row = [0.0, 0.0, 0.0]
TOUCHED: Row = [0.2, 0.3, 0.3]
ODD: Row = [0.2, 0.3, 0.5]


async def post(service: Service, first: int, *rows: Row) -> None:
    """Send samples numbered from `first` on, one each 20 ms."""
    batch = batch_of(*rows, sequence=first, begin_us=START_US + 20_000 * first, every_us=20_000)
    assert (await asyncio.to_thread(service.post, batch)).status_code == 200


async def require_contact(client: Client, service: Service) -> dict[str, Any]:
    """Require that a read says what the contact over HTTP says; return that."""
    contact: dict[str, Any] = (await asyncio.to_thread(service.get, "/surfaces/press-7/contact")).json()
    require_same(await read(client), contact)
    return contact


def require_same(found: dict[str, ua.DataValue], contact: dict[str, Any]) -> None:
    """Require that variables say what the contact of their sample says, and how good it is."""
    said = {name: one.Value.Value for name, one in found.items()}
    assert {name: said[name] for name in (*FIGURES, "state", "sequence")} == {
        name: contact[name] for name in (*FIGURES, "state", "sequence")
    }
    assert (said["notes"], said["zones/left"]) == (" ".join(contact["notes"]), contact["zones"]["left"])
    assert said["age_ms"] >= contact["age_ms"]
    assert f"{found['state'].SourceTimestamp:%FT%T}" == contact["sampled_at"][:19]
    assert found["state"].StatusCode.is_good() == (not contact["notes"] and contact["state"] != "unexplained")
    for name in FIGURES:
        assert found[name].StatusCode.is_good() == (contact["state"] == "contact" and not contact["notes"])


@pytest.mark.promise("docs/how-to/opcua.md", "there is no sample yet")
def test_each_read_gives_the_contact_of_its_moment_and_before_the_first_sample_none(start_press: StartService) -> None:
    service, url = start(start_press, 60_000, "interval_ms = 20")

    async def compare() -> None:
        async with connected(url) as client:
            before = await read(client)
            assert {one.StatusCode.name for one in before.values()} == {"BadWaitingForInitialData"}
            assert {one.Value.Value for one in before.values()} == {None}
            for number, row in enumerate([REST] * 10 + [TOUCHED] * 10 + [REST] * 10, 1):
                await post(service, number, row)
                if number % 5 == 0:
                    await require_contact(client, service)
            await post(service, 31, *[ODD] * 5)
            contact = await require_contact(client, service)
            assert (contact["state"], contact["notes"]) == ("unexplained", [])

    asyncio.run(compare())


@pytest.mark.promise(
    "docs/how-to/opcua.md",
    "A read, and the first value of a subscription, give the contact of their moment.",
)
@pytest.mark.promise("docs/reference/service-configuration.md", "A read is answered with the contact of its moment.")
def test_the_first_value_of_a_subscription_is_the_contact_of_its_moment(start_press: StartService) -> None:
    # With this interval, nobody looks at the surface between the two samples.
    service, url = start(start_press, 60_000, "interval_ms = 10000")

    async def subscribe() -> list[Any]:
        new, woken = Changes(), Changes()
        async with connected(url) as client:
            assert (await asyncio.to_thread(service.post, batch_of([0.0, 0.0, 0.0]))).status_code == 200
            assert (await read(client))["sequence"].Value.Value == 1
            node = client.get_node(ua.NodeId("press-7/sequence", await client.get_namespace_index("urn:beamtouch")))
            asleep = await client.create_subscription(50, woken)
            item = ua.MonitoredItemCreateRequest(
                ua.ReadValueId(node.nodeid, ua.AttributeIds.Value), ua.MonitoringMode.Disabled
            )
            assert await asleep.create_monitored_items([item])
            assert (await asyncio.to_thread(service.post, batch_of([0.0] * 3, sequence=2))).status_code == 200
            await (await client.create_subscription(50, new)).subscribe_data_change(node)
            await asleep.set_monitoring_mode(ua.MonitoringMode.Reporting)
            await asyncio.to_thread(wait_until, lambda: bool(new.found and woken.found))
        return [one.found["press-7/sequence"][0].Value.Value for one in (new, woken)]

    assert asyncio.run(subscribe()) == [2, 2]


def is_bad(changes: Changes, code: str) -> bool:
    """Return whether the newest value of every variable has this status code."""
    newest = [values[-1].StatusCode.name for values in changes.found.values()]
    return bool(newest) and set(newest) == {code}


@pytest.mark.promise(
    "docs/how-to/opcua.md",
    "When a daemon stops, every variable of its surfaces is `BadNoCommunication` after `stale_ms` and one interval.",
)
def test_a_subscription_reports_changes_and_turns_bad_when_samples_stop(start_press: StartService) -> None:
    service, url = start(start_press, 5000, "interval_ms = 20")
    changes = Changes()

    async def subscribe() -> None:
        async with connected(url) as client:
            surface = client.get_node(ua.NodeId("press-7", await client.get_namespace_index("urn:beamtouch")))
            subscription = await client.create_subscription(50, changes)
            await subscription.subscribe_data_change(await surface.get_variables())
            for number in range(1, 6):
                await post(service, number, REST)
            await asyncio.to_thread(wait_until, lambda: "clear" in changes.values("state"))
            await post(service, 6, *[ODD] * 5)
            await asyncio.to_thread(wait_until, lambda: is_bad(changes, "BadNoCommunication"))

    asyncio.run(subscribe())
    states = changes.values("state")
    assert states[0] is states[-1] is None
    # It is reported when it changes, and so keeps the time at which it began.
    said = [(one.Value.Value, one.StatusCode.name) for one in changes.found["press-7/state"]]
    assert all(one != after for one, after in pairwise(said))
    assert changes.values("sequence")[-2] == 10


@pytest.mark.promise(
    "docs/how-to/opcua.md",
    (
        "Subscribers are told in turns of `interval_ms`: of a sample that comes after an idle turn at once, otherwise "
        "of the newest at the next turn."
    ),
    "All variables of a surface that change are told together.",
)
def test_subscribers_are_told_of_the_newest_sample_at_the_pace(start_press: StartService) -> None:
    interval_ms, names = 500, ("sequence", "misfit", "age_ms")
    service, url = start(start_press, 60_000, f"interval_ms = {interval_ms}")
    changes = Changes()

    async def subscribe() -> None:
        async with connected(url) as client:
            index = await client.get_namespace_index("urn:beamtouch")
            nodes = [client.get_node(ua.NodeId(f"press-7/{name}", index)) for name in names]
            # It is published more often than there is something to tell.
            subscription = await client.create_subscription(50, changes)
            await subscription.subscribe_data_change(nodes, queuesize=100)
            for number in range(1, 61):
                await post(service, number, [0.2, 0.3, 0.3 + 0.001 * number])
            await asyncio.to_thread(wait_until, lambda: changes.values("sequence")[-1:] == [60])

    asyncio.run(subscribe())
    told = [one for one in changes.found["press-7/sequence"] if one.Value.Value is not None]
    times = [one.ServerTimestamp for one in told]
    lasted_ms = (times[-1] - times[0]) / timedelta(milliseconds=1)
    # The first value is that of the moment of the subscription.
    assert len(told) <= 3 + lasted_ms / interval_ms
    numbers = changes.values("sequence")
    assert numbers[-len(told) :] == sorted({one.Value.Value for one in told})
    # What is told at one time is of one sample.
    ages = {one.ServerTimestamp: one for one in changes.found["press-7/age_ms"]}
    assert all(ages[one.ServerTimestamp].SourceTimestamp == one.SourceTimestamp for one in told[1:])


def test_a_value_that_changes_and_comes_back_before_others_are_told_reaches_the_client_that_saw_the_change(
    start_press: StartService,
) -> None:
    service, url = start(start_press, 60_000, "interval_ms = 3000")
    first, second = Changes(), Changes()

    async def subscribe() -> None:
        async with connected(url) as client:
            node = client.get_node(ua.NodeId("press-7/state", await client.get_namespace_index("urn:beamtouch")))
            await post(service, 1, *[REST] * 5)
            await (await client.create_subscription(50, first)).subscribe_data_change(node)
            await asyncio.to_thread(wait_until, lambda: first.values("state") == ["clear"])
            await post(service, 6, REST)  # subscribers have just been told
            await post(service, 7, *[TOUCHED] * 5)
            await (await client.create_subscription(50, second)).subscribe_data_change(node)
            await asyncio.to_thread(wait_until, lambda: second.values("state")[:1] == ["contact"])
            await post(service, 12, *[REST] * 5)
            await asyncio.to_thread(wait_until, lambda: second.values("state")[-1:] == ["clear"])

    asyncio.run(subscribe())
    assert first.values("state")[-1] == "clear"


async def event_type(client: Client, index: int) -> Node:
    """Return the type of events."""
    base = client.get_node(ua.ObjectIds.BaseEventType)
    return await base.get_child(ua.QualifiedName("ContactEventType", index))


@pytest.mark.promise(
    "docs/how-to/opcua.md",
    (
        "When an event is finished, its surface emits an OPC UA event of the type `ContactEventType`, and so does "
        "the object `Server` for clients that listen to all surfaces."
    ),
)
def test_a_finished_event_is_emitted_by_its_surface_and_by_the_server(start_press: StartService) -> None:
    service, url = start(start_press, 60_000)
    near, everywhere = Changes(), Changes()

    async def listen() -> None:
        async with connected(url) as client:
            index = await client.get_namespace_index("urn:beamtouch")
            kind = await event_type(client, index)
            surface = client.get_node(ua.NodeId("press-7", index))
            await (await client.create_subscription(50, near)).subscribe_events(surface, kind)
            await (await client.create_subscription(50, everywhere)).subscribe_events(evtypes=kind)
            await post(service, 1, *[REST] * 10, *[*[TOUCHED] * 10, *[REST] * 10] * 2)
            await asyncio.to_thread(wait_until, lambda: len(near.events) == len(everywhere.events) == 2)

    asyncio.run(listen())
    second, first = (one for one in service.get("/events").json()["events"] if one["kind"] == "contact")
    assert [one.EventId for one in everywhere.events] == [one.EventId for one in near.events]
    for found, event in zip(near.events, (first, second), strict=True):
        assert event["dwell_ms"] > 100
        lifted = datetime.fromisoformat(event["lifted_at"])
        assert abs(found.Time.replace(tzinfo=UTC) - lifted) < timedelta(milliseconds=1)
        for name in ("surface", "kind", "touched_at", "lifted_at", "dwell_ms", "peak_force_n", "mean_position_mm"):
            assert (getattr(found, name), found.end) == (event[name], event["end"]), name
        assert json.loads(found.zones) == event["zones"] != {}


@pytest.mark.promise("docs/how-to/opcua.md", "An event that could not be sent is sent again")
def test_events_that_cannot_be_sent_come_later_once_each_and_end_no_session(
    start_press: StartService, tmp_path: Path
) -> None:
    fault, contact = tmp_path / "fault", [*[TOUCHED] * 10, *[REST] * 10]
    service, url = start(start_press, 60_000, code=broken(events.__name__, "EventSender", "_send", fault))
    told = Changes()

    async def listen() -> None:
        async with connected(url) as client:
            kind = await event_type(client, await client.get_namespace_index("urn:beamtouch"))
            await (await client.create_subscription(50, told)).subscribe_events(evtypes=kind)
            await post(service, 1, *[REST] * 10, *contact)
            await asyncio.to_thread(wait_until, lambda: len(told.events) == 1)
            fault.touch()
            await post(service, 31, *contact * 2)
            await asyncio.to_thread(
                wait_until, lambda: "opcua events" in service.get("/health/ready").json().get("missing", {})
            )
            fault.unlink()
            await asyncio.to_thread(wait_until, lambda: len(told.events) >= 3)
            await post(service, 71, *contact)
            await asyncio.to_thread(wait_until, lambda: len(told.events) >= 4)
            assert await read(client)

    asyncio.run(listen())
    recorded = [one["id"] for one in service.get("/events").json()["events"] if one["kind"] == "contact"]
    assert [one.id for one in told.events] == recorded[::-1]
