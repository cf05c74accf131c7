"""An open port as a Modbus RTU line: requests of one master, one at a time, and the answers to them."""

import asyncio
from collections.abc import AsyncIterator, Callable, Iterator
from contextlib import asynccontextmanager
from dataclasses import dataclass

from pymodbus.framer import FramerRTU

from beamtouch_common.uptime import uptime_s
from beamtouch_daemon.sources.reading import NoAnswerError
from beamtouch_daemon.sources.registers import DECODER, Answer, Block, answer_to
from beamtouch_daemon.sources.requests import Failure, insist
from beamtouch_daemon.sources.rtu_unit import READ_FUNCTIONS
from beamtouch_daemon.sources.serial_port import SerialPort

BITS_PER_CHARACTER = 11
MIN_SILENCE_S = 0.00175
"""Silence between frames: 3.5 characters, or this long above 19200 baud."""
QUIET_S = (0.1, 0.5)
"""Bounds of the silence that a proof needs at the start of a session; in between, it is one timeout."""
_FRAMER = FramerRTU(DECODER)
_ENVELOPE_BYTES = 3
"""Unit and checksum."""


class RtuLine:
    """An open port that carries requests and answers, one pair at a time.

    Parameters
    ----------
    port : The open port.
    silence_s : Silence between two frames [s].
    take_unexpected : Is given bytes that were no answer to the request on the line.
    """

    def __init__(
        self, port: SerialPort, silence_s: float, take_unexpected: Callable[[bytes], None] = lambda _: None
    ) -> None:
        self.port = port
        self._silence_s = silence_s
        self._take_unexpected = take_unexpected
        self._lock = asyncio.Lock()
        """Held for one request and its answer."""
        self._free_s = 0.0

    async def exchange(self, address: int, block: Block, timeout_s: float) -> Answer:
        """Send a request to a unit; return its answer or refusal, NoAnswerError if neither comes intact in time."""
        request = encode(address, block)
        async with self._held():
            asked_s, received = uptime_s(), b""
            self.port.send(request)
            while (left_s := asked_s + timeout_s - uptime_s()) > 0:
                received += await self.port.receive(left_s)
                received = received.replace(request, b"")  # adapters may echo
                for end, data in answers_of(address, received):
                    if answer := answer_to(block, data, asked_s):
                        self.port.traffic.note_frame(uptime_s())
                        self._take_unexpected(received[end:])
                        return answer
        within = f"within {timeout_s * 1e3:.0f} ms"
        self._note(received)
        if any(answers_of(address, received)):
            raise NoAnswerError(f"unit {address} answers, but not {within}: its answers come late", Failure.LATE)
        if received:
            raise NoAnswerError(f"unit {address} does not answer intact {within}", Failure.DAMAGED)
        raise NoAnswerError(f"unit {address} does not answer {within}")

    async def is_quiet(self, address: int, timeout_s: float) -> bool:
        """Listen for answers of a unit to an earlier program; return whether none came."""
        until_s = uptime_s() + min(max(timeout_s, QUIET_S[0]), QUIET_S[1])
        async with self._held() as unexpected:
            received = unexpected
            while (left_s := until_s - uptime_s()) > 0:
                received += await self.port.receive(left_s)
            received += self.port.take()  # a busy machine reads late
        codes = [code for function in READ_FUNCTIONS for code in (function, function | 0x80)]
        return not any(bytes([address, code]) in received for code in codes)

    def _note(self, received: bytes) -> None:
        """Note what came beside the answers: frames of other units, or something else."""
        if any(any(answers_of(address, received)) for address in set(received)):
            self.port.traffic.note_frame(uptime_s())
        else:
            self.port.traffic.note_other(received)

    @asynccontextmanager
    async def _held(self) -> AsyncIterator[bytes]:
        """Hold the line, once it has been silent for long enough; give what came unexpectedly."""
        async with self._lock:
            await asyncio.sleep(max(0.0, self._free_s - uptime_s()))
            unexpected = self.port.take()
            self._note(unexpected)
            self._take_unexpected(unexpected)
            try:
                yield unexpected
            finally:
                self._free_s = uptime_s() + self._silence_s


@dataclass(frozen=True, slots=True)
class UnitLine:
    """The way to one unit on a line."""

    line: RtuLine
    address: int
    timeout_s: float

    async def ask(self, block: Block) -> Answer:
        """Send a request, again while its refusal may pass; NoAnswerError if no answer comes intact in time."""
        return await insist(self.ask_once, block)

    async def ask_once(self, block: Block) -> Answer:
        """Send a request; return its answer or refusal, NoAnswerError if neither comes intact in time."""
        return await self.line.exchange(self.address, block, self.timeout_s)

    async def is_quiet(self) -> bool:
        """Listen for answers that nobody asked for; return whether none came."""
        return await self.line.is_quiet(self.address, self.timeout_s)


def encode(address: int, block: Block) -> bytes:
    """Return the frame of a request."""
    frame: bytes = _FRAMER.encode(block.request, address, 0)
    return frame


def silence_of(baud: int) -> float:
    """Return the silence between two frames on a bus, as in the standard [s]."""
    return max(MIN_SILENCE_S if baud > 19_200 else 0.0, 3.5 * BITS_PER_CHARACTER / baud)


def answers_of(address: int, received: bytes) -> Iterator[tuple[int, bytes]]:
    """Yield function and contents of all intact answers of a unit, each with the place behind it.

    A frame has no start mark, only a checksum at its end. So everything that begins as an answer of the unit is tried.
    """
    for begin in range(len(received) - 1):
        if received[begin] == address and received[begin + 1] & 0x7F in READ_FUNCTIONS:
            *_, data = _FRAMER.decode(received[begin:])
            if data:
                yield begin + len(data) + _ENVELOPE_BYTES, data
