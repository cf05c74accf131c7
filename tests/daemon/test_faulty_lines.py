"""Faults of lines and devices, on the daemon as a process: what is delivered is held against what was sent."""

import asyncio
from functools import partial
from pathlib import Path

import pytest

from beamtouch_protocol.framing import encode

from . import configs
from .devices import SerialDevice, StampingUnit, rtu_units
from .faulty import Mangler, cable, counts_of, running, soon
from .process import summary_of
from .service import Service, serving

pytestmark = pytest.mark.anyio


async def test_a_bad_serial_line_delivers_only_values_that_were_sent_and_each_once(tmp_path: Path) -> None:
    with cable(tmp_path) as usb:
        line = usb.plug()
        mangler = Mangler(line)
        device = SerialDevice(line)
        device.send = lambda message: mangler.write(encode(message))  # type: ignore[method-assign]
        async with (
            serving(Service()) as service,
            running(tmp_path, configs.serial(str(usb.path)), service.url) as daemon,
        ):
            await service.until(1000, within_s=60)
            assert (await daemon.stop()).code == 0
        found = counts_of(service.samples())
        assert all(second == first + 1000 for first, second in found)
        assert all(20_000 <= first < 20_000 + device.sequence for first, _ in found)
        assert len(set(found)) == len(found)
        assert found == sorted(found)
        counts = summary_of(tmp_path)["bench"]
        assert counts["samples_published"] == counts["readings"] == len(service.samples())
        assert len(found) >= 0.9 * mangler.whole - 20  # a damaged frame takes hardly another one with it


def more(service: Service, number: int) -> bool:
    """Return whether so many samples have come."""
    return len(service.samples()) >= number


@pytest.mark.parametrize("kind", ["unplugged", "reset"])
async def test_a_serial_device_that_comes_back_is_read_within_two_seconds(tmp_path: Path, kind: str) -> None:
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
                before = len(service.samples())
                await soon(partial(more, service, before + 20))
            assert (await daemon.stop()).code == 0
        assert all(second == first + 1000 for first, second in counts_of(service.samples()))
        counts = summary_of(tmp_path)["bench"]
        assert counts["samples_published"] == counts["readings"] == len(service.samples())


async def test_a_modbus_adapter_that_is_plugged_in_again_is_read_within_two_seconds(tmp_path: Path) -> None:
    with cable(tmp_path) as usb:
        source = configs.rtu(str(usb.path))
        line = usb.plug()
        async with serving(Service()) as service, running(tmp_path, source, service.url) as daemon:
            for turn in range(3):
                async with rtu_units(line, {1: StampingUnit()}):
                    before = len(service.samples())
                    if turn:
                        await soon(partial(more, service, before + 20))
                    await service.until(before + 100)
                    usb.unplug()
                await asyncio.sleep(0.5)
                line = usb.plug()
            assert (await daemon.stop()).code == 0
        assert all(first == second for first, second in counts_of(service.samples()))
        counts = summary_of(tmp_path)["bench"]
        assert counts["samples_published"] == counts["readings"] == len(service.samples())
