"""Names of hosts that no host can have are wrong input, in every place where one is stated."""

from pathlib import Path

import pytest

from beamtouch_common.errors import InputError
from beamtouch_daemon.config.file import load_config

from . import configs
from .process import command

pytestmark = pytest.mark.anyio

WRONG = ["plc..plant", "plc" * 30, "a b", "plc\\u0000", "plc,other"]
ADDRESSES = ["192.168.0.20:502", "plc:502", "[::1]", "tcp://plc", "plc/", "daemon@plc"]
"""More than a host."""


def complaint(path: Path) -> str:
    with pytest.raises(InputError) as caught:
        load_config(path)
    return str(caught.value)


@pytest.mark.parametrize("host", [*WRONG, *ADDRESSES])
def test_a_host_of_a_device_is_refused(tmp_path: Path, host: str) -> None:
    path = configs.write(tmp_path, configs.surface(source=configs.tcp(502, host)))
    assert ": surfaces.bench.source.host: must be the name or address of a host" in complaint(path)
    channel = configs.surface().replace("register = 1", f'register = 1\nhost = "{host}"')
    assert ": surfaces.bench.channels[1].host: must be the name" in complaint(configs.write(tmp_path, channel))


@pytest.mark.parametrize("host", [*WRONG, "daemon@beams", "daemon:secret@beams"])
async def test_an_address_of_the_service_is_refused(tmp_path: Path, host: str) -> None:
    path = configs.write(tmp_path, configs.surface(), url=f"http://{host}:8420")
    said = await command("check", path, "--wait", "0")
    assert (said.code, said.out) == (2, "")
    assert f"{path}: publish.url: must " in said.complaint()


@pytest.mark.parametrize("host", ["192.168.0.20", "::1", "fe80::1%eth0", "plc", "plc.plant.", "prüfstand.example"])
def test_a_host_that_can_be_is_taken(tmp_path: Path, host: str) -> None:
    config = load_config(configs.write(tmp_path, configs.surface(source=configs.tcp(502, host))))
    assert getattr(config.surfaces["bench"].source, "host", None) == host
