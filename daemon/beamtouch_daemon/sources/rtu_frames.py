"""Frames of Modbus RTU: requests, the answers in what was received, and the silence between them. Pure."""

from collections.abc import Iterator

from pymodbus.framer import FramerRTU

from beamtouch_daemon.sources.registers import DECODER, Block

READ_FUNCTIONS = (4, 3, 1, 2)
"""Functions that only read, so that a probe never changes a device."""
BITS_PER_CHARACTER = 11
MIN_SILENCE_S = 0.00175
"""Silence between frames: 3.5 characters, or this long above 19200 baud."""
_FRAMER = FramerRTU(DECODER)
ENVELOPE_BYTES = 3
"""Unit and checksum."""
MAX_FRAME_BYTES = 256
"""Of the standard."""


def encode(address: int, block: Block) -> bytes:
    """Return the frame of a request."""
    frame: bytes = _FRAMER.encode(block.request, address, 0)
    return frame


def silence_of(baud: int) -> float:
    """Return the silence between two frames on a bus, as in the standard [s]."""
    return max(MIN_SILENCE_S if baud > 19_200 else 0.0, 3.5 * BITS_PER_CHARACTER / baud)


def answers_of(address: int, received: bytes, start: int = 0) -> Iterator[tuple[int, bytes]]:
    """Yield function and contents of all intact answers of a unit, each with the place behind it.

    A frame has no start mark, only a checksum at its end. So everything that begins as an answer of the unit is tried,
    from the byte `start` on.
    """
    return ((begin + len(data) + ENVELOPE_BYTES, data) for begin, data in _frames_in(received, {address}, start))


def senders_of(received: bytes) -> set[int]:
    """Return the units of which there are intact answers, in a time that is proportional to the number of bytes."""
    return {received[begin] for begin, _ in _frames_in(received, set(received), 0)}


def _frames_in(received: bytes, addresses: set[int], start: int) -> Iterator[tuple[int, bytes]]:
    """Yield where an intact answer of one of these units begins, with its function and contents."""
    for begin in range(start, len(received) - 1):
        if received[begin + 1] & 0x7F in READ_FUNCTIONS and received[begin] in addresses:
            *_, data = _FRAMER.decode(received[begin : begin + MAX_FRAME_BYTES])
            if data:
                yield begin, data
