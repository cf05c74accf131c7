"""The numbers of one sender as runs, how many senders are remembered, and when two of them send at once."""

from beamtouch_service.samples import Batch
from beamtouch_service.surfaces.order import MAX_RUNS, MAX_SENDERS, DuplicateSenders, Order, Runs, Senders

STALE_MS = 500.0


def batch_of(*numbers: int, boot_id: str = "boot-0001", backlog: bool = False, age_ms: float = 0.0) -> Batch:
    """Return a batch of samples with these numbers, the newest of this age."""
    each = [
        {"sequence": number, "acquired_unix_us": number, "deflection_mm": [0.5], "quality": ["good"]}
        for number in numbers
    ]
    content = {"boot_id": boot_id, "channels": ["s1"], "samples": each, "backlog": backlog}
    return Batch.model_validate(content | {"newest_age_ms": None if backlog else age_ms})


def test_a_number_is_new_once_whatever_the_order() -> None:
    runs = Runs()
    assert [runs.add(number) for number in (5, 5, 6, 4, 9, 7, 8, 8, 4)] == [True, False, *[True] * 5, False, False]
    assert runs.missing == 0
    runs = Runs()
    for number in (1, 5, 9, 6, 2, 10):
        assert runs.add(number)
    assert [runs.add(number) for number in range(1, 12)] == [False] * 2 + [True] * 2 + [False] * 2 + [True] * 2 + [
        *(False, False, True)
    ]


def test_numbers_between_the_first_and_the_last_are_missing() -> None:
    runs = Runs()
    found = []
    for number in (5, 9, 6, 7, 12, 8):
        runs.add(number)
        found.append(runs.missing)
    assert found == [0, 3, 2, 1, 3, 2]


def test_numbers_that_come_backwards_are_one_run_and_use_up_no_gap() -> None:
    runs = Runs()
    assert all(runs.add(number) for number in (1, *range(MAX_RUNS + 4, 2, -1)))
    assert runs.missing == 1
    assert runs.add(2)


def test_of_too_many_gaps_the_oldest_is_lost_for_good() -> None:
    runs = Runs()
    assert MAX_RUNS == 1000
    for number in range(MAX_RUNS):
        runs.add(7 * number)
    assert runs.missing == 6 * (MAX_RUNS - 1)
    assert runs.add(1)  # it is known which are missing
    runs.add(7 * MAX_RUNS)
    assert runs.missing == 6 * MAX_RUNS - 1
    assert not runs.add(2)
    assert runs.add(8)
    assert runs.missing == 6 * MAX_RUNS - 2


def test_what_a_sender_lost_counts_after_it_is_forgotten_too() -> None:
    order = Order(STALE_MS)
    for number in range(MAX_SENDERS + 1):
        batch = batch_of(1, 5, boot_id=f"boot-{number:04}")
        order.take(batch, 1000.0)
        order.take(batch, 1000.0)
    counts = order.counts
    assert (counts.accepted, counts.repeated, counts.lost) == (34, 34, 51)  # of 17 senders
    # The first one is forgotten: its numbers are new.
    assert order.take(batch_of(1, boot_id="boot-0001"), 1000.0).accepted == 0
    assert order.take(batch_of(1, boot_id="boot-0000"), 1000.0).accepted == 1


def test_a_batch_without_samples_and_a_backlog_move_no_answer() -> None:
    order = Order(STALE_MS)
    backlog, live, empty = batch_of(1, 2, backlog=True), batch_of(2, 3), batch_of()
    assert [order.moves_answer(batch, 1000.0) for batch in (backlog, live, empty)] == [False, True, False]
    taken = order.take(empty, 1000.0)
    assert (taken.accepted, taken.repeated, taken.fresh, taken.acquired_s) == (0, 0, [], 1000.0)
    taken = order.take(backlog, 1000.0)
    assert (taken.accepted, taken.repeated, taken.fresh) == (2, 0, [])
    taken = order.take(live, 1000.0)
    assert (taken.accepted, taken.repeated, taken.fresh) == (1, 1, [live.samples[1]])
    assert not order.moves_answer(live, 1000.0)


def test_the_last_sample_of_a_batch_says_whether_it_moves_the_answer_and_its_age_when_it_was_taken() -> None:
    order = Order(STALE_MS)
    assert order.take(batch_of(1, 2, 3, age_ms=250.0), 1000.0).acquired_s == 999.75
    assert [order.moves_answer(batch_of(*numbers), 1000.0) for numbers in ((1, 2, 3), (2, 3, 4))] == [False, True]
    assert order.take(batch_of(4, backlog=True), 1000.0).acquired_s == 1000.0


