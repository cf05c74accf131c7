"""The store of events in PostgreSQL: two services write pieces of the same samples, and either may be first."""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np
import psycopg
import pytest

from beamtouch_models.modelfile import Memory, State
from beamtouch_service.events.file import EventsAwayError, EventStoreError
from beamtouch_service.events.findings import Command, Edge, Finish
from beamtouch_service.events.segments import End, EventKind, Segment
from beamtouch_service.events.selection import Selection
from beamtouch_service.events.store import EventStore
from beamtouch_service.surfaces.follower import Past
from postgres import PASSWORD, Postgres, rows

if TYPE_CHECKING:
    from collections.abc import Iterator

DAY_S = 86_400.0
PAST = Past((Memory(State.CONTACT, changing=2, seen_mm=(0.1, 1 / 3)), Memory(State.CLEAR, armed=True)), 45)
CERTAIN = Past((Memory(State.CLEAR, armed=True),), 45)
BOOT = "boot-0001"


def segment(first: int, last: int, *, end: End = End.OPEN, points: int = 1) -> Segment:
    return Segment(
        "press-7",
        "tiny@000000",
        BOOT,
        first,
        last,
        first * 5000,
        last * 5000,
        end=end,
        samples=last - first + 1,
        position_sum_mm=100.0 * (last - first + 1),
        path=[(first * 5000 + i, 100.0, 5.0) for i in range(points)],
    )


def clear(sequence: int, acquired_us: int, past: Past = CERTAIN) -> Edge:
    return Edge(BOOT, "tiny@000000", sequence, acquired_us, State.CLEAR, past)


def opened(url: str, max_bytes: int = 1_000_000) -> EventStore:
    return EventStore(url, 30 * DAY_S, max_bytes)


@pytest.fixture
def stores(events_url: str) -> Iterator[tuple[EventStore, EventStore]]:
    """The stores of two services that started at the same time."""
    with ThreadPoolExecutor(2) as threads:
        one, other = threads.map(opened, [events_url] * 2)
    yield one, other
    one.close()
    other.close()


def spans(store: EventStore) -> list[tuple[int, int, str, str]]:
    found = [kept for _, kept in store.read(Selection())]
    return [(kept.first_sequence, kept.last_sequence, kept.begin.value, kept.end.value) for kept in reversed(found)]


def test_pieces_of_two_services_join_whoever_writes_first(stores: tuple[EventStore, EventStore]) -> None:
    shuffled = np.random.default_rng(14).permutation(range(0, 400, 10)).tolist()
    pieces = [segment(first, first + 9, end=End.UNSEEN) for first in shuffled]

    def write(store: EventStore, some: list[Segment]) -> None:
        for one in some:
            store.write("press-7", [one], 0.0)

    with ThreadPoolExecutor(2) as threads:
        for done in [threads.submit(write, store, pieces[i::2]) for i, store in enumerate(stores)]:
            done.result()

    ((_, event),) = stores[0].read(Selection())
    assert (event.first_sequence, event.last_sequence, event.samples) == (0, 399, 400)
    assert event.position_sum_mm == 40_000
    assert stores[1].read(Selection()) == stores[0].read(Selection())


@pytest.mark.parametrize("order", [(0, 1), (1, 0)])
@pytest.mark.parametrize(
    ("kind", "begin", "end"), [(EventKind.CONTACT, "touch", "lift"), (EventKind.UNEXPLAINED, "clear", "clear")]
)
def test_a_clear_sample_that_another_service_saw_completes_an_event(
    stores: tuple[EventStore, EventStore], order: tuple[int, int], kind: EventKind, begin: str, end: str
) -> None:
    piece = replace(segment(10, 19), kind=kind, ends_unexplained=kind is EventKind.UNEXPLAINED)
    beside = [clear(9, 45_000), clear(20, 100_000)]
    writes: list[tuple[EventStore, list[Command]]] = [
        (stores[0], [piece, Finish(BOOT, 19, End.STALE)]),
        (stores[1], [*beside]),
    ]
    for number in order:
        store, commands = writes[number]
        store.write("press-7", commands, 0.0)

    assert spans(stores[0]) == [(10, 19, begin, end)]
    ((_, event),) = stores[0].read(Selection())
    assert event.lifted_us == 100_000


