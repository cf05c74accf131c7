"""Names the bytes of a Modbus line, for the debug log. Pure."""

from beamtouch_daemon.sources.registers import Block
from beamtouch_daemon.sources.rtu_frames import READ_FUNCTIONS, answers_of
from beamtouch_daemon.sources.traffic import text_of

MOST_BYTES = 64
"""More bytes of a frame are not shown."""
REFUSAL_BYTES = 5
"""Length of a refusal: unit, function, exception and checksum."""
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
    last = block.first + block.count - 1
    registers = f"register {block.first}" if block.count == 1 else f"registers {block.first} to {last}"
    return f"unit {address} asked for {registers} by function {block.function} ({in_hex(request)})"


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
    if others:
        kinds.append(_kind_of(others, address))
    return f"{len(came)} bytes came ({in_hex(came)}): {', then '.join(kinds)}"


def _kind_of(data: bytes, address: int | None) -> str:
    """Return what bytes are that are no answer of a unit to the request before them."""
    if senders := [sender for sender in sorted(set(data)) if any(answers_of(sender, data))]:
        late = ", to an earlier request or to another master" if address in (None, *senders) else ""
        return f"an intact answer of unit {', '.join(map(str, senders))}{late}"
    if len(data) > 1 and data[1] & 0x7F in READ_FUNCTIONS and address in (None, data[0]):
        return f"the beginning of an answer of unit {data[0]}, {_fault_of(data)}"
    if text := text_of(data):
        return f"text: {text!r}"
    return _NO_FRAME


def _fault_of(data: bytes) -> str:
    """Return what is wrong with an answer that has the right beginning."""
    stated = REFUSAL_BYTES + (0 if data[1] & 0x80 or len(data) == 2 else data[2])
    if len(data) < stated:
        return f"which breaks off after {len(data)} of {stated} bytes: the timeout is too short, or the line is bad"
    return "with a wrong checksum: a bad line, two units with the same number, or two masters"
