"""The Modbus TCP server: its address, its connections, and the answers to their requests."""

import asyncio
import logging
from collections.abc import Sequence
from functools import partial

from beamtouch_common.errors import InputError
from beamtouch_common.log_lines import Repeated
from beamtouch_service.access import Access
from beamtouch_service.address import Address
from beamtouch_service.api.context import Context
from beamtouch_service.outputs.modbus.blocks import Blocks
from beamtouch_service.outputs.modbus.registers import MAX_SURFACES, identity
from beamtouch_service.outputs.modbus.requests import HEAD_BYTES, NotModbusError, answer, frame_bytes, refuse
from beamtouch_service.outputs.modbus.section import ModbusServerSection
from beamtouch_service.outputs.section import Output

_log = logging.getLogger(__name__)


def make(section: ModbusServerSection, surfaces: Sequence[str], access: Access) -> Output:
    """Return the server; raises InputError if it may never listen there, or if the map cannot hold the surfaces."""
    if len(surfaces) > MAX_SURFACES:
        count = len(surfaces)
        message = f"[modbus_server]: the addresses of Modbus hold {MAX_SURFACES} surfaces, but there are {count}"
        raise InputError(message)
    address = Address(section.name, section.host, section.port, option="modbus_server.port")
    is_protected = not access.read and address.is_loopback
    words = "no token protects the Modbus TCP server: everyone who reaches it can read the contacts"
    return Output(partial(_serve, section, address), ([] if is_protected else [words]) + _alike(surfaces))


def _alike(surfaces: Sequence[str]) -> list[str]:
    """Return a warning for each surface whose block a controller cannot tell from that of an earlier one."""
    names: dict[int, str] = {}
    pairs = [(names.setdefault(identity(name), name), name) for name in surfaces]
    words = "surfaces {} and {} have the same Modbus identity: no controller can tell their blocks apart; rename one"
    return [words.format(first, name) for first, name in pairs if first != name]


async def _serve(section: ModbusServerSection, address: Address, context: Context) -> None:
    """Answer requests, as soon as the address is there, until cancelled."""
    connections = _Connections(section, context)
    with await address.listen(partial(context.missing.__setitem__, section.name)) as listener:
        host, port = listener.getsockname()[:2]
        shown = f"[{host}]" if ":" in host else host
        server = await asyncio.start_server(connections.serve, sock=listener)
        try:
            _log.info("Modbus TCP server: listening on %s:%d, word order %s", shown, port, section.word_order)
            await asyncio.Event().wait()
        finally:
            server.close()
            connections.abort()


class _Connections:
    """The connections of one server."""

    def __init__(self, section: ModbusServerSection, context: Context) -> None:
        self._section = section
        self._context = context
        self._blocks = Blocks(context.registry, section.word_order)
        self._open: set[asyncio.StreamWriter] = set()
        self._repeated = Repeated(_log)
        words = "Connections to the Modbus TCP server that were closed at once, as too many were open."
        self._refused = context.counts.counter("modbus_connections_refused", words)

    def abort(self) -> None:
        """Close all, without waiting for the clients."""
        for writer in self._open:
            writer.transport.abort()

    async def serve(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        """Answer the requests of one connection until it ends, is silent for too long, or sends something else."""
        client = (writer.get_extra_info("peername") or ("unknown",))[0]
        if len(self._open) >= self._section.max_clients:
            self._refused.inc()
            self._log_seldom("too many connections (modbus_server.max_clients)", client)
            writer.transport.abort()
            return
        self._open.add(writer)
        try:
            while True:
                async with asyncio.timeout(self._section.idle_s):
                    await self._answer_next(reader, writer)
                # A client may send thousands of requests at once; everybody else has a turn after each of them.
                await asyncio.sleep(0)
        except TimeoutError:
            writer.transport.abort()
        except NotModbusError as error:
            self._log_seldom(f"not Modbus TCP ({error})", client)
        except (ConnectionError, asyncio.IncompleteReadError):
            pass
        finally:
            self._open.discard(writer)
            # The answers so far are still sent.
            writer.close()

    async def _answer_next(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        head = await reader.readexactly(HEAD_BYTES)
        frame = head + await reader.readexactly(frame_bytes(head) - HEAD_BYTES)
        reply = b""
        with self._context.parts.attempt(f"{self._section.name} answers"):
            reply = answer(frame, lambda address, count: self._blocks.read(address, count, self._context.clock()))
        writer.write(reply or refuse(frame))
        await writer.drain()

    def _log_seldom(self, reason: str, client: str) -> None:
        if times := self._repeated.due(reason.partition(" (")[0]):
            words = "Modbus TCP server: closed %d connections since the last such line: %s, the last from %s"
            _log.warning(words, times, reason, client)
