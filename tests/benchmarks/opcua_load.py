"""Subscribes over OPC UA: `opcua_load.py PORT SURFACE CLIENTS SECONDS`, each client to all variables at 100 ms.

With the time of the server, a surface with six zones has 20 variables. Prints a line once all have subscribed, and then
the values that came per second and the percentiles of the age of a sample when its number arrives, as JSON.
"""

import asyncio
import json
import sys
from time import perf_counter, time
from typing import Any

from asyncua import Client, Node, ua

INTERVAL_MS = 100
TIMEOUT_S = 60


class Arrivals:
    """What the subscriptions of all clients gave."""

    def __init__(self) -> None:
        self.values = 0
        self.ages_s: list[float] = []

    def datachange_notification(self, node: Node, _value: object, data: Any) -> None:  # noqa: ANN401  # the library's
        """Count a value; called by the library."""
        self.values += 1
        if str(node.nodeid.Identifier).endswith("/sequence"):
            self.ages_s.append(time() - data.monitored_item.Value.SourceTimestamp.timestamp())


async def subscribe(port: int, surface: str, arrivals: Arrivals) -> Client:
    """Connect a client, and subscribe to the surface."""
    client = Client(f"opc.tcp://127.0.0.1:{port}/", timeout=TIMEOUT_S, watchdog_intervall=TIMEOUT_S)
    client.session_timeout = 600_000  # as much as the server gives; the library warns if it gives less than asked for
    await client.connect()
    index = await client.get_namespace_index("urn:beamtouch")
    nodes = await client.get_node(ua.NodeId(surface, index)).get_variables()
    nodes.append(client.get_node(ua.ObjectIds.Server_ServerStatus_CurrentTime))
    subscription = await client.create_subscription(INTERVAL_MS, arrivals)
    await subscription.subscribe_data_change(nodes)
    return client


async def load(port: int, surface: str, count: int, seconds: float) -> dict[str, float]:
    """Subscribe, and note for this time what comes."""
    arrivals = Arrivals()
    clients = [await subscribe(port, surface, arrivals) for _ in range(count)]
    print("subscribed", flush=True)
    arrivals.values, arrivals.ages_s = 0, []
    begin_s = perf_counter()
    await asyncio.sleep(seconds)
    took_s, ages_s = perf_counter() - begin_s, sorted(arrivals.ages_s)
    found = {
        "values_per_s": arrivals.values / took_s,
        "p50_ms": ages_s[len(ages_s) // 2] * 1e3,
        "p99_ms": ages_s[len(ages_s) * 99 // 100] * 1e3,
    }
    for client in clients:
        await client.disconnect()
    return found


if __name__ == "__main__":
    given_port, given_surface, given_clients, given_seconds = sys.argv[1:]
    print(json.dumps(asyncio.run(load(int(given_port), given_surface, int(given_clients), float(given_seconds)))))
