"""A tare while the service sees something that is no single contact: it is no rest either."""

from pathlib import Path

import pytest

from support.network.free_ports import free_port
from support.surfaces import configs
from support.surfaces.small_model import write_model

from .devices import pymodbus_server
from .process import command, started
from .service import contact_has, real_service

pytestmark = pytest.mark.anyio

PULLED = [20_000, 19_500, 20_500, 20_000]
"""s2 is 0.05 mm up and s3 as far down: within what a tare takes, and no contact."""


@pytest.mark.promise("docs/explanation/readings-to-samples.md", "or something unexplained.")
async def test_tare_refuses_a_beam_on_which_the_service_sees_what_it_cannot_explain(tmp_path: Path) -> None:
    port_of_service = free_port()
    model = write_model(tmp_path, "bench", channels=4)
    async with pymodbus_server(PULLED) as port:
        surface = configs.surface(source=configs.tcp(port), registers=(0, 1, 2, 3))
        config = configs.write(tmp_path, surface, url=f"http://127.0.0.1:{port_of_service}")
        async with started("run", config), real_service(tmp_path, model, port=port_of_service) as url:
            await contact_has(url, "state", "unexplained")
            refused = await command("tare", config)
            accepted = await command("tare", config, "--accept-change")
    assert refused.code == 1
    assert refused.complaint().startswith(
        "bench: not tared: the service sees something that it cannot explain; take everything off the beam"
    )
    assert accepted.code == 0, accepted.err
    assert accepted.out.splitlines()[1].endswith("; the service sees something that it cannot explain")
