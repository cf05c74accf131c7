"""The OPC UA server of a surface whose model comes later, and has other axes than a beam."""

import asyncio

import pytest
from asyncua import Client, ua

from beamtouch_service.access import Access
from beamtouch_service.outputs.opcua.section import OpcUaSection
from beamtouch_service.outputs.opcua.server import make
from beamtouch_service.outputs.opcua.turns import Transports
from beamtouch_service.surfaces.surface import Surface
from service.bench import Bench
from support.network.free_ports import free_port

TIMEOUT_S = 120
ANSWER_S = 10
"""Time for one answer to a client. The library waits all of it where the connection ended as soon as it was made, as
one does that comes just when the server ends."""


class Changing(Surface):
    """A surface with axes that a test sets."""

    own: tuple[str, ...] = ("position",)

    @property
    def axes(self) -> tuple[str, ...]:
        return self.own


@pytest.mark.soak
@pytest.mark.promise("docs/how-to/opcua.md", "the server begins anew with its variables")
def test_a_surface_that_gets_other_axes_gets_their_variables() -> None:
    port, surface = free_port(), Changing("press-7")
    bench, output = Bench(surface), make(OpcUaSection(port=port), ["press-7"], Access())

    async def status_of(name: str) -> str:
        async with Client(f"opc.tcp://127.0.0.1:{port}/", timeout=ANSWER_S) as client:
            node = ua.NodeId(f"press-7/{name}", await client.get_namespace_index("urn:beamtouch"))
            asked = ua.ReadValueId(node, ua.AttributeIds.Value)
            (found,) = await client.uaclient.session.read(ua.ReadParameters(NodesToRead=[asked]))
            return str(found.StatusCode.name)

    async def wait_for(name: str, wanted: str) -> None:
        while True:
            try:
                if await status_of(name) == wanted:
                    return
            except (OSError, ua.UaError):  # it begins anew
                pass
            await asyncio.sleep(0.1)

    async def change() -> None:
        serving = asyncio.ensure_future(output.run(bench.app.context))
        async with asyncio.timeout(TIMEOUT_S):
            await wait_for("position_mm", "BadConfigurationError")
            surface.own = ("x", "y")
            await wait_for("x_mm", "BadConfigurationError")
            await wait_for("position_mm", "BadNodeIdUnknown")
        serving.cancel()
        await asyncio.wait([serving])

    asyncio.run(change())


def test_a_connection_that_comes_while_the_server_ends_is_closed_like_those_before_it() -> None:
    transports, made = Transports(max_pending=1), asyncio.Event()

    class Connection(asyncio.Protocol):
        messages: asyncio.Queue[object] | None = None

        def connection_made(self, transport: asyncio.BaseTransport) -> None:
            transports.append(transport)
            made.set()

    async def read_both() -> list[bytes]:
        server = await asyncio.get_running_loop().create_server(Connection, "127.0.0.1", 0)
        address = server.sockets[0].getsockname()
        async with asyncio.timeout(TIMEOUT_S), server:
            before, first = await asyncio.open_connection(*address)
            await made.wait()
            transports.end()
            after, second = await asyncio.open_connection(*address)
            read = [await reader.read() for reader in (before, after)]
            first.close()
            second.close()
        return read

    assert asyncio.run(read_both()) == [b"", b""]
