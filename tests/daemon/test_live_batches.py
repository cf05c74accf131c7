"""When a live batch goes out and which samples it holds, by what is known of the line and of the record."""

import asyncio
from collections.abc import AsyncIterator, Callable
from contextlib import asynccontextmanager
from math import inf
from time import monotonic

import pytest

from beamtouch_common.uptime import uptime_s
from beamtouch_daemon.delivery.boots import BacklogState, Boot, SurfaceLogs
from beamtouch_daemon.delivery.client import ServiceClient
from beamtouch_daemon.delivery.live import Live
from beamtouch_daemon.delivery.log_file import Chunk
from beamtouch_daemon.delivery.sending import send
from beamtouch_daemon.tasks import cancel
from beamtouch_service.samples import Batch

from .publishing import Bench, boot, taken
from .service import TOKEN, Service, serving

pytestmark = pytest.mark.anyio

PATIENT_S = 60.0
NOWHERE = "http://127.0.0.1:1"
MOST = 25
"""Samples of a request while nothing is known of the line."""
LIVE = 13
"""Half of that."""


class Sender:
    """A boot with samples, and what sends them live."""

    def __init__(self, client: ServiceClient, number: int = 0) -> None:
        self.logs = SurfaceLogs("bench")
        self.boot: Boot = self.logs.begin(boot(), 1000)
        self.boot.put(taken(1, number))
        self.live = Live(client, self.logs, self.boot)

    @property
    def wait_s(self) -> float:
        """From the begin of the last batch to the next one; -inf: it may go out now."""
        return round(self.live._next_s() - self.boot.live.begun_s, 6)

    @property
    def numbers(self) -> list[int]:
        """The samples of the next batch."""
        return [one.sample.sequence for one in self.live._samples()]

    async def send(self, wait_s: float | None = None) -> None:
        """Send two new samples, which are not taken if the next batch must wait for so long [s] then."""
        samples, begin_s = taken(self.boot.log.next, 2), monotonic()
        self.boot.put(samples)
        self.boot.live.begin(samples[0].sample.sequence, samples[-1].sample.sequence)
        await self.live._send(samples)
        assert self.boot.live.in_flight == 0
        if wait_s is not None:
            assert self.live._next_s() - monotonic() <= wait_s <= self.live._next_s() - begin_s


@asynccontextmanager
async def sender(number: int = 0, url: str = NOWHERE) -> AsyncIterator[Sender]:
    async with ServiceClient(url, TOKEN) as client:
        yield Sender(client, number)


async def test_two_live_batches_may_be_without_an_answer_on_a_long_way() -> None:
    async with sender(2) as one:
        assert one.live._next_s() == -inf
        one.boot.live.begin(1, 1)
        assert one.live._next_s() == inf  # the way is not long
        one.boot.pace.answered(1, 0.2, 0.0, is_backlog=False)
        assert one.wait_s == 0.15
        one.boot.live.begin(2, 2)
        assert one.live._next_s() == inf


async def test_however_many_samples_come_no_more_than_two_live_batches_are_without_an_answer() -> None:
    async with serving(Service()) as service, sender(url=service.url) as one:
        service.wait_s, in_flight = lambda *_: 0.2, set[int]()
        running = asyncio.ensure_future(one.live.run())
        for number in range(1, 21):
            one.boot.put(taken(number, 1))
            one.boot.wake_live()
            await asyncio.sleep(0.005)
            in_flight.add(one.boot.live.in_flight)
        await cancel([running])
        assert 0 < max(in_flight) <= 2


async def test_on_a_thin_line_a_live_batch_rests_while_the_record_lacks_samples() -> None:
    async with sender(2) as one:
        one.boot.live.begin(2, 2)
        one.boot.live.end(2)
        assert one.live._next_s() == -inf
        one.boot.pace.is_thin = True
        assert one.wait_s == 0.0  # what the last one took, three times
        one.boot.backlog_state = BacklogState.SENDS
        assert one.wait_s == 0.3
        one.boot.backlog_state = BacklogState.WAITS
        assert one.live._next_s() == -inf
        one.boot.backlog_state, one.boot.expected = BacklogState.SENDS, 3
        assert not one.boot.is_behind
        assert one.live._next_s() == -inf


async def test_a_live_batch_holds_the_newest_samples_that_none_has_taken() -> None:
    async with sender(40) as one:
        assert one.numbers == list(range(41 - LIVE, 41))
        one.boot.live.begin(35, 35)
        assert one.numbers == list(range(36, 41))
        one.boot.live.begin(36, 40)
        assert one.numbers == []
        one.boot.put(taken(41, 1))
        assert one.numbers == [41]


async def test_a_live_batch_holds_what_is_in_memory() -> None:
    async with sender(40) as one:
        one.boot.log.adopt(Chunk(1, 1, 35))
        assert one.numbers == list(range(36, 41))


