"""Names the bytes of a Modbus line, for the debug log. Pure."""

from itertools import pairwise

from pymodbus.framer import FramerRTU

from beamtouch_daemon.sources.registers import Block
from beamtouch_daemon.sources.rtu_frames import READ_FUNCTIONS, answers_of
from beamtouch_daemon.sources.traffic import text_of

MOST_BYTES = 64
"""More bytes of a frame are not shown."""
REFUSAL_BYTES, REQUEST_BYTES, SHORTEST_BYTES = 5, 8, 4
"""Lengths of a refusal (unit, function, exception and checksum), of a request to read, and of the shortest frame."""
FEW_BYTES = 2
"""So few bytes can be anything."""
_CONTENTS = {1: "coil", 2: "discrete input"}
_NO_FRAME = (
    "no Modbus frame: another baud rate or parity, A and B swapped, no termination or bias, or a device of another "
    "protocol"
)


def in_hex(data: bytes) -> str:
    """Return bytes in hexadecimal digits, at most `MOST_BYTES` of them."""
    more = f" and {len(data) - MOST_BYTES} bytes more" if len(data) > MOST_BYTES else ""
    return f"{data[:MOST_BYTES].hex(' ')}{more}"


def describe_request(address: int, block: Block, request: bytes) -> str:
    """Return what a unit is asked for."""
    last, things = block.first + block.count - 1, _CONTENTS.get(block.function, "register")
    places = f"{things} {block.first}" if block.count == 1 else f"{things}s {block.first} to {last}"
    return f"unit {address} asked for {places} by function {block.function} ({in_hex(request)})"


def describe_received(came: bytes, request: bytes = b"", address: int | None = None) -> str:
    """Return what bytes are that came while a unit was asked, or before that, and that do not answer the request.

    Parameters
    ----------
    came : All that came, with an echo of the request.
    request : The frame that was sent before them; empty if none was.
    address : The unit that was asked; None if none was.
    """
    if not came:
        return "not a byte came"
    others = came.replace(request, b"") if request else came
    kinds = ["the request itself, which an adapter echoes"] if others != came else []
    if 0 < len(others) <= FEW_BYTES:
        kinds.append("too few bytes to tell what they are")
    elif others and request.startswith(others):
        kinds.append("a part of the request itself, which an adapter echoes")
    elif others:
        kinds.append(_kind_of(others, address))
    return f"{len(came)} byte{'s' * (len(came) > 1)} came ({in_hex(came)}): {', then '.join(kinds)}"


def _kind_of(data: bytes, address: int | None) -> str:
    """Return what bytes are that are no answer of a unit to the request before them."""
    if senders := [sender for sender in sorted(set(data)) if any(answers_of(sender, data))]:
        other = (
            ", to an earlier request, to another master, or of another length" if address in (None, *senders) else ""
        )
        return f"an intact answer of unit{'s' * (len(senders) > 1)} {' and '.join(map(str, senders))}{other}"
    if frame := _intact_frame(data):
        unit, function = frame[:2]
        if len(frame) == REQUEST_BYTES and function in READ_FUNCTIONS:
            return f"a request of another master to unit {unit}"
        return f"an intact frame with function {function}, of unit {unit} or to it: another master is on the line"
    for begin, (sender, function) in enumerate(pairwise(data)):
        if function & 0x7F in READ_FUNCTIONS and address in (None, sender):
            return f"the beginning of an answer of unit {sender}, {_fault_of(data[begin:])}"
    if text := text_of(data):
        return f"text: {text!r}"
    return _NO_FRAME


def _intact_frame(data: bytes) -> bytes:
    """Return the frame with which bytes begin or end, whatever its function; empty if there is none."""
    ends = range(SHORTEST_BYTES, len(data) + 1)
    frames = (frame for end in ends for frame in (data[:end], data[-end:]))
    return next((frame for frame in frames if FramerRTU.compute_CRC(frame[:-2]).to_bytes(2, "big") == frame[-2:]), b"")


def _fault_of(data: bytes) -> str:
    """Return what is wrong with an answer that has the right beginning."""
    stated = REFUSAL_BYTES + (0 if data[1] & 0x80 or len(data) == 2 else data[2])
    if len(data) < stated:
        return f"which breaks off after {len(data)} of {stated} bytes: the timeout is too short, or the line is bad"
    return "with a wrong checksum: a bad line, two units with the same number, or two masters"
