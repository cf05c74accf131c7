"""The service below a path of a real proxy: all that the daemon asks of it goes there."""

import subprocess
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest

from support.network.balancer import answers
from support.network.free_ports import free_port
from support.running.debian_parts import require
from support.running.waiting import wait_until
from support.surfaces import configs
from support.surfaces.small_model import BEAM, write_model

from .devices import pymodbus_server
from .process import PATIENT_STOP, command, started, summary_of
from .service import contact_has, real_service

pytestmark = pytest.mark.anyio

PROXY = """
defaults
    mode http
    timeout connect 5s
    timeout client 60s
    timeout server 60s
frontend plant
    bind 127.0.0.1:{port}
    http-request deny deny_status 404 unless {{ path_beg /press/hall-1/ }}
    http-request replace-path /press/hall-1(/.*) \\1
    default_backend service
backend service
    server one {service}
"""


@contextmanager
def below_a_path(folder: Path, service: str) -> Iterator[str]:
    """Run HAProxy, which serves a service below a path and knows no other; gives its address without the path."""
    port, path = free_port(), folder / "haproxy.cfg"
    path.write_text(PROXY.format(port=port, service=service.rpartition("/")[2]))
    quiet = subprocess.DEVNULL
    process = subprocess.Popen([require("haproxy", "haproxy"), "-f", path], stdin=quiet, stdout=quiet, stderr=quiet)
    try:
        wait_until(lambda: answers(f"http://127.0.0.1:{port}/press/hall-1"))
        yield f"http://127.0.0.1:{port}"
    finally:
        process.terminate()
        process.wait(60)


@pytest.mark.promise("docs/how-to/two-hosts.md", "`check` says in one line if nothing is there.")
@pytest.mark.promise("docs/reference/daemon-configuration.md", "with a path if a proxy serves it below one")
async def test_run_check_and_tare_reach_a_service_below_a_path_and_a_wrong_path_is_named(tmp_path: Path) -> None:
    model = write_model(tmp_path, "bench", channels=4)
    async with pymodbus_server([20_900] * 4) as port, real_service(tmp_path, model) as service:
        surface = configs.surface(source=configs.tcp(port), registers=(0, 1, 2, 3))
        surface = surface.replace("rate_hz", f'beam = "{BEAM}"\nrate_hz', 1)
        with below_a_path(tmp_path, service) as proxy:
            config = configs.write(tmp_path, surface, url=f"{proxy}/press/hall-1/")
            checked = await command("check", config, "--wait", "300")
            async with started("run", config, "--summary", tmp_path / "summary.json", code=PATIENT_STOP) as daemon:
                await contact_has(service, "state", "contact")
                while (tared := await command("tare", config)).code == 0:
                    pass  # on a starved machine, the contact was stale
                assert (await daemon.stop()).code == 0
            wrong = await command("check", configs.write(tmp_path, surface, url=f"{proxy}/press"), "--wait", "0")
            direct = await command("check", configs.write(tmp_path, surface, url=f"{service}/hall"), "--wait", "0")
    assert checked.code == 0, checked.err
    assert tared.complaint().startswith("bench: not tared: the service sees a contact of ")
    counts = summary_of(tmp_path)["bench"]
    assert counts["samples_published"] == counts["readings"] > 0
    said = "takes no samples: status 404: no service is there; is the path in publish.url the one that the proxy passes"
    assert said in wrong.complaint()
    assert said in direct.complaint()
