"""The Modbus TCP server: its listening socket and its connections."""

import asyncio
import logging
import socket
from functools import partial
from typing import cast

from beamtouch_common.errors import InputError
from beamtouch_common.log import Repeated
from beamtouch_service.address import Address
from beamtouch_service.api.context import Context
from beamtouch_service.host.places import Places, State
from beamtouch_service.outputs.modbus.blocks import Blocks
from beamtouch_service.outputs.modbus.registers import MAX_SURFACES
from beamtouch_service.outputs.modbus.requests import HEAD_BYTES, MAX_FRAME_BYTES, NotModbusError, answer, frame_bytes
from beamtouch_service.outputs.modbus.section import ModbusServerSection

_ACCEPTED_AT_ONCE = 16
"""New connections accepted in a row, so that a flood of them does not hold up the others."""

_log = logging.getLogger("beamtouch.service")


class ModbusServer:
    """Answers Modbus requests while the application runs, as soon as its address is there."""

    def __init__(self, settings: ModbusServerSection, surfaces: int) -> None:
        """Raise InputError if it may never listen there, or if there are too many surfaces for the map."""
        if surfaces > MAX_SURFACES:
            message = f"[modbus_server]: the addresses of Modbus hold {MAX_SURFACES} surfaces, but there are {surfaces}"
            raise InputError(message)
        self._settings = settings
        self.address = Address("modbus_server", settings.host, settings.port, option="modbus_server.port")

    async def run(self, context: Context) -> None:
        """Answer requests for the surfaces of an application until cancelled."""
        listener = await self.address.listen(partial(context.missing.__setitem__, self.address.section))
        connections = _Connections(context, self._settings)
        make = partial(_Connection, connections)
        server = await asyncio.get_running_loop().create_server(make, sock=listener, backlog=_ACCEPTED_AT_ONCE)
        self._log_address(listener)
        try:
            await asyncio.Event().wait()
        finally:
            server.close()
            connections.abort()

    def _log_address(self, listener: socket.socket) -> None:
        address, port = listener.getsockname()[:2]
        shown = f"[{address}]" if listener.family is socket.AF_INET6 else address
        _log.info("Modbus TCP server: listening on %s:%d, word order %s", shown, port, self._settings.word_order)


class _Connections:
    """All connections of one server, and what they share."""

    def __init__(self, context: Context, settings: ModbusServerSection) -> None:
        self.idle_s = settings.idle_s
        self._context = context
        self._blocks = Blocks(context.registry, settings.word_order)
        # Answers take no waiting, so no connection is ever busy.
        self._places = Places["_Connection"](settings.max_clients, settings.max_clients, lambda _connection: False)
        self._open: set[_Connection] = set()
        self._repeated = Repeated(_log)

    def read(self, address: int, count: int) -> list[int]:
        """Return registers as of now; raises NoSuchRegisterError."""
        return self._blocks.read(address, count, self._context.clock())

    def join(self, connection: "_Connection") -> None:
        """Give a new connection its place, and close another one for it if there is none left."""
        self._open.add(connection)
        _, evicted = self._places.take(connection, connection.client)
        if evicted is not None:
            evicted.abort()
            self._context.counts.eviction(evicted.client)

    def move(self, connection: "_Connection", state: State) -> None:
        """Note what a connection waits for from now on."""
        self._places.move(connection, state)

    def leave(self, connection: "_Connection") -> None:
        """Give a place back."""
        self._open.discard(connection)
        self._places.leave(connection)

    def not_modbus(self, connection: "_Connection", error: NotModbusError) -> None:
        """Log a client that does not speak Modbus TCP, once per minute."""
        times = self._repeated.due("not Modbus")
        if times:
            words = "Modbus TCP server: closed %d connections since the last such line: not Modbus TCP (%s), from %s"
            _log.warning(words, times, error, connection.client)

    def abort(self) -> None:
        """Close all."""
        for connection in list(self._open):
            connection.abort()


class _Connection(asyncio.BufferedProtocol):
    """One client. Its buffer holds one longest frame, so a turn of the loop answers few requests, however many wait."""

    def __init__(self, connections: _Connections) -> None:
        self._connections = connections
        self._buffer = bytearray(MAX_FRAME_BYTES)
        self._filled = 0
        self._asked_s = 0.0
        """Time of the last whole request, or of the beginning [s, of the loop]."""
        self._timer: asyncio.TimerHandle | None = None
        self.client = "unknown"

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        """Begin."""
        self._transport = cast("asyncio.Transport", transport)
        peer = transport.get_extra_info("peername")
        self.client = peer[0] if peer else self.client
        self._loop = asyncio.get_running_loop()
        self._asked_s = self._loop.time()
        self._connections.join(self)
        self._wait(self._connections.idle_s)

    def get_buffer(self, _sizehint: int) -> memoryview:
        """Return where to put what arrives."""
        return memoryview(self._buffer)[self._filled :]

    def buffer_updated(self, received: int) -> None:
        """Answer all whole requests."""
        self._filled += received
        begin, end = 0, self._frame_end(0)
        if end is not None:
            self._connections.move(self, State.IDLE)
            self._asked_s = self._loop.time()
        while end is not None and not self._transport.is_closing():
            self._transport.write(answer(bytes(self._buffer[begin:end]), self._connections.read))
            begin, end = end, self._frame_end(end)
        self._buffer[: self._filled - begin] = self._buffer[begin : self._filled]
        self._filled -= begin

    def _frame_end(self, begin: int) -> int | None:
        """Return the end of the frame that begins there; None if it is not whole, or nothing is a frame any more."""
        if self._filled - begin < HEAD_BYTES:
            return None
        try:
            end = begin + frame_bytes(bytes(self._buffer[begin : begin + HEAD_BYTES]))
        except NotModbusError as error:
            self._connections.not_modbus(self, error)
            # Earlier answers are still sent.
            self._transport.close()
            return None
        return end if end <= self._filled else None

    def pause_writing(self) -> None:
        """Read no more requests: the client does not read its answers."""
        self._connections.move(self, State.UNREAD)
        self._transport.pause_reading()

    def resume_writing(self) -> None:
        """Read on."""
        self._connections.move(self, State.IDLE)
        self._transport.resume_reading()

    def connection_lost(self, _error: Exception | None) -> None:
        """End."""
        self._connections.leave(self)
        if self._timer:
            self._timer.cancel()

    def abort(self) -> None:
        """Close without waiting for the client."""
        self._transport.abort()

    def _wait(self, seconds: float) -> None:
        self._timer = self._loop.call_later(seconds, self._close_if_idle)

    def _close_if_idle(self) -> None:
        left_s = self._asked_s + self._connections.idle_s - self._loop.time()
        if left_s > 0:
            self._wait(left_s)
        else:
            self.abort()
