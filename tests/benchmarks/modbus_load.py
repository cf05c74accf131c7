"""Polls a surface over Modbus TCP: `modbus_load.py PORT CLIENTS SECONDS [PERIOD_MS]`.

Reads 42 input registers again and again over connections that stay open: each request at once after an answer, or one
each period. Prints percentiles of the time per answer as JSON. Little more than sockets.
"""

import asyncio
import json
import struct
import sys
from time import perf_counter

REQUEST = struct.pack(">HHHBBHH", 1, 0, 6, 1, 4, 0, 42)
ANSWER_BYTES = 9 + 84


async def poll(port: int, until_s: float, period_s: float) -> list[float]:
    """Poll over one connection; returns the time of each answer [s]."""
    reader, writer = await asyncio.open_connection("127.0.0.1", port)
    took_s: list[float] = []
    next_s = perf_counter()
    while (begin_s := perf_counter()) < until_s:
        writer.write(REQUEST)
        answer = await reader.readexactly(ANSWER_BYTES)
        took_s.append(perf_counter() - begin_s)
        assert answer[7] == 4
        if period_s:
            next_s += period_s
            await asyncio.sleep(max(0.0, next_s - perf_counter()))
    writer.close()
    return took_s


async def load(port: int, clients: int, seconds: float, period_s: float) -> dict[str, float]:
    """Poll for so many seconds; returns polls/s and percentiles [ms]."""
    begin_s = perf_counter()
    found = await asyncio.gather(*(poll(port, begin_s + seconds, period_s) for _ in range(clients)))
    took_s = sorted(one for client in found for one in client)
    return {
        "count": len(took_s),
        "per_s": len(took_s) / (perf_counter() - begin_s),
        "p50_ms": took_s[len(took_s) // 2] * 1e3,
        "p99_ms": took_s[len(took_s) * 99 // 100] * 1e3,
    }


if __name__ == "__main__":
    given_port, given_clients, given_seconds, given_ms = [*sys.argv[1:], "0"][:4]
    found = load(int(given_port), int(given_clients), float(given_seconds), float(given_ms) / 1e3)
    print(json.dumps(asyncio.run(found)))
