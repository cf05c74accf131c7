"""Faults of lines, devices, service, disk and clock, each on the daemon as a process.

What is delivered is held against what the device says it sent, value by value: a count is the number of its reading.
"""

import asyncio
import random
import signal
from collections.abc import AsyncIterator, Iterator
from contextlib import asynccontextmanager, contextmanager, suppress
from itertools import pairwise
from pathlib import Path
from time import monotonic

import pytest

from beamtouch_daemon.spool import Spool
from beamtouch_protocol.framing import encode
from beamtouch_service.samples import Batch, Quality, Sample

from . import configs
from .devices import SerialDevice, pymodbus_server
from .lines import Terminal
from .process import Daemon, started
from .service import Service, serving
from .test_run import free_port, summary_of

RATE_HZ = 200.0
BACK_S = 2.0
SLACK_S = 1.0
"""What a busy machine may add."""


class Cable:
    """A name under which a device can be plugged in, out, and in again, as /dev/serial/by-id has them."""

    def __init__(self, folder: Path) -> None:
        self.path = folder / "usb-beamtouch"
        self._line: Terminal | None = None

    def plug(self) -> Terminal:
        self.unplug()
        self._line = Terminal()
        self.path.symlink_to(self._line.path)
        return self._line

    def unplug(self) -> None:
        self.path.unlink(missing_ok=True)
        if self._line is not None:
            self._line.unplug()
            self._line = None


@contextmanager
def cable(folder: Path) -> Iterator[Cable]:
    one = Cable(folder)
    try:
        yield one
    finally:
        one.unplug()


def plain(source: str) -> str:
    """Return a surface whose samples are the counts themselves, negative: no filter, a gap is a count."""
    text = configs.surface(source=source, rate_hz=RATE_HZ)
    text = text.replace("-0.0001", "1.0").replace("= 4.5", "= 0.0").replace("= 2.5", "= 0.0")
    text = text.replace("[1.0, 4.0]", "[0.0, 65535.0]")
    head, _, tail = text.partition('kind = "moving-average"\nwindow = 4')
    return f'{head}kind = "none"{tail}'


def counts_of(samples: list[Sample]) -> list[tuple[float, float]]:
    """Return the counts of samples of which both channels are good."""
    return [
        (-first, -second)
        for first, second in (sample.deflection_mm for sample in samples)
        if first is not None and second is not None
    ]


async def everything(service: Service) -> None:
    """Wait until a service has every sample up to the newest that it has."""
    async with asyncio.timeout(30):
        while len(service.samples()) <= max(sample.sequence for sample in service.samples()):
            await service.until(len(service.samples()) + 1)


@asynccontextmanager
async def running(folder: Path, source: str, url: str, code: str = "") -> AsyncIterator[Daemon]:
    config = configs.write(folder, plain(source), url=url)
    async with started("run", config, "--summary", folder / "summary.json", code=code) as daemon:
        yield daemon


