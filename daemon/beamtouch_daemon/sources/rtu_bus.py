"""A serial bus with any number of Modbus RTU units, shared by all surfaces that read from it.

Answers carry no number, so that nothing but order, unit and length tells them apart. A client that goes on after a late
answer takes every answer for the one before it, without an error. Here, at most one request is under way on the bus.
A unit that did not answer in time may still owe an answer; before it is asked for values again it is brought in step:
it is asked for a number of registers that no reading asks for, and believed only when an answer of that length (or a
refusal) comes. A unit answers in order, so whatever it owed has then come before. Where no such number exists, as with
a single register, the unit is left alone for long instead. What comes unasked is thrown away before each request, and
puts the unit that seems to have sent it out of step.
"""

import asyncio
import contextlib
import termios
from collections.abc import AsyncIterator, Collection
from contextlib import asynccontextmanager
from dataclasses import dataclass, field
from time import monotonic

import serial

from beamtouch_daemon.config_sources import ModbusRtu
from beamtouch_daemon.sources.reading import NoAnswerError, SourceError
from beamtouch_daemon.sources.registers import Block
from beamtouch_daemon.sources.rtu_frame import Answer, answer_bytes, find_answer, request

BITS_PER_CHARACTER = 11
MIN_SILENCE_S = 0.00175
"""Between frames the line is silent for 3.5 characters, and for this long above 19200 baud."""
DAMAGED_AFTER_S = 0.01
"""An answer is damaged when as many bytes as it should have are there, it is not among them, and no more come."""
QUARANTINE_S = 1.0
QUARANTINE_TIMEOUTS = 5
"""How long a unit without a probe is left alone: the longer of a time and a number of timeouts."""
_READ_BYTES = 4096
_PARITIES = {"none": serial.PARITY_NONE, "even": serial.PARITY_EVEN, "odd": serial.PARITY_ODD}


@dataclass(slots=True)
class Unit:
    """A unit on a bus, whoever reads it: what it is asked for, and whether it may owe an answer."""

    address: int
    function: int
    timeout_s: float
    blocks: set[Block] = field(default_factory=set)
    """All that anyone asks it for."""
    in_step: bool = True
    alone_until_s: float = 0.0

    @property
    def probe(self) -> Block | None:
        """A request that it can answer, of a length that none of its blocks has, if there is one."""
        return probe_of(self.blocks)


def probe_of(blocks: Collection[Block]) -> Block | None:
    """Return a request that a unit with these blocks can answer, of a length that none of them has, if there is one."""
    lengths = {block.count for block in blocks}
    longest = max(blocks, key=lambda block: block.count)
    return next((Block(longest.first, count) for count in range(1, longest.count) if count not in lengths), None)


