"""The log of one boot: which samples it holds in memory and in chunks, what it gives, and what it drops."""

import pytest

from beamtouch_daemon.delivery.log import Counts, Log
from beamtouch_daemon.delivery.log_file import Chunk
from beamtouch_daemon.processing.pipeline import TimedSample
from beamtouch_daemon.sources.reading import Reading
from beamtouch_service.samples import Note

from .publishing import boot, taken

ROOM = 10


class Held:
    """A log, and the counts of its surface."""

    def __init__(self, number: int = 0, max_samples: int = ROOM) -> None:
        self.counts = Counts("bench")
        self.log = Log(boot(), self.counts, max_samples)
        self.log.put(taken(1, number))

    def with_chunks(self) -> "Held":
        """Let samples 1 to 4 and 5 to 6 be in rows 7 and 8 of the file."""
        self.log.adopt(Chunk(7, 1, 4))
        self.log.adopt(Chunk(8, 5, 6))
        return self

    @property
    def places(self) -> tuple[int, int, int, int]:
        """The oldest sample, how many are on disk and in memory, and the next number."""
        return self.log.oldest, self.log.on_disk, self.log.in_memory, self.log.next


def numbers(samples: list[TimedSample]) -> list[int]:
    return [one.sample.sequence for one in samples]


def test_without_room_the_oldest_in_memory_are_dropped() -> None:
    held = Held(ROOM)
    assert (held.places, held.counts.dropped) == ((1, 0, ROOM, ROOM + 1), 0)
    held.log.put(taken(ROOM + 1, 2))
    assert (held.places, held.counts.dropped) == ((3, 0, ROOM, ROOM + 3), 2)


def test_samples_are_forgotten_up_to_a_number_on_disk_and_in_memory() -> None:
    held = Held(8).with_chunks()
    found = [(held.log.forget(last), held.places, held.log.rows) for last in (0, 2, 4, 7, 7)]
    assert found == [
        (0, (1, 6, 2, 9), {7, 8}),
        (2, (3, 4, 2, 9), {7, 8}),
        (2, (5, 2, 2, 9), {8}),
        (3, (8, 0, 1, 9), set()),
        (0, (8, 0, 1, 9), set()),
    ]
    assert not held.log.is_empty
    assert (held.log.forget(8), held.places) == (1, (9, 0, 0, 9))
    assert held.log.is_empty


def test_a_sample_is_in_the_chunk_that_begins_and_ends_about_it() -> None:
    log = Held(8).with_chunks().log
    rows = [chunk and chunk.row for chunk in map(log.chunk_of, range(1, 8))]
    assert rows == [7, 7, 7, 7, 8, 8, None]
    assert not Held(8).with_chunks().log.is_empty


def test_samples_in_rows_that_the_file_lost_are_dropped() -> None:
    held = Held(8).with_chunks()
    held.log.keep({8})
    assert (held.places, held.counts.dropped) == ((5, 2, 2, 9), 4)


def test_what_is_given_up_is_that_in_memory() -> None:
    held = Held(8).with_chunks()
    assert (held.log.give_up(), held.places, held.counts.dropped) == (2, (1, 6, 0, 9), 2)
    assert held.log.give_up() == 0


@pytest.mark.parametrize(
    ("durable", "chunk", "places"),
    [
        (0, Chunk(7, 1, 4), (1, 4, 4, 9)),
        (2, Chunk(7, 1, 4), (3, 2, 4, 9)),
        (4, Chunk(7, 1, 4), (5, 0, 4, 9)),
    ],
    ids=["none of it", "a part", "all of it"],
)
def test_what_became_durable_while_it_was_written_is_held_no_longer(
    durable: int, chunk: Chunk, places: tuple[int, int, int, int]
) -> None:
    held = Held(8)
    held.log.forget(durable)
    held.log.adopt(chunk)
    assert held.places == places


def test_what_was_dropped_while_it_was_written_is_held_no_longer() -> None:
    held = Held(ROOM)
    held.log.put(taken(ROOM + 1, 2))
    held.log.adopt(Chunk(7, 1, 4))
    assert held.places == (3, 2, ROOM - 2, ROOM + 3)


def test_chunks_that_hold_a_sample_twice_give_it_once() -> None:
    held = Held()
    for chunk in (Chunk(7, 1, 4), Chunk(8, 3, 6), Chunk(9, 5, 5)):
        held.log.adopt(chunk)
    assert (held.places, held.log.rows) == ((1, 6, 0, 7), {7, 8})


def test_samples_from_memory_are_those_up_to_the_next_note() -> None:
    log = Held(2).log
    log.put([*taken(3, 2, notes=(Note.RATE,)), *taken(5, 2)])
    log.forget(1)
    found = [numbers(log.from_memory(range(*ends))) for ends in ((2, 7), (3, 7), (4, 5), (6, 7), (6, 6), (1, 7))]
    assert found == [[2], [3, 4], [4], [6], [], []]


def old(number: int, *ages_s: float) -> list[TimedSample]:
    """Return samples from `number` on that are so old at 100 s."""
    each = zip(taken(number, len(ages_s)), ages_s, strict=True)
    return [TimedSample(Reading(100.0 - age_s, (None, None)), one.sample, one.notes) for one, age_s in each]


def test_all_in_memory_should_be_on_disk_once_the_oldest_is_old() -> None:
    log = Held().log
    log.put(old(1, 5.0, 4.0, 0.0))
    assert log.for_disk(5.5, 100.0, before=4, most=10) == []
    assert [numbers(piece) for piece in log.for_disk(5.0, 100.0, before=4, most=2)] == [[1, 2], [3]]
    assert Held().log.for_disk(0.0, 100.0, before=1, most=10) == []


def test_all_in_memory_should_be_on_disk_once_it_is_half_full() -> None:
    log = Held().log
    log.put(old(1, *[0.0] * 4))
    assert log.for_disk(5.0, 100.0, before=9, most=10) == []
    for number in (5, 6):
        log.put(old(number, 0.0))
        (piece,) = log.for_disk(5.0, 100.0, before=9, most=10)
        assert numbers(piece) == list(range(1, number + 1))


def test_what_a_live_batch_brings_is_left_in_memory() -> None:
    log = Held().log
    log.put(old(1, *[9.0] * 4))
    log.forget(1)
    found = [[numbers(piece) for piece in log.for_disk(5.0, 100.0, before, most=10)] for before in (1, 2, 4, 9)]
    assert found == [[], [], [[2, 3]], [[2, 3, 4]]]


def test_a_batch_of_the_log_is_a_backlog_with_the_note_of_its_samples() -> None:
    log = Held().log
    samples = taken(1, 2, notes=(Note.RATE,))
    batch = log.batch(samples)
    assert (batch.boot_id, batch.samples, batch.notes) == ("boot-0001", [one.sample for one in samples], ["rate"])
    assert batch.backlog
    assert (log.batch([]).samples, log.batch([]).notes) == ([], [])


def test_a_sample_that_became_durable_while_it_was_written_is_the_last_that_is_not_held() -> None:
    held = Held(8)
    held.log.forget(3)
    held.log.adopt(Chunk(7, 3, 4))
    assert held.places == (4, 1, 4, 9)


def test_a_chunk_of_one_sample_is_held_and_one_that_is_durable_is_not() -> None:
    held = Held(0)
    held.log.adopt(Chunk(7, 1, 1))
    held.log.adopt(Chunk(8, 1, 1))
    assert (held.places, held.log.rows) == ((1, 1, 0, 2), {7})
