"""Boots of a surface that are still in the log: what each has yet to deliver, which are named, and what is said."""

import asyncio
from math import inf
from time import monotonic

import pytest

from beamtouch_daemon.delivery.boots import SurfaceLogs
from beamtouch_daemon.delivery.client import ServiceClient
from beamtouch_daemon.delivery.log_file import Chunk
from beamtouch_daemon.delivery.sending import send
from beamtouch_service.samples import MAX_EARLIER, Receipt
from support.network.free_ports import free_port

from .publishing import boot, taken
from .service import TOKEN, Service, serving

pytestmark = pytest.mark.anyio


async def test_of_too_many_boots_the_newest_are_named() -> None:
    logs, last = SurfaceLogs("bench"), MAX_EARLIER + 2
    boots = [logs.begin(boot(f"boot-{number:04}"), 10) for number in range(last + 1)]
    for one in boots[:-1]:
        one.log.put(taken(1, 1))
    assert logs.others(boots[0]) == [f"boot-{number:04}" for number in range(3, last + 1)]


async def test_a_surface_that_is_only_in_the_log_file_says_that_it_works_again(
    caplog: pytest.LogCaptureFixture,
) -> None:
    caplog.set_level("INFO")
    logs = SurfaceLogs("bench")
    former = logs.begin(boot(), 10)
    former.log.put(taken(1, 3))
    logs.present = None
    batch = former.log.head.model_copy(update={"samples": [one.sample for one in taken(1, 3)], "backlog": True})
    async with serving(Service()) as service:
        for url in (f"http://127.0.0.1:{free_port()}", service.url):
            client = ServiceClient(url, TOKEN)
            await send(client, logs, former, batch)
            await client.__aexit__()
    failed, again = [words for words in caplog.messages if words.startswith("bench: publishing")]
    assert "no answer from" in failed
    assert again.startswith("bench: publishing: works again after")


ALL = 10


class Delivered:
    """A boot whose live batches brought all of its samples, of which the record has some."""

    def __init__(self, number: int = ALL, expected: int | None = 1) -> None:
        self.logs = SurfaceLogs("bench")
        self.boot = self.logs.begin(boot(), 1000)
        self.boot.put(taken(1, number))
        self.boot.live.begin(1, number)
        self.boot.live.end(1)
        self.boot.expected = expected

    def tell(self, durable: int | None, expected: int | None) -> None:
        """Take a receipt."""
        self.boot.acknowledge(Receipt(accepted=0, repeated=0, durable=durable, expected=expected, stale_ms=300.0))


async def test_the_backlog_brings_what_the_record_lacks_and_no_live_batch_brings() -> None:
    one = Delivered(expected=3).boot
    assert one.missing == range(3, ALL + 1)
    one.live.begin(7, ALL)
    assert one.missing == range(3, 7)
    one.live.end(7)
    one.log.forget(5)
    assert one.missing == range(6, ALL + 1)
    one.refuse(8)
    assert one.missing == range(6, 8)
    one.expected = None
    assert not one.missing


async def test_the_record_is_behind_while_it_lacks_samples_or_cannot_be_read() -> None:
    found = [Delivered(expected=expected).boot.is_behind for expected in (None, ALL, ALL + 1)]
    assert found == [True, True, False]


async def test_a_live_batch_begins_with_a_gap_that_one_request_holds() -> None:
    most = Delivered().boot.pace.most
    assert [Delivered(most + more).boot.is_gap_small for more in (0, 1)] == [True, False]
    assert [Delivered(expected=expected).boot.is_gap_small for expected in (ALL, ALL + 1)] == [True, False]


async def test_a_gap_that_is_on_disk_or_has_a_refused_sample_or_was_not_taken_is_left_to_the_backlog() -> None:
    on_disk, refused, failed = (Delivered().boot for _ in range(3))
    on_disk.log.adopt(Chunk(1, 1, 1))
    refused.refuse(5)
    failed.live_failed = True
    assert [one.is_gap_small for one in (on_disk, refused, failed)] == [False] * 3
    on_disk.expected = 2
    assert on_disk.is_gap_small


