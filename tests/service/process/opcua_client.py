"""A service with an OPC UA server, a client of it, and what that reads and is told."""

import asyncio
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from typing import Any

from asyncua import Client, Node, ua
from asyncua.common.events import Event
from asyncua.common.subscription import DataChangeNotif

from service.bench import PATIENT
from service.process.conftest import Service, StartService
from service.process.opcua_hello import is_open
from support.network.free_ports import free_port
from support.running.waiting import wait_until

TIMEOUT_S = 30


def start(start_press: StartService, stale_ms: float, options: str = "", code: str = "") -> tuple[Service, str]:
    """Start a service of press-7 with an OPC UA server, after this code; return it with the address of that."""
    port = free_port()
    zones = "[surfaces.press-7.zones.left]\nfrom_mm = 0\nto_mm = 300\n"
    service = start_press(
        code=f"{PATIENT}\n{code}", stale_ms=stale_ms, sections=f"{zones}[opcua]\nport = {port}\n{options}\n"
    )
    return service, f"opc.tcp://127.0.0.1:{port}/"


class Changes:
    """What a subscription gave, by variable."""

    def __init__(self) -> None:
        self.found: dict[str, list[Any]] = {}
        self.events: list[Any] = []

    def datachange_notification(self, node: Node, _value: object, data: DataChangeNotif) -> None:
        self.found.setdefault(str(node.nodeid.Identifier), []).append(data.monitored_item.Value)

    def event_notification(self, event: Event) -> None:
        self.events.append(event)

    def values(self, name: str) -> list[Any]:
        """Return the values of a variable of press-7, one after the other."""
        return [one.Value.Value for one in self.found.get(f"press-7/{name}", [])]


@asynccontextmanager
async def connected(url: str, user: str | None = None, password: str = "") -> AsyncIterator[Client]:
    """Give a client, as soon as the server is there."""
    # On a starved machine, the client would give up a server that answers late.
    client = Client(url, timeout=TIMEOUT_S, watchdog_intervall=TIMEOUT_S)
    if user is not None:
        client.set_user(user)
        client.set_password(password)
    await asyncio.to_thread(wait_until, lambda: is_open(url))
    async with client:
        yield client


async def read(client: Client, name: str = "press-7") -> dict[str, ua.DataValue]:
    """Return all variables of a surface, read at once."""
    index = await client.get_namespace_index("urn:beamtouch")
    surface = client.get_node(ua.NodeId(name, index))
    nodes = await surface.get_variables()
    names = [(await node.read_browse_name()).Name for node in nodes]
    return dict(zip(names, await client.read_attributes(nodes), strict=True))
