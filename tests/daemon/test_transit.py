"""A batch that is held on its way, between a real publisher and a real HTTP server."""

import asyncio
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager, suppress
from time import monotonic
from urllib.parse import urlsplit

import pytest

from beamtouch_service.surfaces.freshness import Transit

from .publishing import Bench, until
from .service import Service, serving

pytestmark = pytest.mark.anyio


class Relay:
    """Passes on what it reads from connections, but holds it while it is told to."""

    def __init__(self, url: str) -> None:
        self._to = urlsplit(url)
        self.opens = asyncio.Event()
        self.opens.set()
        self.holds = asyncio.Event()
        """It has read something that it does not pass on."""

    async def connected(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        onward, back = await asyncio.open_connection(self._to.hostname, self._to.port)
        await asyncio.gather(self._pass_on(reader, back), self._pass_on(onward, writer))

    async def _pass_on(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        with suppress(ConnectionError):
            while piece := await reader.read(65536):
                if not self.opens.is_set():
                    self.holds.set()
                    await self.opens.wait()
                writer.write(piece)
        writer.close()


@asynccontextmanager
async def relaying(service: Service) -> AsyncIterator[Relay]:
    relay = Relay(service.url)
    server = await asyncio.start_server(relay.connected, "127.0.0.1", 0)
    service.url = f"http://127.0.0.1:{server.sockets[0].getsockname()[1]}"
    try:
        yield relay
    finally:
        server.close()


async def test_a_batch_that_was_held_is_told_from_one_that_was_not() -> None:
    async with serving(Service()) as service, relaying(service) as relay, Bench(service) as bench:
        for number in range(5):
            bench.count(1)
            await service.until(number + 1)
        await until(lambda: bench.log.live_from == bench.log.next)
        relay.opens.clear()
        bench.count(1)
        await relay.holds.wait()
        held_s = monotonic()
        await asyncio.sleep(0.5)
        held_s = monotonic() - held_s
        relay.opens.set()
        await service.until(6)
    transit = Transit()
    waited = [at_s - transit.arrival_s(batch, at_s, at_s) for _, batch, at_s in service.batches if not batch.backlog]
    assert waited[-1] >= held_s - max(waited[:-1]) - 0.001
    assert min(waited) == 0.0
