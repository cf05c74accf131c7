"""Links to Modbus units: on a serial bus, and over TCP."""

import asyncio
from collections.abc import AsyncIterator
from contextlib import AbstractAsyncContextManager, asynccontextmanager, suppress
from ipaddress import ip_address
from socket import SOCK_STREAM
from typing import Any

from pymodbus.client import AsyncModbusTcpClient
from pymodbus.exceptions import ModbusException

from beamtouch_daemon.config.sources import ModbusTcp
from beamtouch_daemon.sources.reading import NoAnswerError
from beamtouch_daemon.sources.registers import Block
from beamtouch_daemon.sources.rtu_bus import RtuBus
from beamtouch_daemon.sources.rtu_frame import EXCEPTION, Answer
from beamtouch_daemon.sources.rtu_unit import Request, Unit, forgotten_s
from beamtouch_daemon.sources.tcp_frame import AnswerHeaders
from beamtouch_daemon.uptime import uptime_s

READ_HOLDING_REGISTERS = 3
REST_S = 0.5
"""Pause between attempts to reach a unit that was given up."""
REST_TIMEOUTS = 13.0
"""On a bus, wait at least 13 timeouts between attempts, so that they take at most 1/14 of the bus."""

COPIES = (
    "Modbus RTU answers carry no number. Two kinds of answers cannot be told from the right one: a copy that comes "
    "after the next request, and the answer to another master that asks the same unit for as many registers."
)


class RtuLink:
    """A unit on a serial bus."""

    def __init__(self, bus: RtuBus, unit: Unit, function: int, timeout_s: float) -> None:
        self.name = f"unit {unit.address}"
        self.timeout_s = timeout_s
        self.rest_s = max(REST_S, REST_TIMEOUTS * timeout_s)
        self._bus = bus
        self._unit = unit
        self._function = function

    @property
    def limits(self) -> tuple[str, ...]:
        """Cases in which old or foreign answers may pass unnoticed, a sentence each."""
        if not self._unit.is_unprovable:
            return (COPIES,)
        silence_s = forgotten_s(self.timeout_s)
        unprovable = (
            f"{self.name} answers only requests for its values, so a late answer looks like a new one. After a missing "
            f"answer it is left alone for {silence_s:g} s; an answer that comes even later counts as a new one."
        )
        return unprovable, COPIES

    def opened(self) -> AbstractAsyncContextManager[None]:
        """Return a context in which the port is open."""
        return self._bus.used()

    async def read(self, block: Block) -> tuple[Answer, float, float]:
        """Read registers, in turn with the other users of the bus."""
        return await self._bus.read(self._unit, Request(self._function, block), self.timeout_s)


class TcpLink:
    """A unit behind a Modbus TCP server.

    Within a connection, transaction numbers tell answers apart. A timeout closes the connection, which discards any
    late answer.
    """

    def __init__(self, settings: ModbusTcp, host: str, unit: int) -> None:
        self.name = f"unit {unit}" if host == settings.host else f"{host} unit {unit}"
        self.timeout_s = settings.timeout_ms / 1e3
        self.rest_s = REST_S
        self._host = host
        self._port = settings.port
        self._unit = unit
        self._function = settings.function_code
        self._reads_holding = self._function == READ_HOLDING_REGISTERS
        self._headers = AnswerHeaders(unit)
        self._client: AsyncModbusTcpClient | None = None
        self._lookup: asyncio.Future[list[Any]] | None = None
        """The running question for the address of the host."""

    @property
    def limits(self) -> tuple[str, ...]:
        """Empty: transaction numbers tell answers apart."""
        return ()

    @asynccontextmanager
    async def opened(self) -> AsyncIterator[None]:
        """Connect at the first read; disconnect at the end."""
        try:
            yield
        finally:
            self._close()

    async def read(self, block: Block) -> tuple[Answer, float, float]:
        """Read registers; connect first if necessary."""
        client = await self._connected()
        ask = client.read_holding_registers if self._reads_holding else client.read_input_registers
        begin_s = uptime_s()
        try:
            answer = await ask(block.first, count=block.count, device_id=self._unit)
        except ModbusException as error:
            self._close()
            complaint = self._headers.complaint or f"does not answer within {self.timeout_s * 1e3:.0f} ms"
            message = f"{self.name} {complaint}"
            raise NoAnswerError(message) from error
        except BaseException:  # cancelled: the answer may still come
            self._close()
            raise
        end_s = uptime_s()
        if answer.function_code == self._function and len(answer.registers) == block.count:
            return Answer(answer.registers), begin_s, end_s
        if answer.isError() and answer.function_code == self._function | EXCEPTION:
            return Answer(exception=answer.exception_code), begin_s, end_s
        self._close()
        message = f"{self.name} answered another request"
        raise NoAnswerError(message)

    async def _connected(self) -> AsyncModbusTcpClient:
        """Return the connection. Connect again if the device has closed it: some do so after each answer."""
        if self._client is not None and self._client.connected:
            return self._client
        self._close()
        client = AsyncModbusTcpClient(
            await self._address(),
            port=self._port,
            timeout=self.timeout_s,
            retries=0,
            reconnect_delay=0,
            trace_packet=self._headers.trace,
        )
        try:
            connected = await client.connect()
        except BaseException:
            client.close()
            raise
        if not connected:
            client.close()
            message = f"no connection to {self._host}:{self._port}; is the device on, and is the address right?"
            raise NoAnswerError(message)
        self._client = client
        return client

    async def _address(self) -> str:
        """Return the address of the host. Each attempt waits for the same question to the name server.

        A name server that is away keeps a thread busy for many seconds: of one question each, the others need theirs.
        """
        with suppress(ValueError):
            return str(ip_address(self._host))
        if self._lookup is None:
            self._lookup = asyncio.ensure_future(
                asyncio.get_running_loop().getaddrinfo(self._host, self._port, type=SOCK_STREAM)
            )
        reason = "the name server does not answer"
        try:
            async with asyncio.timeout(self.timeout_s):
                (_, _, _, _, address), *_ = await asyncio.shield(self._lookup)
        except TimeoutError:
            pass
        except OSError as error:
            self._lookup, reason = None, error.strerror or "no such name"
        else:
            self._lookup = None
            return str(address[0])
        message = f"{self._host} does not resolve ({reason}); is the name right, and is its name server there?"
        raise NoAnswerError(message)

    def _close(self) -> None:
        if self._client is not None:
            self._client.close()
            self._client = None