async def test_a_receipt_says_what_is_durable_and_how_long_an_answer_is_fresh() -> None:
    one = Delivered()
    before_s = monotonic()
    one.boot.refusal, one.boot.live_failed = "No.", True
    one.tell(durable=4, expected=8)
    assert (one.logs.counts.published, one.boot.missing, one.boot.pace.stale_s) == (4, range(8, ALL + 1), 0.3)
    assert (one.boot.refusal, one.boot.live_failed) == ("", True)
    assert one.boot.last_receipt_s >= before_s
    one.tell(durable=None, expected=None)
    assert (one.logs.counts.published, one.boot.expected) == (4, None)
    one.tell(durable=8, expected=ALL + 1)
    assert (one.logs.counts.published, one.boot.live_failed) == (8, False)


async def test_a_refused_sample_is_dropped_once_all_before_it_are_durable() -> None:
    one = Delivered()
    one.boot.refuse(3)
    assert (one.boot.missing, one.logs.counts.dropped) == (range(1, 3), 0)
    one.tell(durable=1, expected=2)
    assert (one.boot.missing, one.logs.counts.dropped) == (range(2, 3), 0)
    one.tell(durable=2, expected=3)
    assert (one.boot.missing, one.logs.counts.dropped, one.boot.log.oldest) == (range(4, ALL + 1), 1, 4)
    one.boot.refuse(4)
    assert (one.boot.missing, one.logs.counts.dropped) == (range(5, ALL + 1), 2)


async def test_a_refused_sample_that_became_durable_is_not_dropped() -> None:
    one = Delivered()
    one.tell(durable=5, expected=6)
    one.boot.refuse(3)
    assert (one.boot.missing, one.logs.counts.dropped) == (range(6, ALL + 1), 0)


async def test_a_change_that_is_awaited_comes_after_that_or_not_in_time() -> None:
    one = Delivered().boot
    one.changed.set()  # before
    begin_s = monotonic()
    await one.wait_for_change(0.05)
    assert monotonic() - begin_s >= 0.05
    waits = asyncio.ensure_future(one.wait_for_change(inf))
    await asyncio.sleep(0)
    assert not waits.done()
    one.changed.set()
    await waits


async def test_a_boot_that_ends_leaves_all_to_the_backlog_which_asks_first() -> None:
    one = Delivered(expected=4).boot
    one.live.begin(7, ALL)
    one.end()
    assert not one.missing
    one.expected = 4
    assert (one.missing, one.live.in_flight) == (range(4, ALL + 1), 0)


async def test_a_service_that_answers_again_gets_the_backlog_at_once() -> None:
    one = Delivered().boot
    one.due_s = monotonic() + one.backoff.next() + one.backoff.next()
    one.hasten()
    assert (one.due_s, one.backoff.next()) == (0.0, 0.1)


async def test_the_backlog_waits_5_s_at_most() -> None:
    one = Delivered().boot
    assert [one.backoff.next() for _ in range(8)][-2:] == [5.0, 5.0]


async def test_the_logs_of_a_surface_count_what_its_boots_hold() -> None:
    logs = SurfaceLogs("bench")
    assert (logs.is_line_thin, logs.waiting) == (False, [])
    for number in (1, 2):
        logs.adopt(Chunk(number, 3 * number, 3 * number + 2), boot("boot-0000"))
    present = logs.begin(boot(), 1000)
    present.put(taken(1, 4))
    former = logs.by_boot["boot-0000"]
    assert (logs.in_memory, logs.on_disk, logs.waiting) == (4, 6, [former, present])
    assert (former.expected, former.log.oldest, former.log.next) == (None, 3, 9)
    former.expected = 4
    assert former.missing == range(4, 9)
    assert (logs.refused, logs.is_line_thin) == (0, False)
    former.refusal, present.pace.is_thin = "No.", True
    assert (logs.refused, logs.is_line_thin) == (1, True)
    assert (logs.give_up(), logs.counts.dropped) == (4, 4)
    logs.prune()
    assert logs.by_boot == {"boot-0000": former, "boot-0001": present}
    assert logs.others(former) == ["boot-0001"]  # the present one, which may get some
    former.log.forget(9)
    logs.prune()
    assert list(logs.by_boot) == ["boot-0001"]


async def test_the_present_boot_is_named_last() -> None:
    logs = SurfaceLogs("bench")
    present = logs.begin(boot(), 10)
    logs.adopt(Chunk(1, 1, 2), boot("boot-0000"))
    logs.adopt(Chunk(2, 1, 2), boot("boot-000b"))
    assert logs.others(logs.by_boot["boot-000b"]) == ["boot-0000", "boot-0001"]
    assert logs.others(present) == ["boot-0000", "boot-000b"]
