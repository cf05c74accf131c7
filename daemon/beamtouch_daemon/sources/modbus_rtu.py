"""Modbus RTU: answers carry no number, so that nothing but order and length tells them apart.

A client that goes on after a late answer takes every answer for the one before it, without an error. Three things
prevent that here. At most one request is ever unanswered: after any failure the port is closed. Every session begins by
getting in step: it asks for a number of registers that no reading asks for, and believes the line only when an answer
of that length (or an exception) comes; a device answers in order, so whatever it owed has then come before. Where no
such number exists, as with a single register, the line has to be silent for long instead. And before each request the
answers so far must match the requests so far, so that a doubled frame is noticed.
"""

import asyncio
import termios
from collections.abc import Sequence
from time import monotonic

from pymodbus.client import AsyncModbusSerialClient
from pymodbus.client.base import ModbusBaseClient
from pymodbus.pdu import ModbusPDU

from beamtouch_daemon.config import ModbusRtu
from beamtouch_daemon.sources.modbus import Block, ModbusSource
from beamtouch_daemon.sources.reading import SourceError

BITS_PER_CHARACTER = 11
MIN_SILENCE_S = 0.00175
"""Between frames the line is silent for 3.5 characters, and for this long above 19200 baud."""
QUARANTINE_S = 1.0
QUARANTINE_TIMEOUTS = 5
"""How long a line without a probe stays unused: the longer of a time and a number of timeouts."""


def probe_of(blocks: Sequence[Block]) -> Block | None:
    """Return a request that a unit with these blocks can answer, of a length that none of them has, if there is one."""
    lengths = {block.count for block in blocks}
    longest = max(blocks, key=lambda block: block.count)
    return next((Block(longest.first, count) for count in range(1, longest.count) if count not in lengths), None)


class ModbusRtuSource(ModbusSource):
    """Readings of one unit on a serial bus of which this is the only user."""

    def __init__(self, settings: ModbusRtu, registers: Sequence[int], rate_hz: float) -> None:
        super().__init__(registers, settings.unit, rate_hz, settings.timeout_ms / 1e3)
        self._port = settings.port
        self._baud = settings.baud
        self._silence_s = max(MIN_SILENCE_S, 3.5 * BITS_PER_CHARACTER / settings.baud)
        self._probe = probe_of(self._blocks)
        self._unanswered = 0
        self._free_s = 0.0

    async def _connect(self) -> ModbusBaseClient:
        """Open the port, which discards what has come in meanwhile, and get in step."""
        if self._probe is None:
            await asyncio.sleep(max(QUARANTINE_S, QUARANTINE_TIMEOUTS * self._timeout_s))
        client = AsyncModbusSerialClient(
            self._port,
            baudrate=self._baud,
            timeout=self._timeout_s,
            retries=0,
            reconnect_delay=0,
            trace_pdu=self._trace,
        )
        self._unanswered = 0
        try:
            opened = await client.connect()
        except (ValueError, termios.error) as error:
            message = f"{self._port} cannot be set to {self._baud} baud: {error}"
            raise SourceError(message) from error
        if not opened:
            message = f"{self._port} cannot be opened; is it there, and does no other program use it?"
            raise SourceError(message)
        if self._probe is not None:
            try:
                await self._request(client, self._probe)
            except BaseException:
                client.close()
                raise
        return client

    async def _before_request(self) -> None:
        """Keep the line silent between frames, and see that no answer has come unasked."""
        await asyncio.sleep(max(0.0, self._free_s - monotonic()))
        if self._unanswered:
            message = f"unit {self._unit} sent an answer that was not asked for"
            raise SourceError(message)

    def _trace(self, sending: bool, pdu: ModbusPDU) -> ModbusPDU:
        self._unanswered += 1 if sending else -1
        self._free_s = monotonic() + self._silence_s
        return pdu
