"""`check --wait`: until readings arrive and the service takes samples; and the digits of what `check` prints."""

import asyncio
import json
import sys
from pathlib import Path

import httpx2
import pytest

from beamtouch_daemon.commands.check import counts_text, decimals_of, rounded
from free_ports import free_port
from plain_http import TIMEOUT_S
from service.small_model import BEAM, write_model

from . import configs
from .devices import SerialDevice, pymodbus_server
from .lines import terminal
from .process import Outcome, command, started
from .service import TOKEN, real_service

pytestmark = pytest.mark.anyio


@pytest.fixture(scope="module")
def model(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The file of a model of the surface `bench` with four channels."""
    return write_model(tmp_path_factory.mktemp("model"), "bench", channels=4)


def bench(source: str, channels: int = 4) -> str:
    return configs.surface(source=source, registers=tuple(range(channels)))


def written(folder: Path, url: str, source: str, channels: int = 4, token: str = TOKEN) -> Path:
    path = configs.write(folder, bench(source, channels), url=url)
    (folder / "beamtouch.token").write_text(token)
    return path


async def waited(config: Path, seconds: float) -> Outcome:
    return await command("check", config, "--wait", str(seconds))


async def waits_for(config: Path, text: str) -> bool:
    """Start to wait; return whether this is soon among the reasons."""
    program = [sys.executable, "-m", "beamtouch_daemon", "check", str(config), "--wait", "300"]
    process = await asyncio.create_subprocess_exec(*program, stderr=asyncio.subprocess.PIPE)
    assert process.stderr is not None
    try:
        async with asyncio.timeout(240):
            async for line in process.stderr:
                if text in line.decode():
                    return True
        return False
    finally:
        process.kill()
        await process.wait()


async def test_it_waits_for_the_device_and_for_the_real_service(tmp_path: Path, model: Path) -> None:
    device, serving = free_port(), free_port()
    config = written(tmp_path, f"http://127.0.0.1:{serving}", configs.tcp(device))
    async with (
        started("check", config, "--wait", "300") as waiting,
        real_service(tmp_path, model, port=serving),
        pymodbus_server([20_000, 21_000, 20_000, 20_000], port=device),
    ):
        outcome = await waiting.end()
    assert outcome.code == 0, outcome.err
    assert outcome.err.startswith("waiting: bench: ")
    assert outcome.out.splitlines()[1].split() == ["bench", "s1", "20000", "2.5000", "0.0000", "good"]


async def test_it_waits_for_a_serial_port_that_does_not_exist_yet(tmp_path: Path, model: Path) -> None:
    port = tmp_path / "ttyUSB0"
    async with real_service(tmp_path, model) as url:
        config = written(tmp_path, url, configs.serial(str(port)))
        with terminal() as line:
            SerialDevice(line, channels=4)
            async with started("check", config, "--wait", "300", "--json") as waiting:
                await asyncio.sleep(0)
                port.symlink_to(line.path)
                outcome = await waiting.end()
    assert outcome.code == 0, outcome.err
    assert json.loads(outcome.out)["surfaces"]["bench"]["service"] == "takes samples"


async def test_what_is_still_wrong_at_the_end_is_reported(tmp_path: Path) -> None:
    url = f"http://127.0.0.1:{free_port()}"
    outcome = await waited(written(tmp_path, url, configs.tcp(free_port())), 0)
    assert outcome.code == 1
    reading, sending = outcome.err.splitlines()
    assert reading.startswith("beamtouch-daemon: bench: no connection to 127.0.0.1:")
    assert sending.startswith(f"beamtouch-daemon: bench: no answer from the service at {url} (")


@pytest.mark.parametrize(
    ("channels", "name", "token", "said"),
    [
        (4, "bench", "another-token-of-the-tests", "status 401: wrong token; correct publish.token_file"),
        (4, "press", TOKEN, "status 404: "),
        (2, "bench", TOKEN, "needs channels s1, s2, s3, s4; s3, s4 not in the configuration"),
    ],
)
async def test_a_service_that_takes_no_samples_is_reported(
    tmp_path: Path, model: Path, channels: int, name: str, token: str, said: str
) -> None:
    async with real_service(tmp_path, model) as url, pymodbus_server([20_000] * 4) as port:
        config = written(tmp_path, url, configs.tcp(port), channels, token)
        config.write_text(config.read_text().replace("surfaces.bench", f"surfaces.{name}"))
        assert await waits_for(config, said)


async def test_it_needs_the_token_that_writes_and_changes_no_answer(tmp_path: Path, model: Path) -> None:
    (tmp_path / "read").write_text("another-token-for-reading")
    async with (
        real_service(tmp_path, model, "--read-token-file", tmp_path / "read") as url,
        pymodbus_server([20_000] * 4) as port,
    ):
        good = await waited(written(tmp_path, url, configs.tcp(port)), 300)
        reads = written(tmp_path, url, configs.tcp(port), token="another-token-for-reading")  # noqa: S106 - of tests
        assert await waits_for(reads, "This is the read token")
        headers = {"Authorization": f"Bearer {TOKEN}"}
        async with httpx2.AsyncClient(base_url=url, headers=headers, trust_env=False, timeout=TIMEOUT_S) as http:
            samples = (await http.get("/surfaces/bench")).json()["samples"]
    assert good.code == 0, good.err
    assert samples["accepted"] == 0


@pytest.mark.parametrize("states_beam", [False, True])
async def test_a_configuration_without_beam_is_told_what_to_write(
    tmp_path: Path, model: Path, *, states_beam: bool
) -> None:
    async with real_service(tmp_path, model) as url, pymodbus_server([20_000] * 4) as port:
        config = written(tmp_path, url, configs.tcp(port))
        if states_beam:
            config.write_text(config.read_text().replace("rate_hz", f'beam = "{BEAM}"\nrate_hz', 1))
        told = await waited(config, 300)
    assert told.code == 0, told.err
    words = "surfaces.bench states no beam, so a model of another beam would pass unnoticed; if the service's model "
    assert (words in told.out) is not states_beam
    assert (f'is the right one, write beam = "{BEAM}"' in told.out) is not states_beam


async def test_without_wait_the_service_is_not_asked_and_check_says_so(tmp_path: Path) -> None:
    async with pymodbus_server([20_000] * 4) as port:
        config = written(tmp_path, f"http://127.0.0.1:{free_port()}", configs.tcp(port))
        outcome, told = await command("check", config, "--json"), await command("check", config)
    assert (outcome.code, told.code) == (0, 0)
    assert json.loads(outcome.out)["surfaces"]["bench"]["service"] is None
    assert told.out.endswith("The service was not asked whether it takes these samples; check --wait 5 asks it.\n")


async def test_json_has_no_more_digits_than_the_sensor(tmp_path: Path) -> None:
    async with pymodbus_server([20_001, 21_000, 20_000, 20_000]) as port:
        config = written(tmp_path, "http://127.0.0.1:1", configs.tcp(port))
        config.write_text(config.read_text().replace("-0.0001", "-0.00011"))
        outcome = await command("check", config, "--json")
        config.write_text(config.read_text().replace("rate_hz", "noise_mm = 0.002\nrate_hz", 1))
        noisy = await command("check", config, "--json")
    assert '"counts": 20001, "gap_mm": 2.2999, "deflection_mm": 0.2001' in outcome.out
    assert '"gap_mm": 2.3, "deflection_mm": 0.2,' in noisy.out


@pytest.mark.parametrize(
    ("step_mm", "noise_mm", "decimals"),
    [(1e-4, None, 4), (1e-4, 0.001, 3), (7.3e-4, 2e-4, 4), (2e-7, 3e-5, 5), (1e-12, None, 6), (5.0, None, 0)],
)
def test_a_length_has_the_decimals_of_the_step_or_of_the_noise(
    step_mm: float, noise_mm: float | None, decimals: int
) -> None:
    assert decimals_of(step_mm, noise_mm) == decimals


def test_counts_and_lengths_read_as_numbers() -> None:
    assert [
        counts_text(one)
        for one in (20_000, 4_294_967_295.0, 20_000.333333333332, 0.1 + 0.2, -5.0, 12_345_678.5, 0.00002)
    ] == [
        "20000",
        "4294967295",
        "20000.33",
        "0.3",
        "-5",
        "12345678",
        "0.00002",
    ]
    assert str(rounded(-0.00001, 4)) == "0.0"
