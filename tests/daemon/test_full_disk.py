"""A full disk under the log file, on the daemon as a process: what is kept, delivered and reported."""

import asyncio
from pathlib import Path

import pytest

from free_ports import free_port

from . import configs
from .devices import SerialDevice
from .faulty import LOG_FILE, cable, everything, running, samples_in
from .process import summary_of
from .service import Service, serving
from .small_disks import small_disk

pytestmark = [pytest.mark.anyio, pytest.mark.long]


SMALL_DISK = "import resource; resource.setrlimit(resource.RLIMIT_FSIZE, (100_000, 100_000))"


async def more_readings(device: SerialDevice, number: int) -> None:
    begun = device.sequence
    async with asyncio.timeout(60):
        while device.sequence < begun + number:  # noqa: ASYNC110 - the device is outside
            await asyncio.sleep(0.02)


async def test_on_a_full_disk_samples_stay_in_memory(tmp_path: Path) -> None:
    with cable(tmp_path) as usb:
        device = SerialDevice(usb.plug())
        port = free_port()
        url, source = f"http://127.0.0.1:{port}", configs.serial(str(usb.path))
        async with running(tmp_path, source, url, code=SMALL_DISK) as daemon:
            async with asyncio.timeout(60):
                while device.sequence < 2000:  # noqa: ASYNC110 - the device is outside
                    await asyncio.sleep(0.05)
            async with serving(Service(("127.0.0.1", port))) as service:
                await service.until(2000, within_s=60)
                outcome = await daemon.stop()
        assert outcome.code == 0
        assert outcome.err.count("cannot be written") == 1
        counts = summary_of(tmp_path)["bench"]
        assert counts["samples_dropped"] == 0
        kept, arrived = samples_in(tmp_path / LOG_FILE), service.record.whole()
        assert len(arrived) == counts["samples_published"]
        numbers = {sample.sequence for sample in [*arrived, *kept]}
        assert numbers == set(range(1, counts["readings"] + 1))


async def test_a_disk_that_is_full_is_emptied_when_the_service_is_back_and_keeps_what_a_stop_leaves(
    tmp_path: Path,
) -> None:
    with small_disk(tmp_path, size_kib=2048) as disk, cable(tmp_path) as usb:
        device = SerialDevice(usb.plug())
        port = free_port()
        url, source = f"http://127.0.0.1:{port}", configs.serial(str(usb.path))
        publish = f'log_file = "{disk.path}/samples"'
        async with running(tmp_path, source, url, publish=publish, prefix=disk.prefix) as daemon:
            await more_readings(device, 1600)
            disk.fill()
            await more_readings(device, 400)
            async with serving(Service(("127.0.0.1", port))) as service:
                await service.until(1)
                async with asyncio.timeout(60):
                    while len(service.record.whole()) <= 1900 - device.unsent:  # noqa: ASYNC110
                        await asyncio.sleep(0.05)  # the daemon is outside
                await everything(service)
            disk.fill()
            await more_readings(device, 600)
            outcome = await daemon.stop()
        assert outcome.code == 0
        before = summary_of(tmp_path)["bench"]
        assert before["samples_dropped"] == 0, outcome.err
        # A starved daemon has not read all that waits in the line, which holds some 200 readings.
        assert before["samples_in_log"] >= 300 - device.unsent
        assert before["samples_published"] + before["samples_in_log"] == before["readings"]
        # A start on a disk that is still full delivers them.
        async with (
            serving(Service(("127.0.0.1", port))) as service,
            running(tmp_path, source, url, publish=publish, prefix=disk.prefix) as daemon,
        ):
            await service.until(before["samples_in_log"] + 200)
            await everything(service)
            assert (await daemon.stop()).code == 0
        after = summary_of(tmp_path)["bench"]
        assert after["samples_in_log"] == after["samples_dropped"] == 0
        assert after["samples_published"] == after["readings"] + before["samples_in_log"]


async def test_the_loss_is_reported_if_the_disk_is_full_from_the_start_and_the_service_is_away(tmp_path: Path) -> None:
    with small_disk(tmp_path, size_kib=64) as disk:
        disk.fill()
        with cable(tmp_path) as usb:
            device = SerialDevice(usb.plug())
            url, source = f"http://127.0.0.1:{free_port()}", configs.serial(str(usb.path))
            publish = f'log_file = "{disk.path}/samples"'
            async with running(tmp_path, source, url, publish=publish, prefix=disk.prefix) as daemon:
                await more_readings(device, 400)
                outcome = await daemon.stop()
            assert outcome.code == 0
            assert "disk is full); samples stay in memory, trying again" in outcome.err
            counts = summary_of(tmp_path)["bench"]
            assert counts["samples_dropped"] == counts["readings"] > 100
            assert f"{counts['readings']} samples dropped: neither" in outcome.err
