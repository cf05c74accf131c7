"""Turns of the event loop between the requests of OPC UA clients, which may send any number at once."""

import asyncio
from collections.abc import Iterator
from contextlib import contextmanager
from time import monotonic

import pytest
from asyncua import Client, Server, ua
from asyncua.common.utils import Buffer
from asyncua.crypto.permission_rules import User

from beamtouch_service.outputs.opcua.door import Door, Sessions
from beamtouch_service.outputs.opcua.security import Clients
from beamtouch_service.outputs.opcua.turns import Turns
from support.network.free_ports import free_port

AT_ONCE = 50
"""Requests that a client sends without waiting for an answer."""
TIMEOUT_S = 120
SERVER = ua.BrowseDescription(
    ua.NodeId(ua.ObjectIds.Server), ua.BrowseDirection.Both, ua.NodeId(ua.ObjectIds.References), IncludeSubtypes=True
)


class Counting(Door):
    """A door that counts the requests before it."""

    requests = 0

    def check_validity(self, user: User, action_type: ua.NodeId, body: Buffer) -> bool:
        self.requests += 1
        return super().check_validity(user, action_type, body)


@contextmanager
def ticking(door: Counting) -> Iterator[list[int]]:
    """Give the number of requests in each turn of the event loop."""
    counts = list[int]()

    async def tick() -> None:
        while True:
            before = door.requests
            await asyncio.sleep(0)
            counts.append(door.requests - before)

    ticker = asyncio.ensure_future(tick())
    try:
        yield counts
    finally:
        ticker.cancel()


@pytest.mark.promise("docs/how-to/opcua.md", "one request of all clients at a time")
def test_the_service_goes_on_between_any_two_requests_of_clients_that_send_many_at_once() -> None:
    async def ask() -> list[int]:
        sessions = Sessions(Clients(None, None, None, are_encrypted=False))
        door, url = Counting(sessions), f"opc.tcp://127.0.0.1:{free_port()}/"
        server = Server(iserver=sessions)
        await server.init()
        server.set_endpoint(url)
        server.set_security_policy([ua.SecurityPolicyType.NoSecurity], permission_ruleset=door)
        await door.guard(server)
        asked = ua.BrowseParameters(NodesToBrowse=[SERVER])
        clients = [Client(url, timeout=TIMEOUT_S, watchdog_intervall=TIMEOUT_S) for _ in range(2)]
        async with server, clients[0], clients[1]:
            with ticking(door) as counts:
                requests = [client.uaclient.session.browse(asked) for client in clients for _ in range(AT_ONCE)]
                answers = await asyncio.gather(*requests)
        assert all(result.StatusCode.is_good() and result.References for (result,) in answers)
        return counts

    counts = asyncio.run(ask())
    assert sum(counts) >= 2 * AT_ONCE
    assert max(counts) == 1


@pytest.mark.promise("docs/how-to/opcua.md", "and after it rests for as long as that took")
def test_the_rest_of_the_service_has_as_much_time_as_the_messages_of_all_connections() -> None:
    async def work() -> tuple[float, float]:
        turns, spent_s = Turns(), list[float]()

        async def serve() -> None:
            for _ in range(5):
                await turns.wait()
                begun_s = monotonic()
                while monotonic() < begun_s + 0.01:
                    pass
                spent_s.append(monotonic() - begun_s)
                turns.note(begun_s)

        begun_s = monotonic()
        await asyncio.gather(*(serve() for _ in range(3)))
        await turns.wait()
        return sum(spent_s), monotonic() - begun_s

    spent_s, all_s = asyncio.run(work())
    assert all_s > 1.9 * spent_s
