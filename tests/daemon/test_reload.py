"""SIGHUP: the configuration is read again while the daemon runs."""

import asyncio
import signal
from pathlib import Path

import pytest

from . import configs
from .devices import SerialDevice, pymodbus_server
from .lines import terminal
from .process import free_port, started, summary_of
from .service import Service, serving

pytestmark = pytest.mark.anyio


async def test_a_new_configuration_restarts_what_changed_and_a_wrong_one_changes_nothing(tmp_path: Path) -> None:
    with terminal() as line:
        SerialDevice(line)
        async with serving(Service()) as service, pymodbus_server([21_000, 65_535]) as port:
            one, other = (
                configs.surface("one", configs.tcp(port)),
                configs.surface("other", configs.serial(line.path)),
            )
            config = configs.write(tmp_path, one, other, url=service.url)
            async with started("run", config, "--summary", tmp_path / "summary.json") as daemon:
                await service.until(100, "one")
                await service.until(100, "other")
                good = config.read_text()
                config.write_text(good.replace("window", "windw"))
                daemon.tell(signal.SIGHUP)
                await service.until(len(service.samples("one")) + 100, "one")
                config.write_text(good.replace("rest_gap_mm = 2.5", "rest_gap_mm = 2.6", 1))
                daemon.tell(signal.SIGHUP)
                async with asyncio.timeout(60):
                    while not any(s.deflection_mm[0] == pytest.approx(0.2) for s in service.samples("one")):
                        await service.until(len(service.samples("one")) + 1, "one")
                await service.until(len(service.samples("other")) + 50, "other")
                outcome = await daemon.stop()
    assert outcome.code == 0
    boots = {
        name: list(dict.fromkeys(batch.boot_id for surface, batch, _ in service.batches if surface == name))
        for name in ("one", "other")
    }
    assert len(boots["one"]) == 2
    assert len(boots["other"]) == 1  # it went on undisturbed
    assert outcome.err.count("the new configuration is wrong, the old one stays in use: ") == 1
    assert "unknown key surfaces.one.filter.windw" in outcome.err
    assert "configuration read again; restarted: one\n" in outcome.err
    for name, counts in summary_of(tmp_path).items():
        assert counts["readings"] == counts["samples_published"] == len(service.record.whole(name))
        assert all(numbers == list(range(1, len(numbers) + 1)) for numbers in service.record.numbers(name).values())


async def test_a_new_publish_table_restarts_every_surface_and_what_needs_a_restart_is_named(tmp_path: Path) -> None:
    async with serving(Service()) as service, pymodbus_server([21_000, 65_535]) as port:
        surfaces = configs.surface("one", configs.tcp(port)), configs.surface("other", configs.tcp(port))
        config = configs.write(tmp_path, *surfaces, url=service.url)
        async with started("run", config, "--summary", tmp_path / "summary.json") as daemon:
            await service.until(20, "one")
            await service.until(20, "other")
            text = config.read_text().replace("batch_ms = 20", "batch_ms = 25\nlog_mb = 7")
            config.write_text(f"{text}\n[metrics]\nport = {free_port()}\n")
            daemon.tell(signal.SIGHUP)
            async with asyncio.timeout(60):
                while len({batch.boot_id for _, batch, _ in service.batches}) < 4:
                    await service.until(len(service.samples("one")) + 1, "one")
                    await service.until(len(service.samples("other")) + 1, "other")
            outcome = await daemon.stop()
    assert outcome.code == 0
    assert "configuration read again; restarted: one, other\n" in outcome.err
    assert "changes that need a restart of the daemon: publish.log_mb, metrics.port\n" in outcome.err
    for name, counts in summary_of(tmp_path).items():
        assert counts["readings"] == counts["samples_published"] == len(service.record.whole(name))
