"""Frames of Modbus RTU for reading registers. Pure; no I/O.

A frame has no start mark and no number, only a checksum at its end. An answer is identified by unit, function and
length, so the functions here require all three and skip everything else in the buffer.
"""

import struct
from collections.abc import Sequence
from typing import NamedTuple

from pymodbus.framer.rtu import FramerRTU

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


def find_frame(buffer: bytes, unit: int, function: int) -> bool:
    """Return whether a buffer contains an answer of any length from a unit to a function, or its refusal."""
    refusal = bytes([unit, function | EXCEPTION])
    answer = bytes([unit, function])
    for begin in range(len(buffer) - EXCEPTION_BYTES + 1):
        if buffer.startswith(refusal, begin):
            length = EXCEPTION_BYTES
        elif buffer.startswith(answer, begin):
            length = ENVELOPE_BYTES + buffer[begin + 2]
        else:
            continue
        frame = buffer[begin : begin + length]
        if len(frame) == length and with_checksum(frame[:-2]) == frame:
            return True
    return False


def is_damaged(buffer: bytes, unit: int, function: int, count: int) -> bool:
    """Return whether a buffer contains the start of an answer and enough bytes, but no intact answer."""
    begin = buffer.find(bytes([unit, function, 2 * count]))
    return begin >= 0 and len(buffer) - begin >= answer_bytes(count)


def find_answer(buffer: bytes, unit: int, function: int, count: int) -> Answer | None:
    """Return the first answer of a unit with `count` registers, or its refusal, in a buffer; None if none."""
    whole = bytes([unit, function, 2 * count])
    refusal = bytes([unit, function | EXCEPTION])
    for begin in range(len(buffer) - EXCEPTION_BYTES + 1):
        if buffer.startswith(whole, begin) and _is_intact(buffer[begin : begin + answer_bytes(count)], count):
            return Answer(struct.unpack_from(f">{count}H", buffer, begin + len(whole)))
        if buffer.startswith(refusal, begin):
            frame = buffer[begin : begin + EXCEPTION_BYTES]
            if with_checksum(frame[:-2]) == frame:
                return Answer(exception=frame[2])
    return None


def _is_intact(frame: bytes, count: int) -> bool:
    return len(frame) == answer_bytes(count) and with_checksum(frame[:-2]) == frame
