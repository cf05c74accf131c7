"""Outages, crashes and a stepped clock, on the daemon as a process: nothing taken is lost or doubled."""

import asyncio
import signal
import sqlite3
from contextlib import closing, suppress
from itertools import pairwise
from pathlib import Path
from time import monotonic

import pytest

from beamtouch_daemon.delivery.spool import Spool
from beamtouch_service.samples import Quality, Sample

from . import configs
from .devices import SerialDevice, StampingUnit, pymodbus_server, tcp_unit
from .faulty import BACK_S, SLACK_S, batches_in, cable, counts_of, everything, names, running
from .process import free_port, summary_of
from .service import Service, serving
from .spools import batch_of

pytestmark = [pytest.mark.anyio, pytest.mark.long]

BEFORE = 1000
"""Readings before a device goes away."""


async def test_a_device_away_for_30_s_and_a_service_away_for_60_s_lose_nothing_that_was_taken(tmp_path: Path) -> None:
    taken = [20_000]

    async def action(_function: int, _start: int, _address: int, _count: int, now: list[int], _set: object) -> None:
        taken[0] += 1
        now[:2] = [taken[0], taken[0] + 1000]

    def read_of(samples: list[Sample]) -> list[int]:
        """Return the counts that came, which must be among those given and each there once."""
        found = sorted(round(first) for first, _ in counts_of(samples))
        assert len(set(found)) == len(found)
        assert 20_001 <= found[0] <= found[-1] <= taken[0]
        return found

    service_port, device_port = free_port(), free_port()
    url, source = f"http://127.0.0.1:{service_port}", configs.tcp(device_port)
    async with running(tmp_path, source, url) as daemon:
        begin_s = monotonic()
        async with pymodbus_server([0, 0], action, port=device_port):
            while taken[0] < 20_000 + BEFORE:  # noqa: ASYNC110 - the daemon is outside
                await asyncio.sleep(0.02)
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
                await late.until(1, within_s=60)
                assert monotonic() - back_s < 4 * BACK_S + SLACK_S  # it refused three times
                first = late.batches[0][1]
                await everything(late)
                assert (await daemon.stop()).code == 0
    counts = summary_of(tmp_path)["bench"]
    # A stop on a busy machine leaves what it has no time to send in the spool.
    with Spool(tmp_path / "beamtouch-daemon.spool", 10**9) as spool:
        kept = [sample for batch in batches_in(spool) for sample in batch.samples]
    whole = late.samples() + kept
    assert (counts["samples_dropped"], counts["samples_spooled"]) == (0, len(kept))
    assert counts["samples_published"] == len(late.samples()) > 1000
    assert sorted(sample.sequence for sample in whole) == list(range(counts["readings"]))
    # The present came first: what was read after the device came back.
    assert first.newest_age_ms < 5000
    assert counts_of(first.samples)[0][0] > came_back
    read = read_of(whole)
    assert read[0] < came_back < read[-1]
    assert sorted(counts_of(whole)) == [(float(n), float(n + 1000)) for n in read]


async def test_killed_twenty_times_all_that_was_spooled_arrives(tmp_path: Path) -> None:
    with cable(tmp_path) as usb:
        device = SerialDevice(usb.plug())
        port, spooled = free_port(), set[tuple[str, int]]()
        url, source = f"http://127.0.0.1:{port}", configs.serial(str(usb.path))
        for turn in range(20):
            begun = device.sequence
            async with running(tmp_path, source, url) as daemon:
                async with asyncio.timeout(60):
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
            async with asyncio.timeout(60):
                while not spooled <= set(names([batch for _, batch, _ in service.batches])):
                    await service.until(len(service.samples()) + 1)
            assert (await daemon.stop()).code == 0
        arrived = names([batch for _, batch, _ in service.batches])
        assert len(set(arrived)) == len(arrived)
        assert all(second == first + 1000 for first, second in counts_of(service.samples()))


