"""Which finished events a destination gets, in which order, and how two services find that they wrote the same row."""

from collections.abc import Iterator
from contextlib import closing
from dataclasses import replace
from typing import Any

import pytest

from beamtouch_service.record.events.boot_record import BootRecord
from beamtouch_service.record.events.changes import BootChange, Change
from beamtouch_service.record.events.health import HealthHistory, StoredHealth
from beamtouch_service.record.writing.transactions import Transactions
from beamtouch_service.sections import EventsSection, SurfaceSection
from beamtouch_service.surfaces.estimate import Estimator
from service.bench import Row, parsed
from service.event_story import RESTING, TOUCHING
from support.surfaces.small_model import model_of

CONTACT: list[Row] = [RESTING, TOUCHING, RESTING]


@pytest.fixture
def transactions() -> Iterator[Transactions]:
    with closing(Transactions(EventsSection())) as opened:
        yield opened


class Writing:
    """A service that writes one boot of one surface to the record."""

    def __init__(self, transactions: Transactions, boot_id: str = "boot-0001", surface: str = "press-7") -> None:
        self.transactions, self.surface, self.model = transactions, surface, model_of()
        self.boot = BootRecord(surface, SurfaceSection(), boot_id, self.model, 0)
        self.health = HealthHistory(surface, self.model, StoredHealth())

    def change(self, *rows: Row) -> Change:
        """Add samples; return what is to become durable."""
        first = self.boot.expected
        batch = parsed(*rows, sequence=first, begin_us=1_000_000 + 5000 * first)
        for estimate in Estimator(self.model, self.surface).estimate(batch, batch.samples):
            self.boot.add(estimate)
        return Change(self.surface, [self.boot.change()], [], self.health)

    def commit(self, *rows: Row) -> set[str]:
        """Make samples durable; return the surfaces that another service has written meanwhile."""
        change = self.change(*rows)
        numbers, lost = self.transactions.commit([change])
        if not lost:
            self.boot.note_durable(change.boots[0], numbers)
        return lost


def due(
    transactions: Transactions, destination: str, limit: int = 9, *, from_start: bool = False
) -> tuple[list[int], int]:
    """Return the ids of the events that are due, and how many there are."""
    found, count = transactions.due(destination, limit, from_start=from_start)
    return [one.number for one in found], count


def test_a_destination_gets_what_finishes_from_its_first_question_on_or_all(transactions: Transactions) -> None:
    writing = Writing(transactions)
    writing.commit(*CONTACT, TOUCHING)  # the second one is open
    assert due(transactions, "late") == ([], 0)
    assert due(transactions, "all", from_start=True) == ([1], 1)
    writing.commit(RESTING, TOUCHING)
    assert due(transactions, "late") == ([2], 1)
    assert due(transactions, "late", from_start=True) == ([2], 1)  # it is known
    assert due(transactions, "all", from_start=True) == ([1, 2], 2)
    assert due(transactions, "all", limit=1) == ([1], 2)
    assert due(transactions, "all", limit=0) == ([], 2)


def test_what_is_acknowledged_is_due_no_longer_for_this_destination(transactions: Transactions) -> None:
    writing = Writing(transactions)
    for destination in ("one", "other"):
        due(transactions, destination)
    writing.commit(*CONTACT, *CONTACT, *CONTACT)
    found, _ = transactions.due("one", 2, from_start=False)
    transactions.acknowledge(found)
    assert due(transactions, "one") == ([3], 1)
    assert due(transactions, "other") == ([1, 2, 3], 3)
    transactions.acknowledge([])
    assert due(transactions, "one") == ([3], 1)


@pytest.mark.parametrize(
    ("column", "damage"),
    [
        ("peak_force_n", "UPDATE events SET peak_force_n = 'abc' WHERE id < 3"),
        ("zones", "UPDATE events SET zones = '{' WHERE id < 3"),
        ("samples", "UPDATE events SET samples = -1 WHERE id < 3"),
    ],
)
def test_a_damaged_event_is_due_no_longer_and_the_log_names_it(
    transactions: Transactions, caplog: pytest.LogCaptureFixture, column: str, damage: str
) -> None:
    writing = Writing(transactions)
    for destination in ("one", "other"):
        due(transactions, destination)
    writing.commit(*CONTACT, *CONTACT, *CONTACT)
    with transactions.database.writing() as connection:
        connection.exec_driver_sql(damage)
    assert [due(transactions, "one", limit=1) for _ in range(3)] == [([], 2), ([], 1), ([3], 1)]
    words = "one never gets an event: event {} of surface press-7 cannot be read: table events, column {}: "
    named = [words.format(number, column) for number in (1, 2)]
    assert [message[: len(words)] for message, words in zip(caplog.messages, named, strict=True)] == named
    assert due(transactions, "one", limit=1) == ([3], 1)
    assert len(caplog.messages) == 2
    # Mended before it is due to another destination, an event is sent there.
    with transactions.database.writing() as connection:
        connection.exec_driver_sql("UPDATE events SET peak_force_n = 1.5, zones = '{}', samples = 1")
    assert due(transactions, "other") == ([1, 2, 3], 3)