@pytest.mark.parametrize(("number", "first"), [(MOST, 1), (MOST + 1, MOST + 2 - LIVE)])
async def test_a_live_batch_begins_with_the_gap_of_the_record_if_a_request_holds_it(number: int, first: int) -> None:
    async with sender(number) as one:
        one.boot.live.begin(1, number - 1)
        one.boot.live.end(1)
        one.boot.expected = 1
        assert one.numbers == (list(range(1, number + 1)) if first == 1 else [number])
        one.boot.backlog_state = BacklogState.SENDS
        assert one.numbers == [number]
        one.boot.backlog_state = BacklogState.RESTS
        one.boot.live.begin(number, number)
        assert one.numbers == []  # none is new


async def test_the_backlog_is_told_when_a_live_batch_goes_out_and_when_it_is_over() -> None:
    async with serving(Service()) as service, sender(url=service.url) as one:
        service.wait_s = lambda *_: 0.05
        sending = asyncio.ensure_future(one.send())
        for in_flight in (1, 0):
            await one.boot.wait_for_change(PATIENT_S)
            assert (one.boot.changed.is_set(), one.boot.live.in_flight) == (True, in_flight)
        await sending


async def test_after_a_failure_the_next_live_batch_waits_a_second_at_most() -> None:
    async with serving(Service()) as service, sender(url=service.url) as one:
        one.boot.due_s = 60.0
        await one.send()
        assert one.boot.due_s == 60.0
        service.statuses = [503] * 6
        for wait_s in (0.1, 0.2, 0.4, 0.8, 1.0, 1.0):
            await one.send(wait_s)
        assert one.boot.live_failed
        one.boot.due_s = monotonic() + 60.0
        await one.send()
        assert one.boot.due_s == 0.0  # the service answers again: the backlog goes on at once
        one.boot.due_s = 60.0
        await one.send()
        assert one.boot.due_s == 60.0
        service.statuses = [503]
        await one.send(0.1)


async def test_the_time_of_a_batch_that_was_taken_is_that_from_its_sending_to_its_answer() -> None:
    async with serving(Service()) as service, sender(url=service.url) as one:
        service.wait_s = lambda *_: 0.04
        begin_s = monotonic()
        await one.send()
        took_s = monotonic() - begin_s
        one.boot.put(taken(3, 1))
        one.boot.expected, one.boot.pace.is_thin = None, True
        one.boot.pace.stale_s = 60.0
        assert 3 * 0.04 <= one.wait_s <= 3 * took_s


async def test_a_live_batch_states_the_age_of_its_newest_sample_and_when_that_was_true() -> None:
    async with sender() as one:
        samples = [*taken(1, 1, age_s=9.0), *taken(2, 1, age_s=0.5)]
        before_us = uptime_s() * 1e6
        batch = one.live._batch(samples)
        assert batch.sent_us is not None
        assert batch.newest_age_ms is not None
        assert before_us - 1 <= batch.sent_us <= uptime_s() * 1e6
        # Both by one look at the clock.
        assert batch.newest_age_ms == pytest.approx(batch.sent_us / 1e3 - samples[1].monotonic_s * 1e3, abs=1e-2)
        assert (batch.backlog, len(batch.samples)) == (False, 2)
        assert one.live._batch(taken(1, 1, age_s=-9.0)).newest_age_ms == 0.0


def refusing(status: int, kind: str) -> Callable[[Batch, int], tuple[int, str]]:
    return lambda *_: (status, kind)


async def test_what_is_refused_is_said_once_for_each_reason_until_it_is_taken_again(
    caplog: pytest.LogCaptureFixture,
) -> None:
    caplog.set_level("INFO")
    async with serving(Service()) as service, ServiceClient(service.url, TOKEN) as client:
        one, refusals = Sender(client), [(422, "missing-channels"), (422, "missing-channels"), (401, "unauthorized")]
        batch = one.boot.log.batch(taken(1, 1))
        for refusal in refusals:
            service.problem_of = refusing(*refusal)
            await send(client, one.logs, one.boot, batch)
        service.problem_of = lambda *_: None
        for _ in range(2):
            await send(client, one.logs, one.boot, batch)
    wait = "bench: the samples of boot boot-0001 wait, the service does not take them"
    assert caplog.messages == [
        f"{wait} (status 422: No.)",
        f"{wait} (status 401: wrong token; correct publish.token_file and restart)",
        "bench: the service takes the samples of boot boot-0001 again",
    ]


async def test_a_line_that_is_thin_is_said_while_the_record_lacks_more_than_a_request(
    caplog: pytest.LogCaptureFixture,
) -> None:
    caplog.set_level("INFO")
    async with serving(Service()) as service, sender(url=service.url) as one:
        one.boot.put(taken(1, MOST + 1))
        asking = one.boot.log.backlog_batch([], [])
        for missing, is_thin in ((MOST + 1, False), (MOST, True), (MOST + 1, True)):
            one.boot.live.restart()
            one.boot.live.begin(missing + 1, MOST + 1)  # what it brings is not missing
            one.boot.pace.is_thin, one.boot.pace.most = is_thin, MOST
            await send(one.live._client, one.logs, one.boot, asking)
            assert len(caplog.messages) == (missing > MOST and is_thin)
        assert f"requests hold at most {MOST} samples, the newest go first, and {MOST + 1} wait" in caplog.text
        one.boot.live.begin(1, MOST + 1)
        await send(one.live._client, one.logs, one.boot, asking)
        assert "the record has caught up on a thin line after" in caplog.text


