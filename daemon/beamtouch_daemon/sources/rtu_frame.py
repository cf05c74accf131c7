"""Frames of Modbus RTU for reading registers. Pure; no I/O.

A frame has no start mark and no number, only a checksum at its end. An answer is identified by unit, function and
length, so the functions here require all three and skip everything else in the buffer.
"""

import struct
from collections.abc import Sequence
from typing import NamedTuple

from pymodbus.framer.rtu import FramerRTU

from beamtouch_daemon.sources.registers import Block

EXCEPTION = 0x80
"""Added to the function code in a refusal."""
EXCEPTION_BYTES = 5
ENVELOPE_BYTES = 5
"""Unit, function, number of bytes, and the checksum."""


class Answer(NamedTuple):
    """An answer to a request for registers."""

    registers: Sequence[int] = ()
    exception: int = 0
    """Code of the refusal; 0: not refused."""


def request(unit: int, function: int, first: int, count: int) -> bytes:
    """Return the frame that asks for registers."""
    return with_checksum(struct.pack(">BBHH", unit, function, first, count))


def with_checksum(body: bytes) -> bytes:
    """Return a body with its checksum."""
    return body + FramerRTU.compute_CRC(body).to_bytes(2, "big")


def answer_bytes(count: int) -> int:
    """Return the length of an answer with `count` registers."""
    return ENVELOPE_BYTES + 2 * count


def begins(buffer: bytes, unit: int, function: int, block: Block) -> bool:
    """Return whether a buffer contains the start of an answer of a unit to a request for a block, or of its refusal."""
    return bytes([unit, function, 2 * block.count]) in buffer or bytes([unit, function | EXCEPTION]) in buffer


def is_damaged(buffer: bytes, unit: int, function: int, count: int) -> bool:
    """Return whether a buffer contains the start of an answer and enough bytes, but no intact answer."""
    begin = buffer.find(bytes([unit, function, 2 * count]))
    return begin >= 0 and len(buffer) - begin >= answer_bytes(count)


def find_answer(buffer: bytes, unit: int, function: int, count: int | None) -> Answer | None:
    """Return the first intact answer of a unit to a function, or its refusal, in a buffer; None if none.

    Parameters
    ----------
    buffer
        Received bytes.
    unit, function
        Of the request.
    count
        Registers in the answer; None for an answer of any length, whose registers are left out.
    """
    answer, refusal = bytes([unit, function]), bytes([unit, function | EXCEPTION])
    for begin in range(len(buffer) - EXCEPTION_BYTES + 1):
        if buffer.startswith(refusal, begin):
            frame = buffer[begin : begin + EXCEPTION_BYTES]
            if _is_intact(frame, EXCEPTION_BYTES):
                return Answer(exception=frame[2])
        elif buffer.startswith(answer, begin) and (count is None or buffer[begin + 2] == 2 * count):
            length = ENVELOPE_BYTES + buffer[begin + 2]
            frame = buffer[begin : begin + length]
            if _is_intact(frame, length):
                return Answer(() if count is None else struct.unpack_from(f">{count}H", frame, 3))
    return None


def _is_intact(frame: bytes, length: int) -> bool:
    return len(frame) == length and with_checksum(frame[:-2]) == frame