class Mangler:
    """Does to frames on their way what bad lines do; counts what it leaves whole."""

    def __init__(self, line: Terminal) -> None:
        self._line = line
        self._chance = random.Random(5)  # noqa: S311 - noise, not secrets
        self.whole = 0

    def write(self, frame: bytes) -> None:
        kind = self._chance.randrange(50)
        flipped = bytearray(frame)
        flipped[self._chance.randrange(len(frame))] ^= 1 << self._chance.randrange(8)
        match kind:
            case 0 | 1 | 2 | 3 | 4:
                self._line.write(bytes(flipped))  # one frame in ten
            case 5:
                self._line.write(frame[: len(frame) // 2])
            case 6:
                pass
            case 7:
                self._line.write(self._chance.randbytes(30) + frame)
            case 8:
                self._line.write(frame + frame)
                self.whole += 1
            case _:
                self._line.write(frame)
                self.whole += 1


def test_of_a_bad_serial_line_come_only_values_that_were_sent_each_once(tmp_path: Path) -> None:
    async def story() -> None:
        with cable(tmp_path) as usb:
            line = usb.plug()
            mangler = Mangler(line)
            device = SerialDevice(line)
            device.send = lambda message: mangler.write(encode(message))  # type: ignore[method-assign]
            async with (
                serving(Service()) as service,
                running(tmp_path, configs.serial(str(usb.path)), service.url) as daemon,
            ):
                await service.until(1000, within_s=40)
                assert (await daemon.stop()).code == 0
            found = counts_of(service.samples())
            assert all(second == first + 1000 for first, second in found)
            assert all(20_000 <= first < 20_000 + device.sequence for first, _ in found)
            assert len(set(found)) == len(found)
            assert found == sorted(found)
            counts = summary_of(tmp_path)["bench"]
            assert counts["samples_published"] == counts["readings"] == len(service.samples())
            assert len(found) >= 0.9 * mangler.whole - 20  # a damaged frame takes hardly another one with it

    asyncio.run(story())


@pytest.mark.parametrize("kind", ["unplugged", "reset"])
def test_a_serial_device_that_comes_back_is_read_within_two_seconds(tmp_path: Path, kind: str) -> None:
    async def story() -> None:
        with cable(tmp_path) as usb:
            device = SerialDevice(usb.plug())
            async with (
                serving(Service()) as service,
                running(tmp_path, configs.serial(str(usb.path)), service.url) as daemon,
            ):
                for boot_id in (2, 3):
                    await service.until(len(service.samples()) + 100)
                    if kind == "unplugged":
                        device.stop()
                        usb.unplug()
                        await asyncio.sleep(1.0)
                        device = SerialDevice(usb.plug(), boot_id=boot_id)
                    else:
                        device.reset(boot_id)
                    before, back_s = len(service.samples()), monotonic()
                    await service.until(before + 20)
                    assert monotonic() - back_s < BACK_S + SLACK_S
                assert (await daemon.stop()).code == 0
            assert all(second == first + 1000 for first, second in counts_of(service.samples()))
            counts = summary_of(tmp_path)["bench"]
            assert counts["samples_published"] == counts["readings"] == len(service.samples())

    asyncio.run(story())


def test_a_device_away_for_30_s_and_a_service_away_for_60_s_lose_nothing_that_was_taken(tmp_path: Path) -> None:
    taken = [20_000]

    async def action(_function: int, _start: int, _address: int, _count: int, now: list[int], _set: object) -> None:
        taken[0] += 1
        now[:2] = [taken[0], taken[0] + 1000]

    async def story() -> None:
        service_port, device_port = free_port(), free_port()
        url, source = f"http://127.0.0.1:{service_port}", configs.tcp(device_port)
        async with running(tmp_path, source, url) as daemon:
            begin_s = monotonic()
            async with pymodbus_server([0, 0], action, port=device_port):
                await asyncio.sleep(15)
            await asyncio.sleep(30)
            async with pymodbus_server([0, 0], action, port=device_port):
                came_back = taken[0]
                async with asyncio.timeout(BACK_S + SLACK_S):
                    while taken[0] < came_back + 20:  # noqa: ASYNC110 - the daemon is outside
                        await asyncio.sleep(0.02)
                await asyncio.sleep(begin_s + 60 - monotonic())
                late = Service(("127.0.0.1", service_port))
                late.statuses = [500, 401, 503]
                back_s = monotonic()
                async with serving(late):
                    await late.until(1, within_s=30)
                    assert monotonic() - back_s < 4 * BACK_S + SLACK_S  # it refused three times
                    first = late.batches[0][1]
                    await everything(late)
                    assert (await daemon.stop()).code == 0
        counts = summary_of(tmp_path)["bench"]
        assert counts["samples_dropped"] == counts["samples_spooled"] == 0
        assert counts["samples_published"] == counts["readings"] > 4000
        sequences = [sample.sequence for sample in late.samples()]
        assert sorted(sequences) == list(range(counts["readings"]))
        assert first.newest_age_ms < 5000  # the present came first
        assert first.samples[0].sequence > 3000
        assert sorted(counts_of(late.samples())) == [(float(n), float(n + 1000)) for n in read_of(late.samples())]

    def read_of(samples: list[Sample]) -> list[int]:
        """Return the counts that came, which must be among those given and each there once."""
        found = sorted(round(first) for first, _ in counts_of(samples))
        assert len(set(found)) == len(found)
        assert 20_001 <= found[0] <= found[-1] <= taken[0]
        return found

    asyncio.run(story())


def test_killed_twenty_times_all_that_was_spooled_arrives(tmp_path: Path) -> None:
    async def story() -> None:
        with cable(tmp_path) as usb:
            device = SerialDevice(usb.plug())
            port, spooled = free_port(), set[tuple[str, int]]()
            url, source = f"http://127.0.0.1:{port}", configs.serial(str(usb.path))
            for turn in range(20):
                begun = device.sequence
                async with running(tmp_path, source, url) as daemon:
                    async with asyncio.timeout(20):
                        while device.sequence < begun + 60 + 4 * turn:  # noqa: ASYNC110 - the device is outside
                            await asyncio.sleep(0.01)
                    daemon.tell(signal.SIGKILL)
                    with suppress(ProcessLookupError):
                        await daemon.end()
                device.stop()
                with Spool(tmp_path / "beamtouch-daemon.spool", 10**9) as spool:
                    now = set(names(batches_in(spool)))
                assert now > spooled  # nothing that was there is gone
                spooled = now
            async with serving(Service(("127.0.0.1", port))) as service, running(tmp_path, source, url) as daemon:
                async with asyncio.timeout(30):
                    while not spooled <= set(names([batch for _, batch, _ in service.batches])):
                        await service.until(len(service.samples()) + 1)
                assert (await daemon.stop()).code == 0
            arrived = names([batch for _, batch, _ in service.batches])
            assert len(set(arrived)) == len(arrived)
            assert all(second == first + 1000 for first, second in counts_of(service.samples()))

    asyncio.run(story())


def names(batches: list[Batch]) -> list[tuple[str, int]]:
    """Return what names each sample for good."""
    return [(batch.boot_id, sample.sequence) for batch in batches for sample in batch.samples]


def batches_in(spool: Spool) -> list[Batch]:
    """Return all batches without taking them out."""
    rows = spool._database.execute("SELECT content FROM batch ORDER BY id").fetchall()
    return [Batch.model_validate_json(content) for (content,) in rows]


SMALL_DISK = "import resource, sys; resource.setrlimit(resource.RLIMIT_FSIZE, (100_000, 100_000))"


def test_on_a_full_disk_memory_keeps_what_the_spool_cannot(tmp_path: Path) -> None:
    async def story() -> None:
        with cable(tmp_path) as usb:
            device = SerialDevice(usb.plug())
            port = free_port()
            url, source = f"http://127.0.0.1:{port}", configs.serial(str(usb.path))
            async with running(tmp_path, source, url, code=SMALL_DISK) as daemon:
                async with asyncio.timeout(30):
                    while device.sequence < 2000:  # noqa: ASYNC110 - the device is outside
                        await asyncio.sleep(0.05)
                async with serving(Service(("127.0.0.1", port))) as service:
                    await service.until(2000, within_s=30)
                    outcome = await daemon.stop()
            assert outcome.code == 0
            assert outcome.err.count("cannot write to the spool") == 1
            counts = summary_of(tmp_path)["bench"]
            assert counts["samples_dropped"] == 0
            with Spool(tmp_path / "beamtouch-daemon.spool", 10**9) as spool:
                kept = names(batches_in(spool))
            arrived = names([batch for _, batch, _ in service.batches])
            assert len(set(arrived)) == len(arrived) == counts["samples_published"]
            assert len(set(arrived) | set(kept)) == counts["readings"]

    asyncio.run(story())


STEPPED_CLOCK = (
    "import sys, time; real, since = time.time, time.monotonic(); "
    "time.time = lambda: real() + (3600.0 if time.monotonic() - since > 3 else 0.0)"
)


def test_a_clock_stepped_by_an_hour_changes_dates_and_nothing_else(tmp_path: Path) -> None:
    async def story() -> None:
        with cable(tmp_path) as usb:
            SerialDevice(usb.plug())
            async with (
                serving(Service()) as service,
                running(tmp_path, configs.serial(str(usb.path)), service.url, code=STEPPED_CLOCK) as daemon,
            ):
                await service.until(1)
                async with asyncio.timeout(30):
                    while service.samples()[-1].acquired_unix_us - service.samples()[0].acquired_unix_us < 3.6e9:
                        await service.until(len(service.samples()) + 1)
                await service.until(len(service.samples()) + 200)
                assert (await daemon.stop()).code == 0
            samples = service.samples()
            assert [sample.sequence for sample in samples] == list(range(len(samples)))
            assert {quality for sample in samples for quality in sample.quality} == {Quality.GOOD}
            assert all(batch.newest_age_ms < 1500 for _, batch, _ in service.batches)
            dates = [sample.acquired_unix_us for sample in samples]
            assert sum(later - earlier > 3.5e9 for earlier, later in pairwise(dates)) == 1

    asyncio.run(story())
