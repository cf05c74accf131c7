"""Names the bytes of a Modbus line, for the debug log. Pure."""

from collections import Counter
from itertools import pairwise
from typing import NamedTuple

from pymodbus.framer import FramerRTU

from beamtouch_daemon.sources.registers import Block, answer_to
from beamtouch_daemon.sources.rtu_frames import MAX_FRAME_BYTES, READ_FUNCTIONS, answers_of, senders_of
from beamtouch_daemon.sources.traffic import text_of

MOST_BYTES = 64
"""More bytes of a frame are not shown."""
REFUSAL_BYTES, REQUEST_BYTES, SHORTEST_BYTES = 5, 8, 4
"""Lengths of a refusal (unit, function, exception and checksum), of a request to read, and of the shortest frame."""
FEW_BYTES = 2
"""So few bytes can be anything."""
_CONTENTS = {1: "coil", 2: "discrete input"}
MANY_TIMES, SEQUENCE_BYTES = 3, 3
"""Bytes in which a sequence of this length comes this often are no noise."""
_STRAY = "noise, no bias or termination, or a transmitter that is switched too late"
_NO_LEVEL = (
    "only 00 and ff, so the line has no level between frames: exchange A and B, and if no unit answers then, look for "
    "missing bias or termination"
)
_NO_FRAME = (
    "no Modbus frame: another baud rate or parity, a device of another protocol, no termination or bias, or A and B "
    "swapped"
)
_UNREADABLE_TRAFFIC = (
    "no Modbus frame, but sequences that repeat though nothing was asked: another master is on the line, at another "
    "baud rate or parity"
)


class Request(NamedTuple):
    """A request that was sent before the bytes came that are to be named."""

    address: int
    block: Block
    sent_s: float
    """By the clock of `uptime_s`."""
    answer: bytes = b""
    """The frame that answered it in time; empty if none did."""


def holds_answer(data: bytes, request: Request) -> bool:
    """Return whether bytes hold an intact answer to a request."""
    return any(answer_to(request.block, answer) for _, answer in answers_of(request.address, data))


def in_hex(data: bytes) -> str:
    """Return bytes in hexadecimal digits, at most `MOST_BYTES` of them."""
    more = f" and {len(data) - MOST_BYTES} bytes more" if len(data) > MOST_BYTES else ""
    return f"{data[:MOST_BYTES].hex(' ')}{more}"


def describe_request(address: int, block: Block, request: bytes) -> str:
    """Return what a unit is asked for."""
    last, things = block.first + block.count - 1, _CONTENTS.get(block.function, "register")
    places = f"{things} {block.first}" if block.count == 1 else f"{things}s {block.first} to {last}"
    return f"unit {address} asked for {places} by function {block.function} ({in_hex(request)})"


def describe_silence(path: str, address: int, *, has_answered: bool, others_answer: bool) -> str:
    """Return what to check where nothing came that answers a unit on the port `path`.

    Parameters
    ----------
    path : Of the port.
    address : The unit that was asked.
    has_answered : True if it has answered since the port was opened.
    others_answer : True if other units have.
    """
    if has_answered:
        return f"unit {address} has answered before: check its supply and its cable, or raise timeout_ms"
    if others_answer:
        return f"other units answer, so the line works: check the number of unit {address}, its supply and its cable"
    return (
        f"silence has many reasons: with the daemon stopped, `beamtouch-daemon scan {path}` finds baud, parity and "
        "number; if it finds no unit, exchange A and B, then check the supply"
    )


def describe_received(
    came: bytes,
    request: bytes = b"",
    address: int | None = None,
    earlier: Request | None = None,
    now_s: float = 0.0,
    *,
    has_answered: bool = False,
) -> str:
    """Return what bytes are that came while a unit was asked, or before that, and that do not answer the request.

    Parameters
    ----------
    came : All that came, with an echo of the request.
    request : The frame that was sent before them; empty if none was.
    address : The unit that was asked; None if none was.
    earlier : The request before that; None if there was none.
    now_s : The time by which they had come, by the clock of `uptime_s`.
    has_answered : True if the unit has answered since the port was opened.
    """
    if not came:
        return "not a byte came"
    others = came.replace(request, b"") if request else came
    echo = "the request itself, which an adapter echoes"
    kinds = [echo if others else f"{echo}, and nothing else"] if others != came else []
    if others and not others.strip(b"\0\xff" if len(others) > FEW_BYTES else b"\0"):
        kinds.append(_NO_LEVEL)
    elif 0 < len(others) <= FEW_BYTES:
        kinds.append(f"too few bytes to tell what they are: {_STRAY}")
    elif others and request.startswith(others):
        kinds.append("a part of the request itself, which an adapter echoes")
    elif others:
        kind = _kind_of(others, address, has_answered=has_answered)
        kinds.append(_describe_earlier(others, earlier, now_s) or kind)
    return f"{_count(came)} came ({in_hex(came)}): {', then '.join(kinds)}"


