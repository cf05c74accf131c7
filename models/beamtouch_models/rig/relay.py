"""The line between a device and its readers, which delays and loses what faults say."""

import asyncio
from collections.abc import Callable
from contextlib import suppress

from beamtouch_models.rig.faults import Faults

_CHUNK = 4096
_MENDED_S = 0.1
"""A long pause is looked at again after this time, as it may have been mended."""
_TICK_S = 1e-6
"""The event loop keeps the order of acts that are this far apart."""

Pass = Callable[[Callable[[], None]], None]
"""Passes something on: calls a function at once, later or never."""


class Relay:
    """Passes requests and replies on, each in their order, as the faults let them through."""

    def __init__(self, faults: Faults, clock: Callable[[], float]) -> None:
        """Take the time since the start [s] from `clock`."""
        self._faults, self._clock = faults, clock
        self._requests: list[Callable[[], None]] = []
        self._last_reply_s = 0.0

    def request(self, act: Callable[[], None]) -> None:
        """Pass a request on, once no pause is on."""
        self._requests.append(act)
        if len(self._requests) == 1:
            self._pass_requests()

    def reply(self, act: Callable[[], None]) -> None:
        """Pass a reply on, unless it is lost."""
        delay_s = self._faults.delay_s(self._clock())
        if delay_s is None:
            return
        loop = asyncio.get_running_loop()
        now_s = loop.time()
        self._last_reply_s = max(self._last_reply_s + _TICK_S, now_s + delay_s)
        if self._last_reply_s > now_s:
            loop.call_at(self._last_reply_s, act)
        else:
            act()

    async def idle(self) -> None:
        """Wait until no pause is on."""
        while True:
            pause_s = self._pause_s()
            if not pause_s:
                return
            await asyncio.sleep(pause_s)

    async def listen(self, host: str, port: int, device_port: int) -> asyncio.Server:
        """Return a server that passes the bytes of its clients on to a device on this machine, and back."""

        async def serve(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
            try:
                device_reader, device_writer = await asyncio.open_connection("127.0.0.1", device_port)
                both = (
                    asyncio.create_task(_copy(reader, device_writer, self.request)),
                    asyncio.create_task(_copy(device_reader, writer, self.reply)),
                )
                with suppress(asyncio.CancelledError):  # the rig ends, and asyncio would log the cancelled client
                    await asyncio.wait(both, return_when=asyncio.FIRST_COMPLETED)
                for task in both:
                    task.cancel()
                device_writer.close()
            finally:
                writer.close()

        return await asyncio.start_server(serve, host, port)

    def _pass_requests(self) -> None:
        pause_s = self._pause_s()
        if pause_s:
            asyncio.get_running_loop().call_later(pause_s, self._pass_requests)
            return
        waiting, self._requests = self._requests, []
        for act in waiting:
            act()

    def _pause_s(self) -> float:
        return min(self._faults.pause_s(self._clock()), _MENDED_S)


async def _copy(reader: asyncio.StreamReader, writer: asyncio.StreamWriter, pass_on: Pass) -> None:
    with suppress(ConnectionError):
        while data := await reader.read(_CHUNK):
            pass_on(lambda data=data: None if writer.is_closing() else writer.write(data))  # type: ignore[misc]
