"""`run` as a process between real devices and a real service: start, what comes late, supervision, stop."""

import asyncio
import json
import re
import signal
import socket
import sqlite3
from collections.abc import Callable
from contextlib import closing, suppress
from pathlib import Path
from time import monotonic, time
from types import SimpleNamespace
from typing import Any, cast

import httpx2
import pytest
from prometheus_client.parser import text_string_to_metric_families

from beamtouch_daemon.config.sources import ModbusRtu
from beamtouch_daemon.running.acquisition import PATIENCE_S, Acquisition
from beamtouch_daemon.sources.rtu_bus import REST_TIMEOUTS
from beamtouch_service.samples import Quality
from support.network.free_ports import free_port
from support.network.host_names import host_names_in
from support.programs.service_manager import Manager
from support.surfaces import configs

from .conftest import Refused
from .devices import SerialDevice, pymodbus_server
from .faulty import LOG_FILE, batches_in, everything, leave_samples, soon
from .lines import terminal
from .noisy_beam import NoisyBeam
from .process import PATIENT_STOP, Outcome, started, summary_of
from .service import TOKEN, Service, serving
from .waits import until

pytestmark = pytest.mark.anyio

SEVERAL_ATTEMPTS_S = 2.0
"""Time for several attempts; the daemon waits 0.5 s at most between two."""
WAITING = "STATUS=reading bench; waiting for the device of late; not tared: late"


def whole_log(outcome: Outcome) -> list[dict[str, Any]]:
    """Return the events of a log in JSON, all but the summary."""
    return [json.loads(line) for line in outcome.err.splitlines() if line.startswith("{")]


@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGHUP], ids=["a stop", "a terminal that closes"])
async def test_readings_become_samples_and_a_stop_delivers_all_of_them(tmp_path: Path, number: signal.Signals) -> None:
    elsewhere = tmp_path / "elsewhere"
    elsewhere.mkdir()
    token, log = elsewhere / "token", elsewhere / "samples"
    token.write_text(f"{TOKEN}\n")
    async with serving(Service()) as service, pymodbus_server([21_000, 65_535]) as port:
        config = configs.write(tmp_path, configs.surface(source=configs.tcp(port)), url=service.url)
        (tmp_path / "beamtouch.token").unlink()
        # The unit file names both files on the command line.
        options = ("--token-file", token, "--sample-log-file", log, "--summary", tmp_path / "summary.json")
        async with started("run", config, *options, code=PATIENT_STOP) as daemon:
            await service.until(100)
            outcome = await daemon.stop(number)
    samples = service.record.whole()  # on a starved machine, some arrive twice, and newer ones before older ones
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
    *lines, last = outcome.err.splitlines()
    assert last == (
        f"bench: {len(samples)} readings taken, {summary['readings_lost']} lost; "
        f"{len(samples)} samples published, 0 dropped"
    )
    assert all(re.match(r"\d{4}-\d\d-\d\d \d\d:\d\d:\d\d\.\d{3}[+-]\d\d:\d\d [A-Z]+ ", line) for line in lines)
    assert log.exists()
    assert not (tmp_path / LOG_FILE).exists()


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
            options = ("--summary", tmp_path / "summary.json", "--log-format", "json")
            async with started("run", config, *options) as daemon:
                # What counts as published is what was answered, and batches are under way at the stop.
                await service.until(300, "alive")
                outcome = await daemon.stop(signal.SIGINT)
    assert outcome.code == 130
    summary = summary_of(tmp_path)
    assert set(summary["dead"].values()) == {0}
    assert summary["alive"]["samples_published"] >= 150
    assert summary["alive"]["readings_lost"] <= 2 + device.unsent
    events = whole_log(outcome)
    assert all(set(event) == {"time", "level", "source", "message"} for event in events)
    untared, *others = [event["message"] for event in events if event["message"].startswith("dead: ")]
    assert untared.startswith("dead: not tared: the rest gaps are those of the configuration; run ")
    assert len(others) == 1


