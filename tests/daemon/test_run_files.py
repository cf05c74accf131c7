"""The token and the log file from elsewhere than the configuration says, as the unit file does it."""

from pathlib import Path

import pytest

from . import configs
from .devices import pymodbus_server
from .process import command, started
from .service import TOKEN, Service, serving

pytestmark = pytest.mark.anyio


async def test_files_of_the_command_line_override_the_configuration(tmp_path: Path) -> None:
    elsewhere = tmp_path / "elsewhere"
    elsewhere.mkdir()
    token, log = elsewhere / "token", elsewhere / "samples"
    token.write_text(f"{TOKEN}\n")
    async with serving(Service()) as service, pymodbus_server([21_000, 65_535]) as port:
        config = configs.write(tmp_path, configs.surface(source=configs.tcp(port)), url=service.url)
        (tmp_path / "beamtouch.token").unlink()
        async with started("run", config, "--token-file", token, "--sample-log-file", log) as daemon:
            await service.until(20)
            outcome = await daemon.stop()
    assert outcome.code == 0
    assert log.exists()
    assert not (tmp_path / "beamtouch-daemon.samples").exists()


async def test_a_token_file_of_the_command_line_that_is_missing_is_named(tmp_path: Path) -> None:
    config = configs.write(tmp_path, configs.surface())
    outcome = await command("run", config, "--token-file", tmp_path / "none")
    assert outcome.code == 1
    assert str(tmp_path / "none") in outcome.complaint()