async def test_a_request_that_was_answered_tells_what_the_line_carries() -> None:
    async with serving(Service()) as service, sender(MOST, url=service.url) as one:
        await send(one.live._client, one.logs, one.boot, one.boot.log.batch(taken(1, MOST)))
        assert (one.boot.pace.most, one.boot.pace.is_thin) == (2 * MOST, False)


async def test_a_request_without_an_answer_in_time_gets_more_time_next(caplog: pytest.LogCaptureFixture) -> None:
    async with serving(Service()) as service, sender(url=service.url) as one:
        service.wait_s, one.boot.pace.timeout_s = lambda *_: 0.3, 0.1
        batch = one.boot.log.batch(taken(1, 1))
        assert await send(one.live._client, one.logs, one.boot, batch) is None
        assert one.boot.pace.timeout_s == 4.0
        line = f"bench: publishing: no answer from {service.url} (timeout); trying again"
        assert caplog.messages == [line]


async def test_a_service_that_takes_nothing_now_and_not_soon_has_a_thin_line(caplog: pytest.LogCaptureFixture) -> None:
    caplog.set_level("INFO")
    async with serving(Service()) as service, sender(url=service.url) as one:
        service.wait_s, service.problem_of = lambda *_: 0.3, refusing(503, "busy")
        live = one.boot.log.batch(taken(1, MOST)).model_copy(update={"backlog": False, "newest_age_ms": 0.0})
        answer = await send(one.live._client, one.logs, one.boot, live)
        assert answer is not None
        assert (one.boot.pace.most, one.boot.pace.is_thin, one.boot.refusal) == (MOST // 2, True, "")
        words = "bench: publishing: the service takes no samples (status 503: No.); trying again"
        assert caplog.messages == [words]
        # A backlog does not show that live batches are taken again.
        service.wait_s, service.problem_of = lambda *_: 0.0, lambda *_: None
        await send(
            one.live._client, one.logs, one.boot, live.model_copy(update={"backlog": True, "newest_age_ms": None})
        )
        assert caplog.messages == [words]
        await send(one.live._client, one.logs, one.boot, live)
        assert caplog.messages[1].startswith("bench: publishing: works again after")


async def test_a_live_batch_that_is_refused_is_said_with_the_reason(caplog: pytest.LogCaptureFixture) -> None:
    async with serving(Service()) as service, sender(url=service.url) as one:
        service.problem_of = refusing(422, "missing-channels")
        live = one.boot.log.batch(taken(1, 1)).model_copy(update={"backlog": False, "newest_age_ms": 0.0})
        await send(one.live._client, one.logs, one.boot, live)
        assert one.boot.refusal == "status 422: No."
        words = "bench: publishing: the service takes no samples (status 422: No.); trying again"
        assert caplog.messages == [words]


async def test_a_service_that_is_not_reached_is_said_with_what_to_change(caplog: pytest.LogCaptureFixture) -> None:
    async with serving(Service()) as service:
        plain = service.url.replace("http:", "https:")
        for url in (NOWHERE, plain):
            async with sender(url=url) as one:
                await send(one.live._client, one.logs, one.boot, one.boot.log.batch(taken(1, 1)))
        said = [line.removeprefix("bench: publishing: no answer from ") for line in caplog.messages]
    assert said == [
        f"{NOWHERE} (Connection refused); trying again",
        f"{plain} (TLS failed); if the service has no certificate, publish.url must begin with http://; trying again",
    ]


async def test_live_batches_that_were_in_flight_when_their_part_failed_are_over() -> None:
    async with serving(Service()) as service:
        bench = Bench(service)
        bench.count(3)
        for number in (1, 2):
            bench.boot.live.begin(number, number)
        async with bench:
            await service.until(1)
            assert service.batches[0][1].samples[-1].sequence == 3


async def test_the_debug_log_has_each_batch_and_what_became_of_it(caplog: pytest.LogCaptureFixture) -> None:
    caplog.set_level("DEBUG", "beamtouch_daemon.delivery.sending")
    async with serving(Service()) as service, sender(url=service.url) as one:
        service.statuses = [200, 503]
        live = one.boot.log.batch(taken(3, 3)).model_copy(update={"backlog": False, "newest_age_ms": 0.0})
        await send(one.live._client, one.logs, one.boot, live)
        await send(one.live._client, one.logs, one.boot, one.boot.log.backlog_batch([], []))
    async with sender() as away:
        await send(away.live._client, away.logs, away.boot, away.boot.log.batch(taken(7, 1)))
    said = [record.getMessage() for record in caplog.records if record.levelname == "DEBUG"]
    brought, asked, gone = (line.removeprefix("bench: ") for line in said)
    assert brought.startswith("live batch of boot boot-0001, samples 3 to 5: taken: accepted=")
    assert asked == "backlog batch of boot boot-0001, no samples: later: status 503"
    assert gone == "backlog batch of boot boot-0001, samples 7 to 7: no answer: Connection refused"
