"""`run` as a process between real devices and a real service."""

import asyncio
import signal
import sqlite3
from collections import Counter
from contextlib import closing, suppress
from pathlib import Path
from time import monotonic, time

import pytest

from beamtouch_daemon.tasks import cancel
from beamtouch_service.samples import Quality
from free_ports import free_port

from . import configs
from .devices import SerialDevice, pymodbus_server
from .faulty import LOG_FILE, batches_in, everything, soon
from .lines import terminal
from .process import PATIENT_STOP, started, summary_of
from .service import Service, serving

pytestmark = pytest.mark.anyio


@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGHUP], ids=["a stop", "a terminal that closes"])
async def test_readings_become_samples_and_a_stop_delivers_all_of_them(tmp_path: Path, number: signal.Signals) -> None:
    async with serving(Service()) as service, pymodbus_server([21_000, 65_535]) as port:
        config = configs.write(tmp_path, configs.surface(source=configs.tcp(port)), url=service.url)
        async with started("run", config, "--summary", tmp_path / "summary.json", code=PATIENT_STOP) as daemon:
            await service.until(100)
            outcome = await daemon.stop(number)
    samples = service.samples()
    assert [sample.sequence for sample in samples] == list(range(1, len(samples) + 1))
    assert {tuple(sample.quality) for sample in samples} == {(Quality.GOOD, Quality.SATURATED)}
    assert samples[-1].deflection_mm[0] == pytest.approx(0.1)
    for _, batch, arrival_s in service.batches:
        if batch.newest_age_ms is not None:
            # As old as it is: less the time on the way, of which this machine may need some.
            age_s = time() - monotonic() + arrival_s - batch.samples[-1].acquired_unix_us / 1e6
            assert batch.newest_age_ms / 1e3 <= age_s + 0.01
    assert outcome.code == 0
    summary = summary_of(tmp_path)["bench"]
    assert summary["readings"] == summary["samples_published"] == len(samples)
    assert summary["samples_dropped"] == 0
    lines = outcome.err.splitlines()
    assert lines[-1] == (
        f"bench: {len(samples)} readings taken, {summary['readings_lost']} lost; "
        f"{len(samples)} samples published, 0 dropped"
    )
    assert "Traceback" not in outcome.err


async def test_a_failing_surface_costs_others_nothing_and_does_not_fill_the_log(tmp_path: Path) -> None:
    with terminal() as line:
        device = SerialDevice(line)
        async with serving(Service()) as service:
            config = configs.write(
                tmp_path,
                configs.surface("dead", configs.tcp(free_port())),
                configs.surface("alive", configs.serial(line.path)),
                url=service.url,
            )
            async with started("run", config, "--summary", tmp_path / "summary.json") as daemon:
                await service.until(150, "alive")
                outcome = await daemon.stop(signal.SIGINT)
    assert outcome.code == 130
    summary = summary_of(tmp_path)
    assert set(summary["dead"].values()) == {0}
    assert summary["alive"]["samples_published"] >= 150
    assert summary["alive"]["readings_lost"] <= 2 + device.unsent
    log = Counter(line.partition(" WARNING dead: ")[2] for line in outcome.err.splitlines())
    del log[""]
    assert list(log.values()) == [1]