def describe_beside(
    before: bytes, after: bytes, asked: Request, earlier: Request | None, now_s: float, *, is_echoed: bool
) -> str:
    """Return what came beside an answer; empty if nothing did.

    Parameters
    ----------
    before, after : The bytes around the answer, without an echo of the request.
    asked : The request that was answered.
    earlier : The request before it; None if there was none.
    now_s : The time by which they had come, by the clock of `uptime_s`.
    is_echoed : True if the request itself came, too.
    """
    address, remarks = asked.address, ["the adapter echoes requests"] if is_echoed else []
    if before:
        kind = _describe_earlier(before, earlier, now_s) or _stray_or_other(before, address)
        remarks.append(f"{_count(before)} came before it ({in_hex(before)}): {kind}")
    if after:
        kind = _describe_earlier(after, asked, now_s) or _stray_or_other(after, address)
        remarks.append(f"{_count(after)} came after it ({in_hex(after)}): {kind}")
    return "; ".join(remarks)


def _stray_or_other(data: bytes, address: int) -> str:
    if len(data) <= FEW_BYTES:
        return f"stray bytes, harmless while answers come intact: {_STRAY}"
    return _kind_of(data, address, has_answered=True)


def _count(data: bytes) -> str:
    return f"{len(data)} byte{'s' * (len(data) > 1)}"


def _describe_earlier(data: bytes, earlier: Request | None, now_s: float) -> str:
    """Return that bytes hold an answer to an earlier request; empty if they do not."""
    if earlier is None or not holds_answer(data, earlier):
        return ""
    if earlier.answer:
        second = f"a second answer of unit {earlier.address} to one request"
        if earlier.answer in data:
            return f"{second}, equal to the first: an adapter that repeats, or two units with this number"
        return f"{second}, unlike the first: two units have the number {earlier.address}"
    after_ms = (now_s - earlier.sent_s) * 1e3
    return (
        f"the late answer of unit {earlier.address} to the request before, read {after_ms:.0f} ms after it: raise "
        "timeout_ms"
    )


def _kind_of(data: bytes, address: int | None, *, has_answered: bool) -> str:
    """Return what bytes are that are no answer of a unit to the request before them."""
    if senders := sorted(senders_of(data)):
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
            return _describe_damaged(data[begin:], sender, has_answered=has_answered)
    if text := text_of(data):
        return f"text: {text!r}"
    return _UNREADABLE_TRAFFIC if address is None and _repeats(data) else _NO_FRAME


def _repeats(data: bytes) -> bool:
    """Return whether a sequence of bytes comes so often that they are no noise."""
    sequences = Counter(data[start : start + SEQUENCE_BYTES] for start in range(len(data) - SEQUENCE_BYTES + 1))
    return max(sequences.values(), default=0) >= MANY_TIMES


def _intact_frame(data: bytes) -> bytes:
    """Return the frame with which bytes begin or end, whatever its function; empty if there is none."""
    ends = range(SHORTEST_BYTES, min(len(data), MAX_FRAME_BYTES) + 1)
    frames = (frame for end in ends for frame in (data[:end], data[-end:]))
    return next((frame for frame in frames if FramerRTU.compute_CRC(frame[:-2]).to_bytes(2, "big") == frame[-2:]), b"")


def _describe_damaged(data: bytes, sender: int, *, has_answered: bool) -> str:
    """Return what is wrong with an answer that has the right beginning."""
    stated = REFUSAL_BYTES + (0 if data[1] & 0x80 or len(data) == 2 else data[2])
    if len(data) < stated:
        broken = f"which breaks off after {len(data)} of {stated} bytes"
        return f"the beginning of an answer of unit {sender}, {broken}: the timeout is too short, or the line is bad"
    damaged = f"an answer of unit {sender} with a wrong checksum"
    if has_answered:
        return f"{damaged}, where others were intact: a bad line (wiring, termination, noise), or two masters"
    return (
        f"{damaged}, and none was intact: probably two units have the number {sender} (leave one alone on the line to "
        "see), or a bad line"
    )