@pytest.mark.promise(
    "docs/reference/daemon-configuration.md",
    "The first reading that leaves what the mean explains ends that, and the readings that waited become samples too.",
)
async def test_a_beam_at_rest_sends_few_samples_and_a_touch_at_once_each_of_its_readings(tmp_path: Path) -> None:
    """A sample at rest would be due after 10 s; a touch does not wait for it."""
    beam = NoisyBeam()
    async with serving(Service()) as service, pymodbus_server([20_000, 20_000], beam.answer) as port:
        surface = configs.surface(source=configs.tcp(port)).replace("rate_hz", "noise_mm = 0.002\nrate_hz", 1)
        surface = surface.replace('"moving-average"\nwindow = 1', '"growing-mean"\nmax_mean_ms = 20_000')
        service.stale_ms = 60_000.0
        config = configs.write(tmp_path, surface, url=service.url)
        config.write_text(config.read_text().replace("batch_ms", "rest_ms = 10_000\nbatch_ms"))
        async with started("run", config) as daemon:
            await service.until(1)
            few = False
            while not few:
                sent = len(service.samples())
                await beam.asked(200)
                few = len(service.samples()) - sent < 50
            beam.um, begun_polls = 100.0, beam.polls
            await until(lambda: sum((one.deflection_mm[0] or 0.0) > 0.05 for one in service.samples()) >= 8)
            assert beam.polls - begun_polls < 100
            assert (await daemon.stop()).code == 0


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


@pytest.mark.promise(
    "docs/reference/daemon-configuration.md",
    "Keeps such samples on disk after 5 s, and over a restart.",
)
@pytest.mark.parametrize("log_mb", [0, 200])
async def test_without_a_service_a_stop_ends_soon_and_what_it_leaves_is_delivered_after_the_next_start(
    tmp_path: Path, log_mb: int
) -> None:
    with terminal() as line:
        device, port = SerialDevice(line), free_port()
        url = f"http://127.0.0.1:{port}"
        config = configs.write(tmp_path, configs.surface(source=configs.serial(line.path)), url=url)
        config.write_text(config.read_text().replace("batch_ms", f"log_mb = {log_mb}\nbatch_ms"))
        options = ("--summary", tmp_path / "summary.json")
        before = await leave_samples(tmp_path, config, lambda: device.sequence >= 300)  # fails if a stop takes a minute
        # A starved daemon has not read all that waits in the line, which holds some 200 readings.
        fate = "samples_in_log" if log_mb else "samples_dropped"
        assert before[fate] == before["readings"] >= 50
        assert sum(value for name, value in before.items() if name.startswith("samples_")) == before[fate]
        if not log_mb:
            return
        old = batches_in(tmp_path / LOG_FILE)[0].boot_id
        async with (
            serving(Service(("127.0.0.1", port))) as service,
            started("run", config, *options, code=PATIENT_STOP) as daemon,
        ):
            await service.until(before["readings"] + 100)
            await everything(service)
            assert (await daemon.stop()).code == 0
    after = summary_of(tmp_path)["bench"]
    assert after["samples_in_log"] == 0
    assert after["samples_published"] == after["readings"] + before["readings"]
    assert all(batch.backlog for _, batch, _ in service.batches if batch.boot_id == old)
    numbers = service.record.numbers()
    assert numbers.pop(old) == list(range(1, before["readings"] + 1))
    assert list(numbers.values()) == [list(range(1, after["readings"] + 1))]


def test_a_log_file_of_another_program_is_an_error_in_one_line(tmp_path: Path, refused: Refused) -> None:
    config = configs.write(tmp_path, configs.surface())
    config.write_text(config.read_text().replace("batch_ms", 'log_file = "orders.db"\nbatch_ms'))
    with closing(sqlite3.connect(tmp_path / "orders.db")) as other:
        other.execute("CREATE TABLE orders (name)")
    content = (tmp_path / "orders.db").read_bytes()
    assert refused("run", config) == (
        f"publish.log_file: {tmp_path}/orders.db is the database of another program or of another version; "
        "choose another file"
    )
    assert (tmp_path / "orders.db").read_bytes() == content


