"""A port that stays open between sessions, because opening it resets many devices."""

import asyncio
from collections.abc import AsyncIterator, Iterator
from contextlib import asynccontextmanager, contextmanager

from beamtouch_common.uptime import uptime_s
from beamtouch_daemon.sources.serial_port import LineSettings, Opener, SerialPort
from beamtouch_daemon.sources.traffic import SILENT_S


class KeptPort:
    """A port that its first user opens, and that is closed once nobody uses it or wants it kept.

    A session that begins opens it again after a failure, and after a long time without a frame.
    """

    def __init__(self, path: str, settings: LineSettings) -> None:
        self.path = path
        self._opener = Opener(path, settings)
        self._opening = asyncio.Lock()
        self._users = 0
        self._port: SerialPort | None = None

    @asynccontextmanager
    async def used(self) -> AsyncIterator[SerialPort]:
        """Give the open port for a session; SourceError if it cannot be opened."""
        with self.kept_open():
            async with self._opening:
                if self._port is not None and self._port.traffic.is_silent(uptime_s()):
                    self._port.close(f"{self.path} was silent for {SILENT_S:g} s and is opened again")
                if self._port is None or self._port.failure:
                    self._port = await self._opener.open()
                port = self._port
            yield port

    @contextmanager
    def kept_open(self) -> Iterator[None]:
        """Let the port stay open during the block once somebody has opened it."""
        self._users += 1
        try:
            yield
        finally:
            self._users -= 1
            if not self._users and self._port is not None:
                self._port.close()
