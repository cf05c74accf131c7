"""The messages between host and device, and the hash that tells one set of them from another.

Type numbers below 0x80 go from host to device, the others from device to host; an answer has the number of its
question plus 0x80. The numbers between are kept for messages to come.
"""

import zlib
from dataclasses import dataclass
from typing import ClassVar, get_args

from beamtouch_protocol.wire import U8, U16, U32, Counts, Payload

PROTOCOL_VERSION = 1
"""Raised with every change to a message or to its meaning."""


@dataclass(frozen=True, slots=True)
class HelloRequest(Payload):
    """Host to device: say who you are. Changes nothing, also not a running stream."""

    TYPE: ClassVar[int] = 0x01


@dataclass(frozen=True, slots=True)
class Ping(Payload):
    """Host to device: what does your clock say? Changes nothing."""

    TYPE: ClassVar[int] = 0x02

    token: U16
    """Comes back in the answer, so that a late answer is not taken for the one to a later question."""


@dataclass(frozen=True, slots=True)
class Identify(Payload):
    """Host to device: show yourself, so that a person sees which device this is. There is no answer."""

    TYPE: ClassVar[int] = 0x03

    seconds: U8
    """How long to blink; 0 ends it."""


@dataclass(frozen=True, slots=True)
class Start(Payload):
    """Host to device: send readings from now on, or go on as this says."""

    TYPE: ClassVar[int] = 0x10

    rate_hz: U16
    """Readings per second, from 1 to the device's `max_rate_hz`; a device ignores any other."""
    oversampling: U8
    """Conversions of each channel that a count is the sum of, at least 1; a device ignores what it cannot keep."""


@dataclass(frozen=True, slots=True)
class Stop(Payload):
    """Host to device: send no more readings."""

    TYPE: ClassVar[int] = 0x11


@dataclass(frozen=True, slots=True)
class Hello(Payload):
    """Device to host, at boot and on request: who I am. The same layout in all versions, for ever.

    It decodes whatever its values are, as a foreign version may have other limits; check `is_compatible` before
    anything else in it is believed.
    """

    TYPE: ClassVar[int] = 0x81

    protocol_version: U8
    """`PROTOCOL_VERSION` of the device."""
    schema_hash: U32
    """`SCHEMA_HASH` of the device; decides whether the two understand each other."""
    boot_id: U32
    """Differs from boot to boot, constant in between."""
    channel_count: U8
    """Counts in each reading, 1 to 32."""
    adc_bits: U8
    """One conversion gives 0 to 2**adc_bits - 1; 1 to 16."""
    max_rate_hz: U16
    """The most readings per second, without oversampling, that ADC and line can keep up."""

    @property
    def is_compatible(self) -> bool:
        """Whether the device speaks exactly the messages of this module."""
        return (self.protocol_version, self.schema_hash) == (PROTOCOL_VERSION, SCHEMA_HASH)


@dataclass(frozen=True, slots=True)
class Pong(Payload):
    """Device to host, the answer to `Ping`."""

    TYPE: ClassVar[int] = 0x82

    token: U16
    """That of the ping."""
    device_us: U32
    """Device clock while the ping was handled, in microseconds, modulo 2**32."""


@dataclass(frozen=True, slots=True)
class Reading(Payload):
    """Device to host: the raw counts of all channels at one instant. Never sent a second time."""

    TYPE: ClassVar[int] = 0x90

    sequence: U16
    """Number of the scan since boot, modulo 2**16; a gap is a loss."""
    device_us: U32
    """Device clock at the middle of the scan, in microseconds, modulo 2**32."""
    oversampling: U8
    """Conversions that each count is the sum of, at least 1."""
    counts: Counts
    """One value per channel, in channel order."""


Message = HelloRequest | Ping | Identify | Start | Stop | Hello | Pong | Reading

MESSAGE_TYPES: dict[int, type[Message]] = {message.TYPE: message for message in get_args(Message)}
"""The class of each type number."""

SCHEMA_TEXT = "".join(
    f"{line}\n"
    for line in (
        f"beamtouch protocol {PROTOCOL_VERSION}",
        *(MESSAGE_TYPES[number].schema() for number in sorted(MESSAGE_TYPES)),
    )
)
"""All messages in canonical form: ASCII, ordered by type number, each line ended by a line feed."""

SCHEMA_HASH = zlib.crc32(SCHEMA_TEXT.encode("ascii"))
"""CRC-32 of the schema text."""

MAX_PAYLOAD_BYTES = max(message.greatest_length() for message in MESSAGE_TYPES.values())
"""Length of the longest payload: a reading of 32 channels."""


def crc_seed(type_number: int) -> int:
    """Return the seed of the checksum for a message type.

    The schema hash is in the checksum of everything but the introduction, so that two versions can always tell each
    other who they are and can never take each other's readings for their own.
    """
    return 0 if type_number in {HelloRequest.TYPE, Hello.TYPE} else SCHEMA_HASH
