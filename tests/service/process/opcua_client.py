"""A client of the OPC UA server of a service, and what it reads."""

import asyncio
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager

from asyncua import Client, ua

from service.process.opcua_hello import is_open
from support.running.waiting import wait_until

TIMEOUT_S = 30


@asynccontextmanager
async def connected(url: str, user: str | None = None, password: str = "") -> AsyncIterator[Client]:
    """Give a client, as soon as the server is there."""
    client = Client(url, timeout=TIMEOUT_S)
    if user is not None:
        client.set_user(user)
        client.set_password(password)
    await asyncio.to_thread(wait_until, lambda: is_open(url))
    async with client:
        yield client


async def read(client: Client) -> dict[str, ua.DataValue]:
    """Return all variables of press-7, read at once."""
    index = await client.get_namespace_index("urn:beamtouch")
    surface = client.get_node(ua.NodeId("press-7", index))
    nodes = await surface.get_variables()
    names = [(await node.read_browse_name()).Name for node in nodes]
    return dict(zip(names, await client.read_attributes(nodes), strict=True))