def test_a_log_file_that_is_something_else_is_an_error_in_one_line_and_keeps_its_name(
    tmp_path: Path, refused: Refused
) -> None:
    config = configs.write(tmp_path, configs.surface())
    config.write_text(config.read_text().replace("batch_ms", 'log_file = "daemon.toml"\nbatch_ms'))
    content = config.read_text()
    expected = f"publish.log_file: {config} is not a log; choose another file"
    assert [refused("run", config) for _ in range(2)] == [expected] * 2
    assert config.read_text() == content
    assert sorted(one.name for one in tmp_path.iterdir()) == ["beamtouch.token", "daemon.toml"]


async def metrics(port: int, surface: str, is_missing: int) -> str:
    """Wait until the metrics say whether the device of a surface is missing; return what they say of the surface."""
    async with asyncio.timeout(60), httpx2.AsyncClient(trust_env=False) as client:
        while True:
            with suppress(httpx2.ConnectError):
                text = (await client.get(f"http://127.0.0.1:{port}/metrics")).text
                if f'beamtouch_source_missing{{surface="{surface}"}} {is_missing}.0' in text:
                    return "\n".join(line for line in text.splitlines() if f'surface="{surface}"' in line)
            await asyncio.sleep(0.05)


async def test_what_is_missing_is_named_and_used_when_it_comes(tmp_path: Path) -> None:
    adapter = tmp_path / "tty"
    with socket.create_server(("127.0.0.1", 0)) as taken:
        port = taken.getsockname()[1]
        async with serving(Service()) as service, pymodbus_server([21_000, 65_535]) as device:
            bench = configs.surface(source=configs.tcp(device))
            late = configs.surface("late", source=configs.serial(str(adapter)))
            config = configs.write(tmp_path, bench, late, url=service.url)
            log = tmp_path / "mount" / "samples"
            text = config.read_text().replace("batch_ms", f'log_file = "{log}"\nbatch_ms')
            config.write_text(f"{text}\n[metrics]\nport = {port}\n")
            async with started("run", config) as daemon:
                await service.until(100)  # the other surface
                assert not service.samples("late")
                taken.close()
                await metrics(port, "late", 1)
                await metrics(port, "bench", 0)
                with terminal() as line:
                    SerialDevice(line)
                    adapter.symlink_to(line.path)
                    await service.until(100, "late")
                    log.parent.mkdir()
                    service.problem_of = lambda _batch, _length: (503, "")
                    await until(log.exists)
                    while "readings_per_second" not in (text := await metrics(port, "late", 0)):  # noqa: ASYNC110
                        await asyncio.sleep(0.05)  # the daemon is outside
                    assert 'quality="good"' in text
                text = await metrics(port, "late", 1)
                # Nothing is known of a device that is away.
                assert "channel_quality" not in text
                assert "readings_per_second" not in text
                outcome = await daemon.stop()
    assert outcome.code == 0
    for words in (
        f"late: {adapter} cannot be opened (No such file or directory); plug the device in or correct the path",
        f"metrics: port {port} on 127.0.0.1: in use",
        f"{log} cannot be opened",
    ):
        assert words in outcome.err


async def test_names_that_do_not_resolve_are_waited_for(tmp_path: Path) -> None:
    names = host_names_in(tmp_path)
    async with serving(Service()) as service, pymodbus_server([21_000, 65_535]) as device:
        url = service.url.replace("127.0.0.1", "service.plant")
        config = configs.write(tmp_path, configs.surface(source=configs.tcp(device, "module.plant")), url=url)
        async with started("run", config, prefix=names.prefix) as daemon:
            await daemon.said("module.plant does not resolve")
            await asyncio.sleep(SEVERAL_ATTEMPTS_S)  # nothing is said of them
            names.add("module.plant", "127.0.0.1")
            said = await daemon.said("no such host is known")
            names.add("service.plant", "127.0.0.1")
            await service.until(20)
            assert (await daemon.stop()).code == 0
    assert said.endswith("no such host is known")
    assert "bench: reading" in said
    assert "module.plant" not in said


