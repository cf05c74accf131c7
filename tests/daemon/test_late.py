"""What may come later, when the daemon starts: it starts, says what is missing, and uses it when it comes."""

import asyncio
import re
import socket
from pathlib import Path

import httpx2
import pytest

from free_ports import free_port
from own_names import own_names_in

from . import configs
from .devices import SerialDevice, pymodbus_server
from .lines import terminal
from .process import started
from .service import Service, serving

pytestmark = pytest.mark.anyio

LATE = configs.surface("late", source=configs.serial("/dev/none"))


async def missing(port: int, surface: str, value: int) -> str:
    """Wait until the metrics answer, and say so of a surface; return what they say of it."""
    async with asyncio.timeout(60), httpx2.AsyncClient(trust_env=False) as client:
        while True:
            try:
                text = (await client.get(f"http://127.0.0.1:{port}/metrics")).text
            except httpx2.ConnectError:
                text = ""
            if f'beamtouch_source_missing{{surface="{surface}"}} {value}.0' in text:
                return "\n".join(line for line in text.splitlines() if f'surface="{surface}"' in line)
            await asyncio.sleep(0.05)


async def test_what_is_missing_is_named_and_used_when_it_comes(tmp_path: Path) -> None:
    adapter = tmp_path / "tty"
    with socket.create_server(("127.0.0.1", 0)) as taken:
        port = taken.getsockname()[1]
        async with serving(Service()) as service, pymodbus_server([21_000, 65_535]) as device:
            config = configs.write(
                tmp_path,
                configs.surface(source=configs.tcp(device)),
                configs.surface("late", source=configs.serial(str(adapter))),
                url=service.url,
            )
            log = tmp_path / "mount" / "samples"
            text = config.read_text().replace("batch_ms", f'log_file = "{log}"\nbatch_ms')
            config.write_text(f"{text}\n[metrics]\nport = {port}\n")
            async with started("run", config) as daemon:
                await service.until(100)  # the other surface
                assert not service.samples("late")
                taken.close()
                await missing(port, "late", 1)
                await missing(port, "bench", 0)
                with terminal() as line:
                    SerialDevice(line)
                    adapter.symlink_to(line.path)
                    await service.until(100, "late")
                    await missing(port, "late", 0)
                    log.parent.mkdir()
                    service.problem_of = lambda _batch, _length: (503, "")
                    async with asyncio.timeout(60):
                        while not log.exists():  # noqa: ASYNC110 - the daemon is outside
                            await asyncio.sleep(0.05)
                    while "readings_per_second" not in (text := await missing(port, "late", 0)):  # noqa: ASYNC110
                        await asyncio.sleep(0.05)  # the daemon is outside
                    assert 'quality="good"' in text
                text = await missing(port, "late", 1)
                # Nothing is known of a device that is away.
                assert "channel_quality" not in text
                assert "readings_per_second" not in text
                outcome = await daemon.stop()
    assert outcome.code == 0
    said = outcome.err.splitlines()
    # Every line of the log says when.
    assert all(re.match(r"\d{4}-\d\d-\d\d \d\d:\d\d:\d\d,\d{3} [A-Z]+ ", line) for line in said[:-2])
    for words in (
        f"late: {adapter} cannot be opened (No such file or directory); plug the device in or correct the path",
        f"metrics: port {port} on 127.0.0.1: in use",
        f"{log} cannot be opened",
    ):
        assert sum(words in line for line in said) >= 1


async def test_names_that_do_not_resolve_are_waited_for(tmp_path: Path) -> None:
    names, port = own_names_in(tmp_path), free_port()
    async with serving(Service()) as service, pymodbus_server([21_000, 65_535]) as device:
        url = service.url.replace("127.0.0.1", "service.plant")
        config = configs.write(tmp_path, configs.surface(source=configs.tcp(device, "module.plant")), url=url)
        config.write_text(f"{config.read_text()}\n[metrics]\nport = {port}\n")
        async with started("run", config, prefix=names.prefix) as daemon:
            await missing(port, "bench", 1)
            names.add("module.plant", "127.0.0.1")
            await missing(port, "bench", 0)
            names.add("service.plant", "127.0.0.1")
            await service.until(20)
            outcome = await daemon.stop()
    assert outcome.code == 0
    assert outcome.err.count("module.plant does not resolve") == 1
    assert "no such host is known" in outcome.err


async def test_a_line_of_the_status_names_the_surfaces_without_a_device(tmp_path: Path) -> None:
    config = configs.write(tmp_path, configs.surface(), LATE, url=f"http://127.0.0.1:{free_port()}")
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as manager:
        manager.bind(str(tmp_path / "notify"))
        manager.settimeout(60)
        async with started("run", config, environment={"NOTIFY_SOCKET": str(tmp_path / "notify")}) as daemon:
            while b"waiting for the device of bench, late" not in await asyncio.to_thread(manager.recv, 4096):
                pass
            assert (await daemon.stop()).code == 0