def test_events_are_due_in_the_order_in_which_they_finish(transactions: Transactions) -> None:
    long, short = Writing(transactions), Writing(transactions, "boot-0002")
    due(transactions, "one")
    long.commit(RESTING, TOUCHING)
    short.commit(*CONTACT)
    long.commit(RESTING)
    assert due(transactions, "one") == ([2, 1], 2)
    (event, _), _ = transactions.due("one", 2, from_start=False)
    assert (event.event.boot_id, event.event.end, event.event.path) == ("boot-0002", "lift", [])


def test_an_event_that_goes_on_changes_no_other(transactions: Transactions) -> None:
    writing = Writing(transactions)
    for rows in ([*CONTACT, TOUCHING], [TOUCHING], [RESTING]):
        writing.commit(*rows)
    found, _ = transactions.due("one", 9, from_start=True)
    assert [(one.number, one.event.first_sequence, one.event.last_sequence) for one in found] == [(1, 2, 2), (2, 4, 5)]


def test_a_row_that_another_service_wrote_meanwhile_is_left_as_it_is(transactions: Transactions) -> None:
    first, second, other = Writing(transactions), Writing(transactions), Writing(transactions, surface="press-8")
    changes = [second.change(*CONTACT), other.change(*CONTACT)]
    assert first.commit(RESTING, TOUCHING) == set()
    numbers, lost = transactions.commit(changes)
    # The other surface is not held up.
    assert (lost, list(numbers.values())) == ({"press-7"}, [2])
    assert first.commit(TOUCHING, RESTING) == set()
    (cursor,), _ = transactions.load("press-7", "boot-0001")
    assert (cursor.durable, cursor.version, cursor.event) == (4, 2, None)
    # A version that is not there yet is no less wrong.
    change = first.change(RESTING)
    ahead = [replace(change, boots=[replace(change.boots[0], version=3)])]
    assert transactions.commit(ahead)[1] == {"press-7"}


def test_a_boot_is_loaded_with_those_that_have_an_open_event(transactions: Transactions) -> None:
    open_one = Writing(transactions, "boot-open")
    open_one.commit(RESTING, TOUCHING)
    for boot_id, surface in (("boot-0001", "press-7"), ("boot-0002", "press-7"), ("boot-0003", "press-8")):
        Writing(transactions, boot_id, surface).commit(*CONTACT)
    cursors, health = transactions.load("press-7", "boot-0001")
    found = {cursor.boot_id: (cursor.durable, cursor.event and cursor.event[0]) for cursor in cursors}
    assert found == {"boot-open": (2, 1), "boot-0001": (3, None)}
    assert health == StoredHealth()
    assert transactions.load("press-9", "boot-0001") == ([], StoredHealth())


def stored(version: int, **blocks: list[Any]) -> StoredHealth:
    """Return a health with blocks, each of a contact at the time in its name."""
    return StoredHealth(version, "press-7@1", "as-taken", 9, {(int(at[1:]), 0): block for at, block in blocks.items()})


def test_of_a_health_only_what_changes_is_written_and_a_race_is_seen(transactions: Transactions) -> None:
    writing = Writing(transactions)
    writing.commit(RESTING)

    def write(before: StoredHealth, after: StoredHealth | None) -> set[str]:
        writing.health.stored, writing.health.next = before, after
        _, lost = transactions.commit([Change("press-7", list[BootChange](), [], writing.health)])
        return lost

    first = stored(1, a0=[0], a1=[1], a2=[2], a9=[9])
    second = stored(2, a0=[0], a2=[5], a3=[3], a9=[9])
    assert write(StoredHealth(), None) == set()
    assert transactions.healths() == {}
    assert write(StoredHealth(), first) == set()
    assert transactions.healths() == {"press-7": first}
    assert write(StoredHealth(), first) == {"press-7"}
    assert write(first, second) == set()
    assert transactions.healths() == {"press-7": second}
    assert transactions.load("press-7", "boot-0001")[1] == second
    assert write(first, second) == {"press-7"}
    # A surface without a change holds up none of the others.
    other = HealthHistory("press-8", writing.model, StoredHealth())
    other.next = replace(first, model="press-8@1")
    assert write(second, None) == set()
    transactions.commit(
        [Change(name, [], [], health) for name, health in (("press-7", writing.health), ("press-8", other))]
    )
    assert transactions.healths() == {"press-7": second, "press-8": other.next}
    assert transactions.load("press-8", "boot-0001")[1] == other.next
