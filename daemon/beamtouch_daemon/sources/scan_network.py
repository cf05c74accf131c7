"""Scans a Modbus TCP device, or a gateway, for its units."""

import asyncio
from collections.abc import AsyncGenerator, Sequence

from beamtouch_daemon.config.sources import ModbusTcp
from beamtouch_daemon.sources.links import TcpLink
from beamtouch_daemon.sources.reading import NoAnswerError, SourceError
from beamtouch_daemon.sources.registers import Block
from beamtouch_daemon.sources.rtu_frame import Answer
from beamtouch_daemon.sources.scanned_unit import FUNCTIONS, Asked, FoundUnit, Function, registers_of

CONNECT_S = 2.0
"""Shortest time limit of the first connection."""


def tcp_request_s(timeout_ms: float) -> float:
    """Return the longest time of a request with its connection [s]."""
    return 2 * timeout_ms / 1e3


async def scan_tcp(host: str, port: int, units: Sequence[int], timeout_ms: float) -> AsyncGenerator[Asked, None]:
    """Ask units one after the other; yield each with what was found.

    Raises
    ------
    SourceError
        Nothing accepts connections there.
    """
    try:
        async with asyncio.timeout(max(CONNECT_S, timeout_ms / 1e3)):
            _, writer = await asyncio.open_connection(host, port)
        writer.close()
    except OSError as error:  # also a timeout
        message = f"no connection to {host}:{port}; is the device on, and is the address right?"
        raise SourceError(message) from error
    for number in units:
        links = {
            function: TcpLink(
                ModbusTcp(kind="modbus-tcp", host=host, port=port, function=function, timeout_ms=timeout_ms),
                host,
                number,
            )
            for function in FUNCTIONS
        }

        async def ask(function: Function, block: Block, links: dict[Function, TcpLink] = links) -> Answer | None:
            async with links[function].opened():  # one connection at a time: some devices accept no more
                try:
                    answer, _, _ = await links[function].read(block)
                except NoAnswerError:
                    return None
                return answer

        registers = await registers_of(ask)
        yield Asked(number, None if registers is None else FoundUnit(number, registers))
