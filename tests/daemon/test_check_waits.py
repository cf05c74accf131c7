"""`check --wait`: a surface is there once all of its channels arrive, not once the first unit answers."""

import asyncio
from pathlib import Path

import pytest

from support.surfaces import configs
from support.surfaces.small_model import BEAM, write_model

from .devices import pymodbus_server
from .process import Daemon, started
from .service import real_service
from .waits import until

pytestmark = pytest.mark.anyio

OTHER = "127.0.0.2"
READINGS = 30
"""Of a look, at most."""


def write(folder: Path, port: int, url: str) -> Path:
    """Write the configuration of a surface whose fourth channel is in another module."""
    source = configs.tcp(port).replace("30_000", "5_000")
    surface = configs.surface(source=source, registers=(0, 1, 2, 0), rate_hz=10.0)
    head, _, last = surface.rpartition("register = 0\n")
    surface = f'{head}register = 0\nhost = "{OTHER}"\n{last}'
    return configs.write(folder, surface.replace("rate_hz", f'beam = "{BEAM}"\nrate_hz', 1), url=url)


async def line_of(check: Daemon, words: str) -> None:
    async with asyncio.timeout(60):
        assert words in await check.said(words)


async def test_check_waits_for_the_unit_that_comes_last(tmp_path: Path) -> None:
    polls = 0

    async def count(*_: object) -> None:
        nonlocal polls
        polls += 1

    async with (
        real_service(tmp_path, write_model(tmp_path, "bench", channels=4)) as url,
        pymodbus_server([20_000, 20_500, 21_000], count) as port,
    ):
        config = write(tmp_path, port, url)
        async with started("check", config, "--wait", "0") as at_once:
            refused = await at_once.end()
        async with started("check", config, "--wait", "300") as waiting:
            await line_of(waiting, "waiting: bench: not all channels arrive")
            begun = polls
            await until(lambda: polls >= begun + 3 * READINGS)
            async with pymodbus_server([21_500], port=port, host=OTHER):
                outcome = await waiting.end()
    assert refused.code == 1
    assert "s4 missing: the device sent no value" in refused.err
    assert outcome.code == 0, outcome.err
    assert "waiting" not in outcome.err, "it says the same once, however often it looks"
    assert [line.split()[1:3] for line in outcome.out.splitlines()[1:5]] == [
        ["s1", "20000"],
        ["s2", "20500"],
        ["s3", "21000"],
        ["s4", "21500"],
    ]
