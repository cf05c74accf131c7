"""Session after session with a device that fails: how often it is looked at, what is said, and when it hangs."""

import asyncio
from collections.abc import AsyncGenerator, Callable, Coroutine
from time import monotonic

import pytest

from beamtouch_daemon.running import acquisition
from beamtouch_daemon.sources.reading import Reading, SourceError
from beamtouch_daemon.tasks import cancel

from .acquiring import Bench, Nothing, reading
from .surfaces import surface_of
from .waits import until

pytestmark = pytest.mark.anyio

BOARD = {"source": {"kind": "serial", "port": "/dev/x"}}


class Device(Nothing):
    """A source that does in each session what `session` does, which is given its number, from 1."""

    def __init__(self, session: Callable[[int], AsyncGenerator[list[Reading], None]]) -> None:
        super().__init__()
        self.sessions = 0
        self._session = session

    def readings(self) -> AsyncGenerator[list[Reading], None]:
        self.sessions += 1
        return self._session(self.sessions)


def bench_of(
    session: Callable[[int], AsyncGenerator[list[Reading], None]], batch_s: float = 0.004, **changes: object
) -> tuple[Bench, Device]:
    bench, device = Bench(surface_of(**changes), batch_s=batch_s), Device(session)
    bench.line.source = device
    return bench, device


@pytest.mark.parametrize(("batch_s", "pause_s"), [(0.002, 0.002), (1.0, 0.005)])
async def test_a_device_that_sends_by_itself_is_looked_at_once_a_batch_or_every_5_ms(
    batch_s: float, pause_s: float
) -> None:
    async def session(_number: int) -> AsyncGenerator[list[Reading], None]:
        while True:
            await asyncio.sleep(0)
            yield [reading(50.0)]

    bench, _ = bench_of(session, batch_s, **BOARD)
    begun_s = monotonic()
    reading_it = asyncio.ensure_future(bench.line.read())
    await asyncio.sleep(0.03)
    await cancel([reading_it])
    assert 1 <= bench.line.readings <= 1 + (monotonic() - begun_s) / pause_s


async def test_what_arrives_in_the_time_of_a_batch_waits_for_its_end() -> None:
    async def session(_number: int) -> AsyncGenerator[list[Reading], None]:
        for number in range(30):
            yield [reading(50.0 + number / 200)]
            await asyncio.sleep(0.001)
        await asyncio.Event().wait()

    bench, _ = bench_of(session, batch_s=60.0)
    tasks = [asyncio.ensure_future(work()) for work in (bench.line.read, bench.line.run)]
    await until(lambda: bench.line.readings == 30)
    await cancel(tasks)
    assert bench.boot.log.next == 2  # only the first one became a sample
    assert bench.boot.fresh.is_set()


async def test_a_device_that_fails_at_once_is_tried_ten_times_a_second_at_most() -> None:
    async def session(_number: int) -> AsyncGenerator[list[Reading], None]:
        await asyncio.sleep(0)
        raise SourceError("it is gone")
        yield []

    bench, device = bench_of(session)
    begun_s = monotonic()
    reading_it = asyncio.ensure_future(bench.line.read())
    await asyncio.sleep(0.02)
    await cancel([reading_it])
    assert 1 <= device.sessions <= 2 + (monotonic() - begun_s) / 0.1


async def test_a_session_that_fails_is_said_and_followed_by_others_until_one_goes_on(
    caplog: pytest.LogCaptureFixture, monkeypatch: pytest.MonkeyPatch
) -> None:
    caplog.set_level("INFO")
    seen = list[tuple[bool, bool, bool]]()

    async def session(number: int) -> AsyncGenerator[list[Reading], None]:
        seen.append((bench.line.is_missing, bench.line._arrived.is_set(), bench.line.last_progress_s > begun_s))
        bench.line.last_progress_s = -1000.0
        if number in (1, 4):
            yield [reading(50.0 + number)]
            bench.line._arrived.clear()
        if number < 4:
            raise SourceError("it is gone", "bytes came" if number == 1 else "")
        await asyncio.Event().wait()

    monkeypatch.setattr(acquisition, "NEXT_SESSION_S", 0.01)
    bench, device = bench_of(session)
    begun_s, bench.line.last_progress_s = monotonic(), -1000.0
    reading_it = asyncio.ensure_future(bench.line.read())
    await until(lambda: bench.line.readings == 2)
    await cancel([reading_it])
    assert (device.sessions, bench.line.is_missing) == (4, True)
    # At the begin of each it is missing, the end of the one before was progress, and what waited at rest goes on.
    assert seen == [(True, False, True), (True, True, True), (True, True, True), (True, True, True)]
    assert bench.line.lost == 599  # in the three seconds from 51 to 54
    first, *_, again = [line for line in caplog.messages if "reading" not in line]
    assert first.startswith("bench: it is gone")
    assert first.endswith("; trying again")
    assert again.startswith("bench: works again after ")