async def test_one_bad_row_costs_its_own_samples_and_live_delivery_nothing(tmp_path: Path) -> None:
    bad = 17

    def late(service: Service) -> list[int]:
        batches = [batch for _, batch, _ in service.batches if batch.boot_id == "boot-0001"]
        # On a busy machine an answer may take so long that the daemon sends a batch again.
        return list(dict.fromkeys(number for _, number in names(batches)))

    path = tmp_path / "beamtouch-daemon.spool"
    with Spool(path, 10**9) as spool:
        for first in range(0, 252, 7):
            spool.put("bench", batch_of(first, 7), monotonic())
    with closing(sqlite3.connect(path)) as database, database:
        database.execute("UPDATE batch SET content = replace(content, '[0.25', '[8.25') WHERE id = ?", (bad,))
    with cable(tmp_path) as usb:
        SerialDevice(usb.plug())
        async with (
            serving(Service()) as service,
            running(tmp_path, configs.serial(str(usb.path)), service.url) as daemon,
        ):
            async with asyncio.timeout(60):
                while len(late(service)) < 245:
                    await service.until(len(service.samples()) + 1)
            await service.until(len(service.samples()) + 200)
            outcome = await daemon.stop()
        assert outcome.err.count("set aside: the checksum does not match") == 1
        counts = summary_of(tmp_path)["bench"]
        assert counts["samples_set_aside"] == 7
        assert counts["samples_spooled"] == counts["samples_dropped"] == 0
        assert counts["samples_published"] == counts["readings"] + 245
        missing = range((bad - 1) * 7, bad * 7)
        assert late(service) == [n for n in range(252) if n not in missing]


async def test_spooled_samples_of_a_removed_surface_are_delivered(tmp_path: Path) -> None:
    with Spool(tmp_path / "beamtouch-daemon.spool", 10**9) as spool:
        spool.put("press", batch_of(0, 7), monotonic())
    with cable(tmp_path) as usb:
        SerialDevice(usb.plug())
        async with (
            serving(Service()) as service,
            running(tmp_path, configs.serial(str(usb.path)), service.url) as daemon,
        ):
            await service.until(7, "press", within_s=60)
            await service.until(20)
            assert (await daemon.stop()).code == 0
    with Spool(tmp_path / "beamtouch-daemon.spool", 10**9) as spool:
        assert not any(spool.waiting.values())


def stepped_clock(sign: Path) -> str:
    """Return code after which the clock is an hour ahead as soon as a file is there."""
    return (
        "import os, sys, time; real = time.time; "
        f"time.time = lambda: real() + (3600.0 if os.path.exists({str(sign)!r}) else 0.0)"
    )


async def test_a_clock_stepped_by_an_hour_changes_dates_and_nothing_else(tmp_path: Path) -> None:
    sign = tmp_path / "an hour later"

    with cable(tmp_path) as usb:
        SerialDevice(usb.plug())
        async with (
            serving(Service()) as service,
            running(tmp_path, configs.serial(str(usb.path)), service.url, code=stepped_clock(sign)) as daemon,
        ):
            await service.until(100, within_s=60)
            sign.touch()
            async with asyncio.timeout(60):
                while service.samples()[-1].acquired_unix_us - service.samples()[0].acquired_unix_us < 3.6e9:
                    await service.until(len(service.samples()) + 1)
            await service.until(len(service.samples()) + 200)
            assert (await daemon.stop()).code == 0
        samples = service.samples()
        assert [sample.sequence for sample in samples] == list(range(len(samples)))
        assert {quality for sample in samples for quality in sample.quality} == {Quality.GOOD}
        assert all(batch.newest_age_ms < 60_000 for _, batch, _ in service.batches)
        dates = [sample.acquired_unix_us for sample in samples]
        assert sum(later - earlier > 3.5e9 for earlier, later in pairwise(dates)) == 1


async def test_the_summary_counts_what_is_delivered_after_its_surface_was_renamed(tmp_path: Path) -> None:
    async with tcp_unit(StampingUnit()) as port, serving(Service()) as service:
        service.problem_of = lambda *_: (503, "")
        async with running(tmp_path, configs.tcp(port), service.url) as daemon:
            while service.attempts < 5:  # noqa: ASYNC110 - the daemon is outside
                await asyncio.sleep(0.05)
            path = tmp_path / "daemon.toml"
            path.write_text(path.read_text().replace("surfaces.bench", "surfaces.press"))
            daemon.tell(signal.SIGHUP)
            await asyncio.sleep(1.0)
            service.problem_of = lambda *_: None
            await service.until(1, "press", within_s=60)
            await service.until(1, within_s=60)
            came = 0
            while came < len(service.samples()):
                came = len(service.samples())
                await asyncio.sleep(1.0)
            assert (await daemon.stop()).code == 0
        bench = summary_of(tmp_path)["bench"]
    assert (bench["samples_published"], bench["samples_spooled"]) == (came, 0)