@pytest.mark.promise("docs/reference/daemon-configuration.md", "Metrics for Prometheus, on this machine only.")
@pytest.mark.promise(
    "docs/reference/metrics.md",
    "The daemon serves metrics on the loopback address if its configuration has `[metrics] port`.",
)
async def test_metrics_are_those_of_the_summary_and_only_on_this_machine(tmp_path: Path) -> None:
    port, address, polls = free_port(), ("127.0.0.1", free_port()), 0

    async def count(*_: object) -> None:
        nonlocal polls
        polls += 1

    async with pymodbus_server([21_000, 65_535], count) as device:
        url = "http://{}:{}".format(*address)
        config = configs.write(tmp_path, configs.surface(source=configs.tcp(device)), url=url)
        config.write_text(config.read_text() + f"\n[metrics]\nport = {port}\n")
        left = (await leave_samples(tmp_path, config, lambda: polls >= 20))["samples_in_log"]
        old = batches_in(tmp_path / LOG_FILE)[0].boot_id
        service = Service(address)
        service.problem_of = lambda batch, _: (422, "missing-channels") if batch.boot_id == old else None
        async with serving(service), started("run", config) as daemon, httpx2.AsyncClient(trust_env=False) as client:
            await service.until(400)
            async with asyncio.timeout(60):
                while 'boots_refused{surface="bench"} 1.0' not in (text := await metrics(port, "bench", 0)):  # noqa: ASYNC110
                    await asyncio.sleep(0.05)
            with pytest.raises(httpx2.ConnectError):
                await client.get(f"http://127.0.0.2:{port}/metrics")
            assert (await daemon.stop()).code == 0
    found = {
        (sample.name, sample.labels.get("where", "")): sample.value
        for family in text_string_to_metric_families(f"{text}\n")
        for sample in family.samples
    }
    assert found["beamtouch_readings_total", ""] >= 100
    assert 0 < found["beamtouch_samples_published_total", ""] <= found["beamtouch_readings_total", ""]
    assert found["beamtouch_samples_dropped_total", ""] == 0
    assert found["beamtouch_samples_in_log", "disk"] == left > 0
    assert found["beamtouch_reading_age_seconds", ""] >= 0
    assert ("beamtouch_samples_in_log", "memory") in found
    assert 0 < found["beamtouch_readings_per_second", ""] < 210
    assert found["beamtouch_rate_wrong", ""] in {0, 1}
    assert found["beamtouch_untared", ""] == 1


def test_a_line_without_progress_hangs_and_one_without_a_device_does_not() -> None:
    def line(last_progress_s: float, rate_hz: float = 100.0, timeout_ms: float = 1.0) -> Acquisition:
        source = ModbusRtu(kind="modbus-rtu", port="/dev/ttyUSB0", timeout_ms=timeout_ms)
        found = SimpleNamespace(
            surface=SimpleNamespace(rate_hz=rate_hz, source=source), last_progress_s=last_progress_s
        )
        return cast("Acquisition", found)

    now_s, long_ago_s = 1000.0, 1000.0 - PATIENCE_S - 1
    hangs: Callable[[Acquisition, float], bool] = Acquisition.hangs
    assert not hangs(line(now_s), now_s)
    assert hangs(line(long_ago_s), now_s)  # reading stands still
    assert PATIENCE_S * 2 <= 30  # before the watchdog of the unit
    assert not hangs(line(long_ago_s, rate_hz=0.1), now_s)  # it reads that seldom
    rested_s = now_s - (REST_TIMEOUTS + 1) * 4.0
    assert not hangs(line(rested_s, timeout_ms=4000.0), now_s)  # a unit that is off is asked that seldom


async def test_the_service_manager_is_told_of_start_progress_missing_devices_and_stop(tmp_path: Path) -> None:
    with closing(Manager(tmp_path)) as manager:
        async with serving(Service()) as service, pymodbus_server([21_000, 65_535]) as port:
            late = configs.surface("late", source=configs.serial("/dev/none"))
            config = configs.write(tmp_path, configs.surface(source=configs.tcp(port)), late, url=service.url)
            configs.tare(tmp_path)
            async with started("run", config, code=manager.code) as daemon:
                for word, times in (("READY=1", 1), ("WATCHDOG=1", 5), (WAITING, 1)):
                    assert await asyncio.to_thread(manager.until, word, times)
                outcome = await daemon.stop()
                assert await asyncio.to_thread(manager.until, "STOPPING=1")
    assert outcome.code == 0
    assert "late: not tared: the rest gaps are those of the configuration; " in outcome.err
    assert "bench: not tared" not in outcome.err
    assert manager.heard[0] == "READY=1"