async def test_answers_that_cannot_be_decoded_are_no_tracebacks(tmp_path: Path) -> None:
    """The first answers come with a function that Modbus does not know, the others as asked for."""
    asked = 0

    async def answer(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        nonlocal asked
        with suppress(asyncio.IncompleteReadError, ConnectionError):
            while True:
                query = await reader.readexactly(12)
                asked += 1
                words = b"\x55\x01" if asked <= 3 else bytes([query[7], 4]) + b"\x52\x08" * 2
                writer.write(query[:4] + (len(words) + 1).to_bytes(2, "big") + query[6:7] + words)
                await writer.drain()
        writer.close()

    device = await asyncio.start_server(answer, "127.0.0.1", 0)
    async with serving(Service()) as service, device:
        source = configs.tcp(device.sockets[0].getsockname()[1], timeout_ms=300)
        config = configs.write(tmp_path, configs.surface(source=source), url=service.url)
        async with started("run", config) as daemon:
            await service.until(50)
            outcome = await daemon.stop()
    assert outcome.code == 0
    assert asked > 50
    assert service.samples()[-1].deflection_mm[0] == pytest.approx(0.1)
    assert "Traceback" not in outcome.err
    assert "data_received" not in outcome.err


async def test_a_device_that_comes_back_is_read_again_and_the_outage_is_counted(tmp_path: Path) -> None:
    port = free_port()
    async with serving(Service()) as service:
        config = configs.write(tmp_path, configs.surface(source=configs.tcp(port)), url=service.url)
        async with started("run", config, "--summary", tmp_path / "summary.json") as daemon:
            async with pymodbus_server([20_000, 20_000], port=port):
                await service.until(50)
            await asyncio.sleep(1.0)
            async with pymodbus_server([21_000, 21_000], port=port):
                await soon(lambda: service.samples()[-1].deflection_mm[0] == pytest.approx(0.1))
                values = [sample.deflection_mm[0] for sample in service.samples()]
                first = next(value for value in values if value is not None and value != pytest.approx(0.0))
                assert first == pytest.approx(0.1)  # nothing from before in its average
                outcome = await daemon.stop()
    assert outcome.code == 0
    assert summary_of(tmp_path)["bench"]["readings_lost"] > 180  # a second at 200 Hz
    assert "works again after" in outcome.err
    assert len(outcome.err.splitlines()) < 10


@pytest.mark.parametrize("log_mb", [0, 200])
async def test_without_a_service_a_stop_ends_soon_and_reports_the_fate_of_the_samples(
    tmp_path: Path, log_mb: int
) -> None:
    with terminal() as line:
        device = SerialDevice(line)
        url = f"http://127.0.0.1:{free_port()}"
        config = configs.write(tmp_path, configs.surface(source=configs.serial(line.path)), url=url)
        config.write_text(config.read_text().replace("batch_ms", f"log_mb = {log_mb}\nbatch_ms"))
        async with started("run", config, "--summary", tmp_path / "summary.json") as daemon:
            async with asyncio.timeout(60):
                while device.sequence < 200:  # noqa: ASYNC110 - the device is outside
                    await asyncio.sleep(0.05)
            outcome = await daemon.stop()  # fails if it takes a minute
    assert outcome.code == 0
    summary = summary_of(tmp_path)["bench"]
    kept = "samples_in_log" if log_mb else "samples_dropped"
    assert summary[kept] == summary["readings"] > 0
    assert sum(value for name, value in summary.items() if name.startswith("samples_")) == summary[kept]


async def test_what_a_stop_leaves_is_delivered_after_the_next_start_alongside_new_samples(tmp_path: Path) -> None:
    with terminal() as line:
        device, port = SerialDevice(line), free_port()
        url = f"http://127.0.0.1:{port}"
        config = configs.write(tmp_path, configs.surface(source=configs.serial(line.path)), url=url)
        async with started("run", config, "--summary", tmp_path / "summary.json") as daemon:
            async with asyncio.timeout(60):
                while device.sequence < 300:  # noqa: ASYNC110 - the device is outside
                    await asyncio.sleep(0.05)
            assert (await daemon.stop()).code == 0
        before = summary_of(tmp_path)["bench"]
        old = batches_in(tmp_path / LOG_FILE)[0].boot_id
        async with (
            serving(Service(("127.0.0.1", port))) as service,
            started("run", config, "--summary", tmp_path / "summary.json", code=PATIENT_STOP) as daemon,
        ):
            await service.until(before["readings"] + 100)
            await everything(service)
            assert (await daemon.stop()).code == 0
        after = summary_of(tmp_path)["bench"]
        # A starved daemon has not read all that waits in the line, which holds some 200 readings.
        assert before["samples_in_log"] == before["readings"] >= 50
        assert after["samples_in_log"] == 0
        assert after["samples_published"] == after["readings"] + before["readings"]
        assert all(batch.backlog for _, batch, _ in service.batches if batch.boot_id == old)
        numbers = service.record.numbers()
        assert numbers.pop(old) == list(range(1, before["readings"] + 1))
        assert list(numbers.values()) == [list(range(1, after["readings"] + 1))]


async def test_a_log_file_of_another_program_is_an_error_in_one_line(tmp_path: Path) -> None:
    config = configs.write(tmp_path, configs.surface())
    config.write_text(config.read_text().replace("batch_ms", 'log_file = "orders.db"\nbatch_ms'))
    with closing(sqlite3.connect(tmp_path / "orders.db")) as other:
        other.execute("CREATE TABLE orders (name)")
    async with started("run", config) as daemon:
        outcome = await daemon.end()
    assert (outcome.code, outcome.out) == (2, "")
    assert outcome.complaint() == (
        f"publish.log_file: {tmp_path}/orders.db is the database of another program or of another version; "
        "choose another file"
    )


async def test_a_cancellation_that_a_task_swallows_is_repeated() -> None:
    async def swallow_one() -> None:
        with suppress(asyncio.CancelledError):
            await asyncio.sleep(60)
        await asyncio.sleep(60)

    task = asyncio.create_task(swallow_one())
    await asyncio.sleep(0)
    await asyncio.wait_for(cancel({task}), 30)
    assert task.cancelled()
