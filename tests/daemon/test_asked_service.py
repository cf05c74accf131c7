"""What the service is asked: whether its model is of the beam of the configuration, and whether it sees a contact."""

import asyncio
from pathlib import Path

import httpx2
import pytest

from free_ports import free_port
from plain_http import TIMEOUT_S
from service.small_model import write_model

from . import configs
from .devices import pymodbus_server
from .process import PATIENT_STOP, command, started, summary_of
from .service import real_service

pytestmark = pytest.mark.anyio


async def until_complete(url: str) -> None:
    """Wait until the service has every sample that the daemon has numbered."""
    async with httpx2.AsyncClient(base_url=url, trust_env=False, timeout=TIMEOUT_S) as http, asyncio.timeout(60):
        while True:
            accepted = (await http.get("/surfaces/bench")).json()["samples"]["accepted"]
            newest = (await http.get("/contact")).json().get("sequence")
            if newest is not None and accepted >= newest:  # on a busy machine a contact may be stale
                return
            await asyncio.sleep(0.01)


async def until(url: str, name: str, value: str) -> None:
    """Wait until the contact has a member of this value."""
    async with httpx2.AsyncClient(base_url=url, trust_env=False, timeout=TIMEOUT_S) as http, asyncio.timeout(60):
        while True:
            if (await http.get("/contact")).json().get(name) == value:
                return
            await asyncio.sleep(0.05)


async def test_samples_of_another_beam_wait_until_a_model_of_their_beam_is_there(tmp_path: Path) -> None:
    own = write_model(tmp_path, "bench", channels=4, beam="beam-1")
    (tmp_path / "other").mkdir()
    other = write_model(tmp_path / "other", "bench", channels=4, beam="beam-2")
    serving = free_port()
    async with pymodbus_server([20_000] * 4) as port:
        surface = configs.surface(source=configs.tcp(port), registers=(0, 1, 2, 3))
        surface = surface.replace("rate_hz", 'beam = "beam-1"\nrate_hz', 1)
        config = configs.write(tmp_path, surface, url=f"http://127.0.0.1:{serving}")
        async with started("run", config, "--summary", tmp_path / "summary.json", code=PATIENT_STOP) as daemon:
            async with real_service(tmp_path, other, port=serving) as url:
                await until(url, "type", "urn:beamtouch:problem:other-beam")
                told = await command("check", config, "--wait", "0")
            async with real_service(tmp_path, own, port=serving) as url:
                await until(url, "state", "clear")
                await until_complete(url)
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


async def test_tare_refuses_a_beam_on_which_the_service_sees_a_contact(tmp_path: Path) -> None:
    model, serving = write_model(tmp_path, "bench", channels=4), free_port()
    async with pymodbus_server([20_900] * 4) as port:  # 0.09 mm down
        surface = configs.surface(source=configs.tcp(port), registers=(0, 1, 2, 3))
        config = configs.write(tmp_path, surface, url=f"http://127.0.0.1:{serving}")
        async with started("run", config), real_service(tmp_path, model, port=serving) as url:
            await until(url, "state", "contact")
            refused = await command("tare", config)
            accepted = await command("tare", config, "--accept-change")
    assert refused.code == 1
    assert refused.complaint().startswith("bench: not tared: the service sees a contact of 3.6 N at ")
    assert accepted.code == 0, accepted.err
    assert "the service sees a contact of 3.6 N at " in accepted.out
