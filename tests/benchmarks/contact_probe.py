"""Sends samples and asks for the contact at a steady pace.

`contact_probe.py PORT SURFACE SECONDS [TOKEN SAMPLE [clock]]`: a sample is sent and the contact is asked for each
50 ms, over a connection each. SAMPLE is a JSON object of a sample and its channels; without it, none is sent. With
`clock` the sender states its clock (`sent_us`). Prints the percentiles of the times of both, and the contacts that were
not answered with 200 within half a second, as JSON. A process of its own, so that clients that load the service take no
time from it.
"""

import asyncio
import json
import sys
import uuid
from collections import Counter
from time import monotonic, time
from typing import Any

EVERY_S = 0.05
PATIENCE_S = 0.5
"""An answer that comes later is none: this is the default of `stale_ms`."""


async def answer(reader: asyncio.StreamReader) -> str:
    """Read one answer; return why it is none, empty if it is one."""
    status = await reader.readline()
    head = await reader.readuntil(b"\r\n\r\n")
    body = await reader.readexactly(int(head.lower().partition(b"content-length: ")[2].split(b"\r", 1)[0]))
    return "" if b" 200 " in status else str(json.loads(body)["type"]).rpartition(":")[2]


class Asker:
    """Asks one thing again and again over one connection, and notes how long each answer took."""

    def __init__(self, port: int) -> None:
        self.took_ms: list[float] = []
        self.refusals = Counter[str]()
        """Answers that were no 200 by their problem, or came too late."""
        self._port = port

    async def run(self, until_s: float) -> None:
        """Ask until then, whatever the last answer took."""
        reader, writer = await asyncio.open_connection("127.0.0.1", self._port)
        due_s = monotonic()
        while due_s < until_s:
            await asyncio.sleep(max(0.0, due_s - monotonic()))
            begin_s = monotonic()
            writer.write(self.request())
            problem = await answer(reader)
            took_s = monotonic() - begin_s
            self.took_ms.append(took_s * 1e3)
            if problem or took_s > PATIENCE_S:
                self.refusals[problem or "late"] += 1
            due_s = max(due_s + EVERY_S, monotonic())
        writer.close()

    def request(self) -> bytes:
        """Return the next request."""
        raise NotImplementedError

    def figures(self) -> dict[str, float]:
        """Return the percentiles [ms]."""
        took = sorted(self.took_ms)
        return {"count": len(took), "p50_ms": took[len(took) // 2], "p99_ms": took[len(took) * 99 // 100]}


class Contacts(Asker):
    """Asks for the contact."""

    def __init__(self, port: int, surface: str) -> None:
        super().__init__(port)
        self._request = f"GET /surfaces/{surface}/contact HTTP/1.1\r\nHost: 127.0.0.1\r\n\r\n".encode()

    def request(self) -> bytes:
        """Return the question."""
        return self._request


class Samples(Asker):
    """Sends one sample at a time."""

    def __init__(self, port: int, surface: str, token: str, sample: dict[str, Any], *, clock: bool) -> None:
        super().__init__(port)
        self._head = (
            f"POST /surfaces/{surface}/samples HTTP/1.1\r\nHost: 127.0.0.1\r\nAuthorization: Bearer {token}\r\n"
        )
        self._channels, self._sample = sample.pop("channels"), sample
        self._boot_id, self._number, self._clock = str(uuid.uuid4()), 0, clock

    def request(self) -> bytes:
        """Return a batch of one sample that was taken now."""
        self._number += 1
        sample = {"sequence": self._number, "acquired_unix_us": int(time() * 1e6), **self._sample}
        batch = {"boot_id": self._boot_id, "channels": self._channels, "newest_age_ms": 0.0, "samples": [sample]}
        batch |= {"oldest": max(1, self._number - 100)} | ({"sent_us": int(monotonic() * 1e6)} if self._clock else {})
        body = json.dumps(batch)
        return f"{self._head}Content-Length: {len(body)}\r\n\r\n{body}".encode()


async def probe(port: int, surface: str, seconds: float, samples: Samples | None) -> dict[str, Any]:
    """Send and ask for so long."""
    contacts = Contacts(port, surface)
    if samples:
        await samples.run(monotonic() + EVERY_S)  # before it there is nothing to answer with
    until_s = monotonic() + seconds
    await asyncio.gather(*(one.run(until_s) for one in (samples, contacts) if one))
    sent = {"sample": samples.figures()} if samples else {}
    return {"contact": contacts.figures(), **sent, "unanswered": contacts.refusals}


if __name__ == "__main__":
    _, given_port, given_surface, given_seconds, *sending = sys.argv
    sender = None
    if sending:
        given_token, given_sample, *more = sending
        sender = Samples(int(given_port), given_surface, given_token, json.loads(given_sample), clock="clock" in more)
    print(json.dumps(asyncio.run(probe(int(given_port), given_surface, float(given_seconds), sender))))
