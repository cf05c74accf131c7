"""What a stop, or a disk that fails, leaves of samples that are on their way."""

import asyncio
import threading
from pathlib import Path

import pytest

from beamtouch_daemon.delivery.outbox import Outbox
from beamtouch_daemon.delivery.spool import Spool

from .publishing import Bench, put, sequences, taken, until
from .service import Service, serving

pytestmark = pytest.mark.anyio


async def test_what_is_delivered_at_a_stop_does_not_stay_in_the_spool_while_the_disk_is_busy(tmp_path: Path) -> None:
    is_free = threading.Event()
    with Spool(tmp_path / "spool", 10**6) as spool:
        put(spool, 0, 5)
        service = Service()
        async with serving(service), Bench(service, spool=spool) as bench:
            disk = bench.disk
            assert disk is not None
            busy = list[asyncio.Task[bool]]()

            def occupy(*_: object) -> None:
                busy.append(asyncio.create_task(disk.call(is_free.wait)))

            service.problem_of = occupy
            await until(lambda: bench.publisher.published == 5)
            # The end of the block waits for the disk, and nothing else runs in this thread meanwhile.
            threading.Timer(0.2, is_free.set).start()
        assert len(busy) == 1
        assert sequences(service) == [0, 1, 2, 3, 4]
        assert spool.waiting["bench"] == 0


async def test_a_refused_batch_that_a_stop_keeps_from_the_disk_is_counted_as_dropped(tmp_path: Path) -> None:
    is_free = threading.Event()
    with Spool(tmp_path / "spool", 10**6) as spool:
        service = Service()
        service.problem_of = lambda *_: (422, "invalid-request")
        async with serving(service), Bench(service, spool=spool) as bench:
            assert bench.disk is not None
            busy = asyncio.ensure_future(bench.disk.call(is_free.wait))
            for number in range(2):  # while the second is sent, the first waits for the disk
                bench.outbox.put(taken(5 * number, 5))
                await until(lambda: service.attempts > number)  # noqa: B023 - called in this turn
            threading.Timer(0.2, is_free.set).start()
        assert await busy
        bench.publisher.give_up()
        assert bench.outbox.dropped == 10
        assert spool.set_aside["bench"] == 0


async def test_samples_that_are_put_back_wake_who_waits_for_some() -> None:
    outbox = Outbox(10, "bench")
    waiting = asyncio.create_task(outbox.filled())
    await asyncio.sleep(0)
    outbox.put_back(taken(0, 1))
    assert await asyncio.wait_for(waiting, 60)