@pytest.mark.parametrize("order", [(0, 1), (1, 0)])
@pytest.mark.parametrize(
    ("kind", "begin", "end"), [(EventKind.CONTACT, "touch", "lift"), (EventKind.UNEXPLAINED, "unseen", "stale")]
)
def test_a_clear_sample_that_a_stretch_could_still_take_ends_only_contacts(
    stores: tuple[EventStore, EventStore], order: tuple[int, int], kind: EventKind, begin: str, end: str
) -> None:
    piece = replace(segment(10, 19), kind=kind, ends_unexplained=kind is EventKind.UNEXPLAINED)
    beside = [clear(9, 45_000, PAST), clear(20, 100_000, PAST)]
    writes: list[list[Command]] = [[piece, Finish(BOOT, 19, End.STALE)], [*beside]]
    for number in order:
        stores[number].write("press-7", writes[number], 0.0)

    assert spans(stores[0]) == [(10, 19, begin, end)]


def test_what_a_sample_beside_a_gap_leaves_is_known_to_the_other_service(stores: tuple[EventStore, EventStore]) -> None:
    one, other = stores
    known = [clear(30, 0, PAST), Edge(BOOT, "tiny@000000", 40, 7, None, Past(PAST.memories[:1]))]
    unknown = Edge(BOOT, "tiny@000000", 50, 7, None, PAST)
    one.write("press-7", [segment(0, 9, end=End.UNSEEN), *known, unknown], 0.0)

    assert other.state_after("press-7", BOOT, 9) is State.CONTACT
    assert [other.edge("press-7", BOOT, number) for number in (30, 40, 50, 60)] == [*known, None, None]


def test_a_service_that_starts_or_stops_leaves_the_open_events_of_others(
    stores: tuple[EventStore, EventStore], events_url: str
) -> None:
    stores[0].write("press-7", [segment(0, 9)], 100.0)
    third = opened(events_url)
    assert spans(third) == [(0, 9, "unseen", "open")]
    third.close()
    assert spans(stores[1]) == [(0, 9, "unseen", "open")]
    stores[1].finish_abandoned(90.0)
    assert spans(stores[1]) == [(0, 9, "unseen", "open")]
    stores[1].finish_abandoned(110.0)
    assert spans(stores[1]) == [(0, 9, "unseen", "unfinished")]


def test_above_the_size_limit_the_oldest_events_are_dropped(
    stores: tuple[EventStore, EventStore], events_url: str
) -> None:
    store = stores[0]
    values = np.random.default_rng(14).uniform(0, 20, (200, 2)).tolist()
    path = [(i * 5000, position, force) for i, (position, force) in enumerate(values)]
    for number in range(400):
        store.write("press-7", [replace(segment(number * 10, number * 10 + 1), path=path)], float(number))
    used = store.used_bytes()
    limited = opened(events_url, max_bytes=used // 2)
    dropped = limited.prune(400.0)

    assert 180 <= dropped <= 240
    assert limited.used_bytes() <= used // 2
    # What is deleted leaves room in the files of the database, which is not counted again.
    assert limited.prune(400.0) == 0
    assert limited.read(Selection(limit=1))[0][1].first_sequence == 3990
    limited.close()


def test_a_database_of_something_else_is_refused_without_its_password(events_url: str) -> None:
    with psycopg.connect(events_url) as connection:
        connection.execute("CREATE TABLE events (something text)")
    with pytest.raises(EventStoreError, match="already exists") as caught:
        opened(events_url)
    assert PASSWORD not in str(caught.value)
    assert rows(events_url, "SELECT count(*) FROM pg_tables WHERE schemaname = 'public'") == [(1,)]


def test_a_database_of_a_newer_service_is_refused(events_url: str) -> None:
    opened(events_url).close()
    with psycopg.connect(events_url) as connection:
        connection.execute("UPDATE beamtouch_format SET format = 99")
    with pytest.raises(EventStoreError, match="format 99"):
        opened(events_url)


def test_a_database_that_is_away_can_be_opened_and_is_used_once_it_is_back(postgres: Postgres, events_url: str) -> None:
    postgres.stop()
    try:
        store = opened(events_url)
        with pytest.raises(EventsAwayError, match="refused") as caught:
            store.write("press-7", [segment(0, 9)], 0.0)
        assert PASSWORD not in str(caught.value)
    finally:
        postgres.start()
    store.write("press-7", [segment(0, 9)], 0.0)
    assert spans(store) == [(0, 9, "unseen", "open")]
    store.close()
