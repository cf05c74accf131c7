"""When the backlog of a boot sends next: by what the last request brought, and by when a live batch may bring it."""

import asyncio
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from time import monotonic

import pytest

from beamtouch_daemon.delivery import backlog
from beamtouch_daemon.delivery.backlog import Backlog
from beamtouch_daemon.delivery.boots import BacklogState, Boot
from beamtouch_daemon.delivery.client import ServiceClient
from beamtouch_daemon.delivery.log_store import LogStore

from .publishing import boot, taken
from .record import Record
from .service import TOKEN, Service, serving

pytestmark = pytest.mark.anyio

NOWHERE = "http://127.0.0.1:1"
MOST = 25
"""Samples of a request while nothing is known of the line."""


@asynccontextmanager
async def delivering(expected: int | None, url: str = NOWHERE) -> AsyncIterator[tuple[Backlog, Boot]]:
    """A boot whose live batches brought samples, of which the record lacks those from `expected` on; its backlog."""
    async with ServiceClient(url, TOKEN) as client:
        store = LogStore(None, 0)
        logs = store.surface("bench")
        one = logs.begin(boot(), 1000)
        one.put(taken(1, 2 * MOST))
        one.live.begin(1, 2 * MOST)
        one.live.end(1)
        one.expected = expected
        yield Backlog(client, store, logs, asyncio.Lock()), one


@pytest.mark.parametrize(
    ("expected", "most_pending", "status", "is_taken", "is_at_once"),
    [
        (1, 1000, 200, True, True),
        (1, 0, 200, True, False),  # the record takes none of them
        (1, 1000, 503, False, False),
        (None, 1000, 200, True, True),  # it was asked how far it is
        (None, 1000, 503, False, False),
    ],
    ids=["further", "no further", "not taken", "asked", "asked in vain"],
)
async def test_after_a_request_that_brought_the_record_further_the_next_one_follows_at_once(
    expected: int | None, most_pending: int, status: int, is_taken: bool, is_at_once: bool
) -> None:
    service = Service(record=Record())
    service.recorder.MAX_PENDING = most_pending
    service.statuses = [200, status]
    async with serving(service), delivering(None, service.url) as (deliverer, one):
        await deliverer._deliver(one)  # the record knows the boot now
        one.expected = expected
        one.backoff.next()
        assert await deliverer._deliver(one) is is_taken
        assert (one.due_s <= monotonic()) is is_at_once
        # Otherwise after twice the wait before, and then twice that.
        assert one.backoff.next() == (0.1 if is_at_once else 0.4)


async def test_what_a_live_batch_can_bring_waits_for_one_for_a_second() -> None:
    async with delivering(MOST + 1) as (_, one):
        assert one.is_gap_small
        assert backlog._due_s(one) == one.live.begun_s + 1.0
        one.due_s = one.live.begun_s + 7.0  # the last request was not taken
        assert backlog._due_s(one) == one.due_s
        one.expected = MOST
        assert not one.is_gap_small
        for due_s in (0.0, one.live.begun_s + 7.0):
            one.due_s = due_s
            assert backlog._due_s(one) == due_s


async def test_a_record_that_lacks_nothing_is_asked_a_second_after_its_last_receipt() -> None:
    async with delivering(2 * MOST + 1) as (_, one):
        for one.expected in (2 * MOST + 1, None):
            one.due_s, one.last_receipt_s = 3.0, 1000.0
            assert backlog._due_s(one) == 1001.0
            one.due_s = 1007.0
            assert backlog._due_s(one) == 1007.0


async def test_a_question_that_is_refused_makes_no_request_smaller() -> None:
    service = Service(record=Record())
    service.problem_of = lambda *_: (422, "invalid-request")
    async with serving(service), delivering(None, service.url) as (deliverer, one):
        assert not await deliverer._deliver(one)
        assert (one.pace.most, one.refusal, one.log.oldest) == (MOST, "status 422: No.", 1)
        one.expected = 1
        assert not await deliverer._deliver(one)  # half as many may be taken
        assert (one.pace.most, one.due_s <= monotonic()) == (MOST // 2, True)


@pytest.mark.parametrize(
    ("is_thin", "has_new", "was_sent"), [(False, True, False), (True, False, False), (True, True, True)]
)
async def test_the_backlog_waits_for_no_live_batch_if_none_is_due(is_thin: bool, has_new: bool, was_sent: bool) -> None:
    async with delivering(1) as (deliverer, one):
        one.pace.is_thin, one.pace.stale_s = is_thin, 600.0
        deliverer._over_s = 100.0
        one.live.sent_s = 100.0 if was_sent else 99.0
        if has_new:
            one.put(taken(2 * MOST + 1, 1))
        await asyncio.wait_for(deliverer._let_live_pass(one), 60)
        assert one.backlog_state is BacklogState.RESTS


def state_of(one: Boot) -> BacklogState:
    return one.backlog_state


async def test_on_a_thin_line_the_backlog_waits_until_a_live_batch_has_gone_or_for_an_eighth_of_a_second() -> None:
    async with delivering(1) as (deliverer, one):
        one.pace.is_thin, deliverer._over_s = True, 100.0
        one.put(taken(2 * MOST + 1, 1))
        begun_s = monotonic()
        await deliverer._let_live_pass(one)
        assert monotonic() - begun_s >= 0.125
        assert state_of(one) is BacklogState.RESTS
        deliverer._logs.present = None
        await asyncio.wait_for(deliverer._let_live_pass(one), 60)  # of a surface that is not configured
        deliverer._logs.present = one
        one.pace.stale_s, deliverer._over_s = 600.0, 100.0
        waiting = asyncio.ensure_future(deliverer._let_live_pass(one))
        await one.wait_for_change(60.0)
        assert state_of(one) is BacklogState.WAITS
        one.live.sent_s = 100.0
        one.changed.set()
        await asyncio.wait_for(waiting, 60)
        assert state_of(one) is BacklogState.RESTS
