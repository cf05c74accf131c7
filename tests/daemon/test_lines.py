"""Lines and devices at fault, on the daemon as a process: what is delivered is held against what was sent."""

import asyncio
import re
from collections.abc import AsyncIterator, Callable
from contextlib import asynccontextmanager
from functools import partial
from pathlib import Path

import pytest

from beamtouch_common.uptime import uptime_s
from beamtouch_protocol.messages import Reading
from beamtouch_service.samples import Batch, Note
from support.surfaces import configs

from .devices import Pieces, SerialDevice, StampingUnit, rtu_units
from .faulty import cable, counts_of, running, soon
from .lines import Terminal, terminal
from .process import Daemon, Outcome, started, summary_of
from .service import Service, serving

pytestmark = pytest.mark.anyio

CONFIGURED_HZ = 200.0


def more(service: Service, number: int) -> bool:
    """Return whether so many samples have come."""
    return len(service.samples()) >= number


async def test_a_serial_device_that_is_reset_or_plugged_in_again_is_read_within_two_seconds(tmp_path: Path) -> None:
    with cable(tmp_path) as usb:
        device = SerialDevice(usb.plug())
        source = configs.serial(str(usb.path))
        async with serving(Service()) as service, running(tmp_path, source, service.url) as daemon:
            for boot_id in (2, 3):
                await service.until(len(service.samples()) + 100)
                if boot_id == 2:
                    device.stop()
                    usb.unplug()
                    await asyncio.sleep(1.0)
                    device = SerialDevice(usb.plug(), boot_id=boot_id)
                else:
                    device.reset(boot_id)
                await soon(partial(more, service, len(service.samples()) + 20))
            outcome = await daemon.stop()
            assert outcome.code == 0
            assert "the device was reset" in outcome.err
        assert all(second == first + 1000 for first, second in counts_of(service.samples()))
        counts = summary_of(tmp_path)["bench"]
        # As recorded: on a starved machine, some arrive twice.
        assert counts["samples_published"] == counts["readings"] == len(service.record.whole())


class KeepingDevice(SerialDevice):
    """A device with a schedule of its own: a multiple of the rate that it is told.

    What a busy machine makes late is sent later, with the time at which it was due, as a real device's would be.
    """

    def __init__(self, line: Terminal, factor: float, lose_every: int = 0, burst_s: float = 0.0) -> None:
        super().__init__(line)
        self.factor = factor
        self._lose_every = lose_every
        self._burst_s = burst_s

    async def _run(self, rate_hz: int, oversampling: int) -> None:
        due_s = uptime_s()
        while True:
            while due_s <= uptime_s():
                if not (self._lose_every and self.sequence % self._lose_every == 0):
                    counts = self.counts(self.sequence % 500)
                    self.send(Reading(self.sequence % 2**16, self.device_us_at(due_s), oversampling, counts))
                self.sequence += 1
                due_s += 1 / (self.factor * rate_hz)
            await asyncio.sleep(self._burst_s or max(0.0, due_s - uptime_s()))


@asynccontextmanager
async def reading(
    folder: Path, source: str, rate_hz: float = CONFIGURED_HZ, code: str = ""
) -> AsyncIterator[tuple[Service, Daemon]]:
    async with serving(Service()) as service:
        config = configs.write(folder, configs.surface(source=source, rate_hz=rate_hz), url=service.url)
        async with started("run", config, code=code) as daemon:
            yield service, daemon


async def until(service: Service, holds: Callable[[Batch], bool]) -> None:
    """Wait for a batch from now on for which something holds."""
    seen = len(service.batches)
    async with asyncio.timeout(60):
        while not any(holds(batch) for _, batch, _ in service.batches[seen:]):
            await service.until(len(service.samples()) + 1)


def is_marked(batch: Batch) -> bool:
    return batch.notes == [Note.RATE]


def newest(batches: list[Batch]) -> int:
    """Return the highest number of a sample; 0 without any."""
    return max((batch.samples[-1].sequence for batch in batches if batch.samples), default=0)


def complaints(outcome: Outcome) -> list[str]:
    return [line for line in outcome.err.splitlines() if "set rate_hz" in line]


@pytest.mark.soak
@pytest.mark.promise(
    "docs/how-to/adc-module.md",
    "the log says what to set, and each contact carries the note `rate` until the two agree.",
)
async def test_a_device_at_another_rate_is_marked_until_it_keeps_its_rate(tmp_path: Path) -> None:
    with terminal() as line:
        device = KeepingDevice(line, 2.0)
        source = configs.serial(line.path)
        async with reading(tmp_path, source, code=device.known_clock()) as (service, daemon):

            def is_mended(batch: Batch) -> bool:
                # What comes without a mark may be older than what has one: a busy line sends the newest first.
                marked = [one for _, one, _ in service.batches if is_marked(one)]
                return not is_marked(batch) and newest([batch]) > newest(marked)

            await until(service, is_marked)
            device.factor = 1.0
            device.restart(round(CONFIGURED_HZ))
            await until(service, is_mended)
            outcome = await daemon.stop()
    (complaint,) = complaints(outcome)
    said = re.search(r"sends ([\d.]+) .*, rate_hz is 200: filter windows .* set rate_hz = (\d+)", complaint)
    assert said is not None, complaint
    assert [float(number) for number in said.groups()] == pytest.approx([2 * CONFIGURED_HZ] * 2, rel=0.001)
    assert "times shorter than configured" in complaint
    assert re.search(r" [\d.]+ readings per second, within 10 % of rate_hz = 200\n", outcome.err)


async def test_neither_lost_readings_nor_bursts_are_taken_for_another_rate(tmp_path: Path) -> None:
    with terminal() as line:
        KeepingDevice(line, 1.0, lose_every=3, burst_s=0.3)
        async with reading(tmp_path, configs.serial(line.path)) as (service, daemon):
            await service.until(round(4.5 * CONFIGURED_HZ * 2 / 3))
            outcome, batches = await daemon.stop(), [batch for _, batch, _ in service.batches]
    assert complaints(outcome) == []
    assert not any(map(is_marked, batches))


async def test_a_bus_that_is_too_slow_for_its_rate_is_marked(tmp_path: Path) -> None:
    def slow(_number: int, frame: bytes) -> Pieces:
        return [(0.02, frame)]

    with terminal() as bus:
        async with rtu_units(bus, {1: StampingUnit(slow)}):
            source = f"{configs.rtu(bus.path)}\ntimeout_ms = 5000"
            async with reading(tmp_path, source, rate_hz=100.0) as (service, daemon):
                await until(service, is_marked)
                outcome = await daemon.stop()
    (complaint,) = complaints(outcome)
    assert "of 100 readings per second could be polled: means are of" in complaint
    assert complaint.endswith("or less")
