"""Frames on the wire: COBS over body and CRC-32, ended by a zero byte.

The body is one type byte and the payload. Of the messages, this module uses only the table from type number to class.
"""

import zlib
from dataclasses import dataclass, field
from enum import StrEnum

from cobs import cobs

from beamtouch_protocol.messages import MAX_PAYLOAD_BYTES, MESSAGE_TYPES, Message, crc_seed

DELIMITER = b"\0"
"""Ends every frame and occurs nowhere inside one."""

_CRC_BYTES = 4
_MAX_CONTENT_BYTES = 1 + MAX_PAYLOAD_BYTES + _CRC_BYTES
MAX_FRAME_BYTES = 1 + _MAX_CONTENT_BYTES + len(DELIMITER)
"""The longest frame with its delimiter; COBS adds one byte to anything shorter than 254."""


class Rejection(StrEnum):
    """Reason to reject a frame."""

    OVERLONG = "overlong"
    """More bytes without a delimiter than any frame has."""
    COBS = "cobs"
    """A COBS block reaches beyond the end."""
    LENGTH = "length"
    """Too short for a type and a checksum, or a length that the message cannot have."""
    CRC = "crc"
    """The checksum does not match: the frame is damaged or from another version of the protocol."""
    TYPE = "type"
    """An intact frame of an unknown type."""


@dataclass(slots=True)
class DecoderCounts:
    """Counts of a decoder since its creation."""

    frames: int = 0
    """Frames that became a message."""
    rejected_by: dict[Rejection, int] = field(default_factory=lambda: dict.fromkeys(Rejection, 0))
    """Rejected frames, by reason."""

    @property
    def rejected(self) -> int:
        """Rejected frames, for any reason."""
        return sum(self.rejected_by.values())


def encode(message: Message) -> bytes:
    """Return a message's frame with its delimiter; ValueError with the field's name if a value is out of range."""
    body = bytes([message.TYPE]) + message.to_bytes()
    encoded: bytes = cobs.encode(body + _checksum(body))
    return encoded + DELIMITER


class Decoder:
    """Decodes a stream of bytes, in chunks of any size, to messages.

    Never raises on bad input and holds at most one frame. After garbage it resynchronises at the next delimiter. Empty
    frames are skipped, so a sender may begin with a delimiter to end a partial frame on the line.
    """

    def __init__(self) -> None:
        self.counts = DecoderCounts()
        self._frame = bytearray()
        self._skipping = False

    def feed(self, data: bytes) -> list[Message]:
        """Return the messages that `data` completes, in order of arrival."""
        messages = []
        *ends, begin = data.split(DELIMITER)
        for end in ends:
            self._append(end)
            message = self._finish()
            if message is not None:
                messages.append(message)
        self._append(begin)
        return messages

    def _append(self, data: bytes) -> None:
        if self._skipping:
            return
        if len(self._frame) + len(data) >= MAX_FRAME_BYTES:
            self._skipping = True
            self._frame.clear()
            self.counts.rejected_by[Rejection.OVERLONG] += 1
            return
        self._frame += data

    def _finish(self) -> Message | None:
        frame = bytes(self._frame)
        self._frame.clear()
        self._skipping = False
        if not frame:
            return None
        result = _decode(frame)
        if isinstance(result, Rejection):
            self.counts.rejected_by[result] += 1
            return None
        self.counts.frames += 1
        return result


def _checksum(body: bytes) -> bytes:
    return zlib.crc32(body, crc_seed(body[0])).to_bytes(_CRC_BYTES, "little")


def _decode(frame: bytes) -> Message | Rejection:
    """Return the message in a frame without its delimiter, or the reason to reject it."""
    try:
        content: bytes = cobs.decode(frame)
    except cobs.DecodeError:
        return Rejection.COBS
    body, checksum = content[:-_CRC_BYTES], content[-_CRC_BYTES:]
    if not body:
        return Rejection.LENGTH
    if checksum != _checksum(body):
        return Rejection.CRC
    message = MESSAGE_TYPES.get(body[0])
    if message is None:
        return Rejection.TYPE
    try:
        return message.from_bytes(body[1:])
    except ValueError:
        return Rejection.LENGTH
