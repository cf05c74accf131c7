"""What the service is asked: whether it takes the samples, is of this beam, and sees a contact."""

import asyncio
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import httpx2
import pytest

from support.network.free_ports import free_port
from support.network.plain_http import TIMEOUT_S
from support.surfaces import configs
from support.surfaces.small_model import BEAM, write_model

from .devices import pymodbus_server
from .process import PATIENT_STOP, command, started, summary_of
from .service import TOKEN, contact_has, real_service, serving_model

pytestmark = pytest.mark.anyio

READ_TOKEN = "another-token-for-reading"  # noqa: S105 - of tests


@dataclass(frozen=True)
class Asked:
    """A running service with a model of four channels of the surface `bench`."""

    url: str
    model: Path


@pytest.fixture(scope="module")
def asked(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Asked]:
    folder = tmp_path_factory.mktemp("asked")
    (folder / "read").write_text(READ_TOKEN)
    model = write_model(folder, "bench", channels=4)
    with serving_model(folder, model, "--read-token-file", folder / "read") as url:
        yield Asked(url, model)


def written(folder: Path, url: str, source: str, channels: int = 4, token: str = TOKEN) -> Path:
    path = configs.write(folder, configs.surface(source=source, registers=tuple(range(channels))), url=url)
    (folder / "beamtouch.token").write_text(token)
    return path


@pytest.mark.promise(
    "docs/how-to/adc-module.md",
    "With `--wait 30` it waits up to 30 s until all channels arrive and the service takes samples",
)
async def test_check_waits_for_the_device_and_for_the_service(tmp_path: Path, asked: Asked) -> None:
    device, serving = free_port(), free_port()
    config = written(tmp_path, f"http://127.0.0.1:{serving}", configs.tcp(device))
    at_once = await command("check", config, "--wait", "0")
    async with (
        started("check", config, "--wait", "300") as waiting,
        real_service(tmp_path, asked.model, port=serving),
        pymodbus_server([20_000, 21_000, 20_000, 20_000], port=device),
    ):
        outcome = await waiting.end()
    assert outcome.code == 0, outcome.err
    assert outcome.err.startswith("waiting: bench: ")
    assert outcome.out.splitlines()[1].split() == ["bench", "s1", "20000", "2.5000", "0.0000", "good"]
    assert at_once.code == 1
    reading, sending = at_once.err.splitlines()
    assert reading.startswith("beamtouch-daemon: bench: no connection to 127.0.0.1:")
    assert sending.startswith(f"beamtouch-daemon: bench: no answer from the service at http://127.0.0.1:{serving} (")


@pytest.mark.parametrize(
    ("channels", "name", "token", "said"),
    [
        (4, "bench", "another-token-of-the-tests", "status 401: wrong token; correct publish.token_file"),
        (4, "bench", READ_TOKEN, "This is the read token"),
        (4, "press", TOKEN, "status 404: "),
        (2, "bench", TOKEN, "needs channels s1, s2, s3, s4; s3, s4 not in the configuration"),
    ],
)
async def test_a_service_that_takes_no_samples_is_reported(
    tmp_path: Path, asked: Asked, channels: int, name: str, token: str, said: str
) -> None:
    async with pymodbus_server([20_000] * 4) as port:
        config = written(tmp_path, asked.url, configs.tcp(port), channels, token)
        config.write_text(config.read_text().replace("surfaces.bench", f"surfaces.{name}"))
        async with asyncio.timeout(240), started("check", config, "--wait", "300") as waiting:
            assert (await waiting.said(said)).endswith(said)


@pytest.mark.promise("docs/how-to/troubleshooting.md", "`beamtouch-daemon check --wait 5` says what to write.")
async def test_a_service_that_takes_them_gets_none_and_a_configuration_without_beam_is_told_what_to_write(
    tmp_path: Path, asked: Asked
) -> None:
    async with pymodbus_server([20_000] * 4) as port:
        config = written(tmp_path, asked.url, configs.tcp(port))
        without = await command("check", config, "--wait", "300")
        config.write_text(config.read_text().replace("rate_hz", f'beam = "{BEAM}"\nrate_hz', 1))
        stated = await command("check", config, "--wait", "300")
    assert (without.code, stated.code) == (0, 0), without.err + stated.err
    words = "surfaces.bench states no beam, so a model of another beam would pass unnoticed; if the service's model "
    assert words in without.out
    assert f'is the right one, write beam = "{BEAM}"' in without.out
    assert words not in stated.out
    headers = {"Authorization": f"Bearer {TOKEN}"}
    async with httpx2.AsyncClient(base_url=asked.url, headers=headers, trust_env=False, timeout=TIMEOUT_S) as http:
        assert (await http.get("/surfaces/bench")).json()["samples"]["accepted"] == 0


@pytest.mark.promise("docs/how-to/upgrade.md", "and the daemon keeps them.")
@pytest.mark.promise(
    "docs/reference/daemon-configuration.md",
    "the service refuses samples of another beam than that of its model.",
)
async def test_samples_of_another_beam_wait_until_a_model_of_their_beam_is_there(tmp_path: Path) -> None:
    own = write_model(tmp_path, "bench", channels=4, beam="beam-1")
    (tmp_path / "other").mkdir()
    other = write_model(tmp_path / "other", "bench", channels=4, beam="beam-2")
    serving = free_port()
    async with pymodbus_server([20_000] * 4) as port:
        config = written(tmp_path, f"http://127.0.0.1:{serving}", configs.tcp(port))
        config.write_text(config.read_text().replace("rate_hz", 'beam = "beam-1"\nrate_hz', 1))
        async with started("run", config, "--summary", tmp_path / "summary.json", code=PATIENT_STOP) as daemon:
            async with real_service(tmp_path, other, port=serving) as url:
                await contact_has(url, "type", "urn:beamtouch:problem:other-beam")
                told = await command("check", config, "--wait", "0")
            async with real_service(tmp_path, own, port=serving) as url:
                await contact_has(url, "state", "clear")
                outcome = await daemon.stop()
    assert (told.code, told.complaint()) == (
        1,
        "bench: the service's model is of beam beam-2, but surfaces.bench.beam is beam-1: give the service the model "
        "of beam-1, or use the configuration that was built with its model",
    )
    assert "the service takes no samples (status 503: The samples are of beam beam-1, the model is of " in outcome.err
    counts = summary_of(tmp_path)["bench"]
    assert counts["samples_dropped"] == 0
    assert (counts["samples_published"], counts["samples_in_log"]) == (counts["readings"], 0)


@pytest.mark.promise(
    "docs/explanation/readings-to-samples.md",
    "`tare` also asks the service, and refuses while that sees a contact",
)
async def test_tare_refuses_a_beam_on_which_the_service_sees_a_contact(tmp_path: Path, asked: Asked) -> None:
    serving = free_port()
    async with pymodbus_server([20_900] * 4) as port:  # 0.09 mm down
        config = written(tmp_path, f"http://127.0.0.1:{serving}", configs.tcp(port))
        async with started("run", config), real_service(tmp_path, asked.model, port=serving) as url:
            await contact_has(url, "state", "contact")
            refused = await command("tare", config)
            accepted = await command("tare", config, "--accept-change")
    assert refused.code == 1
    assert refused.complaint().startswith("bench: not tared: the service sees a contact of 3.6 N at ")
    assert accepted.code == 0, accepted.err
    assert "the service sees a contact of 3.6 N at " in accepted.out
