"""Modbus units over TCP."""

import asyncio
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager, suppress
from ipaddress import ip_address
from socket import SOCK_STREAM, gaierror
from typing import Any

from pymodbus.framer import FramerSocket

from beamtouch_daemon.config.sources import ModbusTcp
from beamtouch_daemon.sources.reading import NoAnswerError
from beamtouch_daemon.sources.registers import DECODER, Answer, Block, answer_to
from beamtouch_daemon.uptime import uptime_s

REST_S = 0.5
"""Pause between attempts to reach a unit that was given up."""
HEADER_BYTES = 7
"""Transaction, protocol, length and unit."""
DEVICE_ITSELF = (0, 255)
"""Unit numbers of the device at the other end of the connection, as opposed to units behind it."""
_FRAMER = FramerSocket(DECODER)


class TcpLink:
    """A unit behind a Modbus TCP server.

    Within a connection, transaction numbers tell answers apart. An answer with transaction number 0, which some devices
    always send, is refused, and so is that of another unit: behind a gateway it comes from another device. A device
    that always answers as unit 0 or 255 is accepted. A missing answer closes the connection, which discards a late one.
    """

    limits: tuple[str, ...] = ()

    def __init__(self, settings: ModbusTcp, host: str, unit: int) -> None:
        self.name = f"unit {unit}" if host == settings.host else f"{host} unit {unit}"
        self.rest_s = REST_S
        self._timeout_s = settings.timeout_s
        self._host = host
        self._port = settings.port
        self._unit = unit
        self._transaction = 0
        self._complaint = ""
        """What to say if the step that has begun fails."""
        self._stream: tuple[asyncio.StreamReader, asyncio.StreamWriter] | None = None
        self._lookup: asyncio.Future[list[Any]] | None = None
        """The running question for the address of the host."""

    @asynccontextmanager
    async def opened(self) -> AsyncIterator[None]:
        """Connect at the first read; disconnect at the end."""
        try:
            yield
        finally:
            self._close()

    async def read(self, block: Block) -> Answer:
        """Read registers; connect first if necessary."""
        try:
            reader, writer = await self._connected()
            self._transaction = self._transaction % 0xFFFF + 1
            self._complaint = f"{self.name} does not answer within {self._timeout_s * 1e3:.0f} ms"
            asked_s = uptime_s()
            writer.write(_FRAMER.encode(block.request, self._unit, self._transaction))
            async with asyncio.timeout(self._timeout_s):
                answer = answer_to(block, await self._receive(reader), asked_s)
        except (OSError, EOFError) as error:  # also a timeout
            self._close()
            raise NoAnswerError(self._complaint) from error
        except BaseException:  # cancelled: the answer may still come
            self._close()
            raise
        if answer is None:
            self._close()
            raise NoAnswerError(f"{self.name} answered another request")
        return answer

    async def _receive(self, reader: asyncio.StreamReader) -> bytes:
        """Return function and contents of the answer to the newest request."""
        while True:
            header = await reader.readexactly(HEADER_BYTES)
            rest = await reader.readexactly(max(0, int.from_bytes(header[4:6]) - 1))
            _, unit, transaction, data = _FRAMER.decode(header + rest)
            if transaction == self._transaction and unit in (self._unit, *DEVICE_ITSELF):
                return data
            if transaction == self._transaction:
                self._complaint = f"{self.name} answers as unit {unit}; state unit = {unit} if that is the device"
            elif not transaction:
                self._complaint = f"{self.name} answers with transaction number 0, which does not identify the request"

    async def _connected(self) -> tuple[asyncio.StreamReader, asyncio.StreamWriter]:
        """Return the connection. Connect again if the device has closed it: some do so after each answer."""
        if self._stream is not None:
            reader, writer = self._stream
            if not reader.at_eof() and not writer.is_closing():
                return self._stream
            self._close()
        async with asyncio.timeout(self._timeout_s):
            address = await self._address()
            self._complaint = f"no connection to {self._host}:{self._port}; is the device on, and is the address right?"
            self._stream = await asyncio.open_connection(address, self._port)
        return self._stream

    async def _address(self) -> str:
        """Return the address of the host. Each attempt waits for the same question to the name server.

        A name server that is away keeps a thread busy for many seconds: of one question each, the others need theirs.
        """
        with suppress(ValueError):
            return str(ip_address(self._host))
        if self._lookup is None:
            loop = asyncio.get_running_loop()
            self._lookup = asyncio.ensure_future(loop.getaddrinfo(self._host, self._port, type=SOCK_STREAM))
        lookup, advice = self._lookup, "is the name right, and is its name server there?"
        self._complaint = f"{self._host} does not resolve (the name server does not answer); {advice}"
        try:
            (_, _, _, _, address), *_ = await asyncio.shield(lookup)
        except gaierror as error:
            self._complaint = f"{self._host} does not resolve ({error.strerror or 'no such name'}); {advice}"
            raise
        finally:
            self._lookup = None if lookup.done() else lookup
        return str(address[0])

    def _close(self) -> None:
        if self._stream is not None:
            self._stream[1].transport.abort()
            self._stream = None