async def test_each_session_measures_the_rate_anew() -> None:
    async def session(number: int) -> AsyncGenerator[list[Reading], None]:
        yield [reading(50.0 + 2 * number + index / 200) for index in range(21)]
        if number < 3:
            raise SourceError("it is gone")
        await asyncio.Event().wait()

    bench, _ = bench_of(session)
    reading_it = asyncio.ensure_future(bench.line.read())
    await until(lambda: bench.line.readings == 63)
    await cancel([reading_it])
    assert bench.line.meter.measured_hz is None  # 0.1 s of each, and nothing in the two seconds in between


@pytest.mark.parametrize(
    ("changes", "patience_s"),
    [
        ({"rate_hz": 200.0}, 15.0 + 0.1 + 40 * 0.2),
        ({"rate_hz": 0.5}, 15.0 + 40.0 + 40 * 0.2),
        ({"rate_hz": 8.0, "source": {"kind": "modbus-rtu", "port": "/dev/x", "timeout_ms": 3000}}, 15.0 + 2.5 + 120.0),
        (BOARD | {"rate_hz": 10.0}, 15.0 + 2.0),
    ],
)
async def test_a_device_that_brings_neither_a_reading_nor_an_error_hangs(
    changes: dict[str, object], patience_s: float
) -> None:
    line = Bench(surface_of(**changes)).line
    line.last_progress_s = 1000.0
    assert [line.hangs(1000.0 + patience_s + beyond_s) for beyond_s in (-0.001, 0.001)] == [False, True]


async def pauses_of(
    work: Callable[[], Coroutine[None, None, None]], number: int, monkeypatch: pytest.MonkeyPatch
) -> list[float]:
    """Return the first pauses that are made."""
    pauses = list[float]()

    async def sleep(pause_s: float) -> None:
        pauses.append(pause_s)
        if len(pauses) == number:
            raise asyncio.CancelledError

    monkeypatch.setattr(asyncio, "sleep", sleep)
    with pytest.raises(asyncio.CancelledError):
        await work()
    return pauses


async def giving(_number: int) -> AsyncGenerator[list[Reading], None]:
    while True:
        yield [reading(50.0)]


async def test_after_a_failure_the_next_session_waits_half_a_second_at_most(monkeypatch: pytest.MonkeyPatch) -> None:
    async def session(_number: int) -> AsyncGenerator[list[Reading], None]:
        raise SourceError("it is gone")
        yield []

    bench, _ = bench_of(session)
    assert await pauses_of(bench.line.read, 5, monkeypatch) == [0.1, 0.2, 0.4, 0.5, 0.5]


@pytest.mark.parametrize(
    ("batch_s", "look_s", "make_s"), [(0.002, 0.002, 0.0), (0.02, 0.005, 0.015)], ids=["each batch", "each 5 ms"]
)
async def test_a_device_that_sends_by_itself_is_looked_at_in_the_time_in_which_a_batch_collects(
    monkeypatch: pytest.MonkeyPatch, batch_s: float, look_s: float, make_s: float
) -> None:
    bench, _ = bench_of(giving, batch_s, **BOARD)
    assert await pauses_of(bench.line.read, 3, monkeypatch) == [look_s] * 3
    assert await pauses_of(bench.line.run, 1, monkeypatch) == [pytest.approx(make_s)]
    polled, _ = bench_of(giving, batch_s)
    polled.take(reading(50.0))
    assert await pauses_of(polled.line.run, 1, monkeypatch) == [batch_s]