class RtuBus:
    """One serial port; opened by its first user and closed by its last."""

    def __init__(self, settings: ModbusRtu) -> None:
        self._settings = settings
        silence_s = max(MIN_SILENCE_S if settings.baud > 19_200 else 0.0, 3.5 * BITS_PER_CHARACTER / settings.baud)
        self._silence_s = silence_s if settings.silence_ms is None else settings.silence_ms / 1e3
        self._lock = asyncio.Lock()
        self._users = 0
        self._port: serial.Serial | None = None
        self._received = bytearray()
        self._arrived = asyncio.Event()
        self._free_s = 0.0
        self._units: dict[tuple[int, int], Unit] = {}

    def unit(self, address: int, function: int, timeout_s: float, blocks: Collection[Block]) -> Unit:
        """Return a unit that is to be asked for `blocks`; all who read from it share one."""
        unit = self._units.setdefault((address, function), Unit(address, function, timeout_s))
        unit.timeout_s = max(unit.timeout_s, timeout_s)
        unit.blocks.update(blocks)
        return unit

    @asynccontextmanager
    async def used(self) -> AsyncIterator[None]:
        """Keep the port open during the block; SourceError if it cannot be opened."""
        self._open()
        self._users += 1
        try:
            yield
        finally:
            self._users -= 1
            if not self._users:
                self._close()

    async def read(self, unit: Unit, block: Block) -> tuple[Answer, float, float]:
        """Read registers; return the answer, and when it was asked and answered on the monotonic clock [s].

        Raises
        ------
        NoAnswerError
            The unit does not answer, or is being left alone after it did not.
        SourceError
            The port is gone.
        """
        if monotonic() < unit.alone_until_s:
            message = f"unit {unit.address} is left alone until no late answer can come any more"
            raise NoAnswerError(message)
        async with self._lock:
            if not unit.in_step and unit.probe is not None:
                await self._exchange(unit, unit.probe)
            unit.in_step = True
            return await self._exchange(unit, block)

    async def _exchange(self, unit: Unit, block: Block) -> tuple[Answer, float, float]:
        await asyncio.sleep(max(0.0, self._free_s - monotonic()))
        self._discard()
        begin_s = monotonic()
        self._send(request(unit.address, unit.function, block.first, block.count))
        unit.in_step = False  # until it has answered, whatever happens
        answer = await self._answer(unit, block, begin_s + unit.timeout_s)
        self._free_s = monotonic() + self._silence_s
        if answer is None:
            unit.alone_until_s = 0.0 if unit.probe else monotonic() + self._quarantine_s(unit)
            damaged = " intact" if self._received else ""
            message = f"unit {unit.address} does not answer{damaged} within {unit.timeout_s * 1e3:.0f} ms"
            raise NoAnswerError(message)
        unit.in_step = True
        return answer, begin_s, monotonic()

    async def _answer(self, unit: Unit, block: Block, deadline_s: float) -> Answer | None:
        """Wait for the answer; None if it does not come, or damaged."""
        expected = answer_bytes(block.count)
        while True:
            self._arrived.clear()
            answer = find_answer(bytes(self._received), unit.address, unit.function, block.count)
            if answer is not None:
                self._received.clear()
                return answer
            left_s = deadline_s - monotonic()
            if len(self._received) >= expected:
                left_s = min(left_s, DAMAGED_AFTER_S)
            if left_s <= 0 or not await self._more(left_s):
                return None

    async def _more(self, within_s: float) -> bool:
        """Wait for more bytes; False if none came."""
        try:
            async with asyncio.timeout(within_s):
                await self._arrived.wait()
        except TimeoutError:
            return False
        if self._port is None:
            message = f"{self._settings.port} is gone"
            raise SourceError(message)
        return True

    def _quarantine_s(self, unit: Unit) -> float:
        return max(QUARANTINE_S, QUARANTINE_TIMEOUTS * unit.timeout_s)

    def _discard(self) -> None:
        """Throw away what came unasked; whoever may have sent it is out of step."""
        self._read()
        for unit in self._units.values():
            if bytes([unit.address, unit.function]) in self._received:
                unit.in_step = False
        self._received.clear()

    def _open(self) -> None:
        if self._port is not None:
            return
        settings = self._settings
        try:
            self._port = serial.Serial(
                settings.port,
                settings.baud,
                parity=_PARITIES[settings.parity],
                stopbits=settings.stop_bits,
                timeout=0,
                write_timeout=0,
                exclusive=True,
            )
        except (OSError, ValueError, termios.error) as error:
            message = f"{settings.port} cannot be opened; is it there, and does no other program use it? ({error})"
            raise SourceError(message) from error
        asyncio.get_running_loop().add_reader(self._port.fileno(), self._read)

    def _close(self) -> None:
        if self._port is not None:
            asyncio.get_running_loop().remove_reader(self._port.fileno())
            with contextlib.suppress(OSError):  # an unplugged device may complain
                self._port.close()
            self._port = None
            self._arrived.set()

    def _read(self) -> None:
        if self._port is None:
            return
        try:
            data = self._port.read(_READ_BYTES)
        except (OSError, termios.error):
            self._close()  # its users notice, and open it anew
            return
        if data:
            self._received += data
            del self._received[:-_READ_BYTES]
            self._arrived.set()

    def _send(self, frame: bytes) -> None:
        try:
            sent = self._port.write(frame) if self._port is not None else 0
        except (OSError, termios.error):
            self._close()
            sent = 0
        if sent != len(frame):
            message = f"{self._settings.port} is gone, or takes no data"
            raise SourceError(message)
