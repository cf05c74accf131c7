"""Sends samples as daemons do: `sample_load.py PORT CHANNELS SURFACES SECONDS TOKEN RATE_HZ EVERY_S [IN_BATCH]`.

Surfaces are named s0, s1 and so on; CHANNELS is a JSON object of channel names and deflections [mm]. Each sender
waits for its answer before it sends what was taken meanwhile, or IN_BATCH samples. Prints how many samples were
acknowledged, and the percentiles of the time from the oldest sample of a batch to its receipt, as JSON. Little more
than sockets.
"""

import asyncio
import json
import sys
import uuid
from time import monotonic, time
from typing import NamedTuple


class RequestPace(NamedTuple):
    """How fast samples are taken and sent."""

    rate_hz: int
    every_s: float
    """Time between two batches, as the daemon collects them."""
    in_batch: int = 0
    """Samples in each batch, however many were taken meanwhile; 0: those."""


class Sender:
    """One surface's samples over one connection."""

    def __init__(self, surface: str, channels: dict[str, float], token: str, pace: RequestPace) -> None:
        self._pace = pace
        self.delays_s: list[float] = []
        self.acknowledged = 0
        self._head = (
            f"POST /surfaces/{surface}/samples HTTP/1.1\r\nHost: 127.0.0.1\r\nAuthorization: Bearer {token}\r\n"
        )
        names = json.dumps(list(channels))
        self._begin = f'{{"boot_id":"{uuid.uuid4()}","channels":{names},"newest_age_ms":0.0,"samples":['
        values, quality = json.dumps(list(channels.values())), json.dumps(["good"] * len(channels))
        self._sample = f'"deflection_mm":{values},"quality":{quality}}}'

    async def run(self, port: int, until_s: float) -> None:
        """Send until then."""
        reader, writer = await asyncio.open_connection("127.0.0.1", port)
        begin_s, sent = monotonic(), 0
        while (now_s := monotonic()) < until_s:
            taken = int((now_s - begin_s) * self._pace.rate_hz)
            due = sent + self._pace.in_batch if self._pace.in_batch else taken
            if due > sent:
                writer.write(self._request(sent, due))
                status = await reader.readline()
                assert b" 200 " in status, status
                head = await reader.readuntil(b"\r\n\r\n")
                await reader.readexactly(int(head.lower().partition(b"content-length: ")[2].split(b"\r", 1)[0]))
                self.delays_s.append(monotonic() - begin_s - sent / self._pace.rate_hz)
                self.acknowledged += due - sent
                sent = due
            await asyncio.sleep(max(0.0, now_s + self._pace.every_s - monotonic()))
        writer.close()

    def _request(self, first: int, end: int) -> bytes:
        now_us = int(time() * 1e6)
        period_us = 1_000_000 // self._pace.rate_hz
        samples = ",".join(
            f'{{"sequence":{number},"acquired_unix_us":{now_us + (number - end) * period_us},{self._sample}'
            for number in range(first + 1, end + 1)
        )
        body = f"{self._begin}{samples}]}}"
        return f"{self._head}Content-Length: {len(body)}\r\n\r\n{body}".encode()


async def load(
    port: int, channels: dict[str, float], surfaces: int, seconds: float, token: str, pace: RequestPace
) -> dict[str, float]:
    """Send to so many surfaces for so long."""
    senders = [Sender(f"s{number}", channels, token, pace) for number in range(surfaces)]
    until_s = monotonic() + seconds
    await asyncio.gather(*(sender.run(port, until_s) for sender in senders))
    delays_ms = sorted(delay_s * 1e3 for sender in senders for delay_s in sender.delays_s)
    return {
        "samples": sum(sender.acknowledged for sender in senders),
        "batches": len(delays_ms),
        "p50_ms": delays_ms[len(delays_ms) // 2],
        "p99_ms": delays_ms[len(delays_ms) * 99 // 100],
    }


if __name__ == "__main__":
    _, given_port, given_channels, given_surfaces, given_seconds, given_token, rate_hz, every_s, *more = sys.argv
    given = int(given_port), json.loads(given_channels), int(given_surfaces), float(given_seconds), given_token
    print(json.dumps(asyncio.run(load(*given, RequestPace(int(rate_hz), float(every_s), *map(int, more))))))