def test_a_sender_that_was_heard_of_late_is_remembered() -> None:
    order = Order(STALE_MS)
    for number in (*range(MAX_SENDERS), 0, MAX_SENDERS):
        order.take(batch_of(1, boot_id=f"boot-{number:04}"), 1000.0)
    repeated = [order.take(batch_of(1, boot_id=f"boot-{number:04}"), 1000.0).repeated for number in (0, 2, 1)]
    assert repeated == [1, 1, 0]


def test_a_replaced_sender_returns_once_the_newest_sample_is_stale_with_a_later_one() -> None:
    senders = Senders(STALE_MS)
    senders.move("first", 7, 100.0)
    senders.move("second", 1, 101.0)
    assert senders.changes == 1
    assert not senders.is_after_newest("first", 8, 101.25, 101.5)
    assert senders.is_after_newest("first", 8, 101.25, 101.5 + 1e-4)
    assert not senders.is_after_newest("first", 7, 102.0, 102.0)
    assert [senders.is_after_newest("third", 1, at_s, 101.25) for at_s in (100.9, 101.0)] == [False, True]
    assert [senders.is_after_newest("second", number, 0.0, 0.0) for number in (1, 2)] == [False, True]


def test_the_last_sixteen_replaced_senders_are_remembered() -> None:
    senders = Senders(STALE_MS)
    for number in range(MAX_SENDERS + 2):
        senders.move(f"boot-{number}", 1, 100.0)
    # Forgotten, it may begin anew; the one after it is known as replaced.
    assert senders.is_after_newest("boot-0", 1, 100.0, 100.0)
    assert not senders.is_after_newest("boot-1", 1, 100.0, 100.0)


def test_a_sender_that_came_back_is_remembered_from_when_it_was_replaced_last() -> None:
    senders = Senders(STALE_MS)
    for boot_id in ("first", "second", "first", "third", *(f"boot-{number}" for number in range(15))):
        senders.move(boot_id, 1, 100.0)
    # Of seventeen that were replaced, the second was so longest ago.
    found = {one: senders.is_after_newest(one, 2, 100.0, 100.0) for one in ("first", "second", "third")}
    assert found == {"first": False, "second": True, "third": False}


class Heard:
    """Batches of several daemons, each at an address of its own."""

    def __init__(self, stale_ms: float = STALE_MS) -> None:
        self.duplicates = DuplicateSenders(stale_ms)
        self.now_s = 1000.0

    def turns(self, *names: str, step_s: float = 0.1) -> tuple[str, str] | None:
        """Note a batch of each of these; return the addresses of two that both send."""
        for name in names:
            self.now_s += step_s
            self.duplicates.note(name, f"at {name}", self.now_s)
        return self.duplicates.at(self.now_s)


def test_two_daemons_are_rivals_after_four_returns() -> None:
    heard = Heard()
    assert heard.turns("one", "one", "two", "two", "one", "two", "one") is None
    assert heard.turns("two") == ("at one", "at two")
    assert heard.turns("two") == ("at one", "at two")
    assert heard.turns("one") == ("at two", "at one")


def test_rivals_are_so_for_ten_seconds_after_the_last_return_or_four_times_the_limit_of_age() -> None:
    for stale_ms, quiet_s in ((STALE_MS, 10.0), (3000.0, 12.0)):
        heard = Heard(stale_ms)
        assert heard.turns("one", "two", "one", "two", "one", "two") is not None
        assert heard.duplicates.at(heard.now_s + quiet_s - 0.01) is not None
        assert heard.duplicates.at(heard.now_s + quiet_s) is None


def test_returns_that_are_far_apart_are_no_rivalry() -> None:
    heard = Heard()
    heard.turns("one", "two")
    assert [heard.turns(name, step_s=10.5) for name in ("one", "two") * 4] == [None] * 8
    assert heard.turns("one", "two") is None
    assert heard.turns("one") == ("at two", "at one")


def test_samples_from_before_the_begin_of_another_daemon_are_no_return() -> None:
    heard = Heard()
    heard.turns("one", "two")
    for _ in range(8):
        heard.duplicates.note("one", "at one", heard.now_s - 0.01)
        heard.duplicates.note("two", "at two", heard.now_s)
    assert heard.duplicates.at(heard.now_s) is None
