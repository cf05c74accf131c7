"""Readings wait for the next batch, and become samples all at once."""

import asyncio
from collections.abc import Sequence
from pathlib import Path

import pytest

from beamtouch_daemon.config.file import load_config
from beamtouch_daemon.delivery.outbox import Outbox, Promise
from beamtouch_daemon.processing.pipeline import Pipeline, Taken
from beamtouch_daemon.running.acquisition import MAX_UNPROCESSED, Acquisition
from beamtouch_daemon.sources.configured import Buses
from beamtouch_daemon.sources.reading import Reading
from beamtouch_service.samples import Note

from . import configs
from .devices import SerialDevice
from .lines import terminal
from .publishing import taken, until

pytestmark = pytest.mark.anyio


def numbers(samples: Sequence[Taken]) -> list[int]:
    return [one.sample.sequence for one in samples]


async def test_promised_samples_come_after_those_that_wait_and_are_made_once() -> None:
    outbox, made = Outbox(10, "bench"), list[int]()

    def make() -> list[Taken]:
        made.append(1)
        return taken(2, 2)

    outbox.put(taken(0, 2))
    outbox.promise(Promise(make, 3))
    assert len(outbox) == 5
    assert made == []
    assert numbers(outbox.take(3)) == [0, 1, 2]
    assert numbers(outbox.take(3)) == [3]
    assert made == [1]


async def test_a_promise_wakes_who_waits_and_counts_against_the_limit() -> None:
    outbox = Outbox(2, "bench")
    waiting = asyncio.create_task(outbox.filled())
    await asyncio.sleep(0)
    outbox.promise(Promise(lambda: taken(0, 3), 3))
    assert await asyncio.wait_for(waiting, 60)
    outbox.close()
    assert numbers(outbox.take(9)) == [1, 2]
    assert outbox.dropped == 1


async def test_samples_that_cannot_be_made_keep_no_one_from_stopping() -> None:
    def fails() -> list[Taken]:
        raise ZeroDivisionError

    outbox = Outbox(10, "bench")
    outbox.promise(Promise(fails, 3))
    outbox.close()
    assert await outbox.filled()
    with pytest.raises(ZeroDivisionError):  # in the task that sends, which starts again
        outbox.take(9)
    assert not await outbox.filled()


async def test_readings_of_a_serial_line_are_processed_together(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    sizes = list[int]()
    process = Pipeline.process

    def counted(
        pipeline: Pipeline, readings: Sequence[Reading], offset_s: float, notes: tuple[Note, ...]
    ) -> list[Taken]:
        sizes.append(len(readings))
        return process(pipeline, readings, offset_s, notes)

    monkeypatch.setattr(Pipeline, "process", counted)
    with terminal() as line:
        SerialDevice(line)
        path = configs.write(tmp_path, configs.surface(source=configs.serial(line.path), rate_hz=1000.0))
        outbox = Outbox(10_000, "bench")
        acquisition = Acquisition("bench", load_config(path).surfaces["bench"], {}, outbox, Buses())
        reading = asyncio.create_task(acquisition.run())
        await until(lambda: acquisition.readings >= 3 * MAX_UNPROCESSED)
        samples = outbox.take(10_000)
        reading.cancel()
        await asyncio.wait({reading})
    assert numbers(samples) == list(range(sum(sizes)))
    assert len(samples) >= 3 * MAX_UNPROCESSED
    assert min(sizes[:-1]) >= MAX_UNPROCESSED
