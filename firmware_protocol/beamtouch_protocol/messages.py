"""The messages between host and device, and the schema hash that identifies this set of messages.

Type numbers below 0x80 go from host to device, the others from device to host. An answer has the number of its
question plus 0x80. Unused numbers are reserved.
"""

import zlib
from dataclasses import dataclass
from typing import ClassVar, get_args

from beamtouch_protocol.wire import U8, U16, U32, Counts, Payload

PROTOCOL_VERSION = 1
"""Increases with every change to a message or its meaning."""


@dataclass(frozen=True, slots=True)
class HelloRequest(Payload):
    """Host to device: ask for a `Hello`. A running stream goes on."""

    TYPE: ClassVar[int] = 0x01


@dataclass(frozen=True, slots=True)
class Ping(Payload):
    """Host to device: ask for the device clock. A running stream goes on."""

    TYPE: ClassVar[int] = 0x02

    token: U16
    """Returned in the `Pong`, so that a late answer cannot be mistaken for the answer to a later ping."""


@dataclass(frozen=True, slots=True)
class Identify(Payload):
    """Host to device: blink, so that a person sees which device this is. There is no answer."""

    TYPE: ClassVar[int] = 0x03

    seconds: U8
    """Duration of the blinking; 0 stops it."""


@dataclass(frozen=True, slots=True)
class Start(Payload):
    """Host to device: start sending readings, or change rate and oversampling of a running stream."""

    TYPE: ClassVar[int] = 0x10

    rate_hz: U16
    """Readings per second, from 1 to the device's `max_rate_hz`; a device ignores a `Start` with any other rate."""
    oversampling: U8
    """Conversions that each count sums, at least 1; a device ignores a `Start` that it cannot keep up with."""


@dataclass(frozen=True, slots=True)
class Stop(Payload):
    """Host to device: stop sending readings."""

    TYPE: ClassVar[int] = 0x11


@dataclass(frozen=True, slots=True)
class Hello(Payload):
    """Device to host, at boot and on request: describes the device. Its layout is the same in all versions, for ever.

    It decodes with any values, because other versions may have other limits. Check `is_compatible` before using any
    other field.
    """

    TYPE: ClassVar[int] = 0x81

    protocol_version: U8
    """`PROTOCOL_VERSION` of the device."""
    schema_hash: U32
    """`SCHEMA_HASH` of the device; host and device understand each other only if theirs are equal."""
    boot_id: U32
    """Constant from boot to reset, different for each boot."""
    channel_count: U8
    """Counts in each reading, 1 to 32."""
    adc_bits: U8
    """One conversion gives 0 to 2**adc_bits - 1; 1 to 16."""
    max_rate_hz: U16
    """Highest rate of readings, without oversampling, that ADC and line sustain."""

    @property
    def is_compatible(self) -> bool:
        """True if the device speaks exactly the messages of this module."""
        return (self.protocol_version, self.schema_hash) == (PROTOCOL_VERSION, SCHEMA_HASH)


@dataclass(frozen=True, slots=True)
class Pong(Payload):
    """Device to host: the answer to `Ping`."""

    TYPE: ClassVar[int] = 0x82

    token: U16
    """The token of the ping."""
    device_us: U32
    """Device clock when the ping was handled, in microseconds, modulo 2**32."""


@dataclass(frozen=True, slots=True)
class Reading(Payload):
    """Device to host: the raw counts of all channels at one instant. Never sent a second time."""

    TYPE: ClassVar[int] = 0x90

    sequence: U16
    """Number of the scan since boot, modulo 2**16; a gap means lost readings."""
    device_us: U32
    """Device clock at the middle of the scan, in microseconds, modulo 2**32."""
    oversampling: U8
    """Conversions that each count sums, at least 1."""
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

MAX_PAYLOAD_BYTES = max(message.max_payload_bytes() for message in MESSAGE_TYPES.values())
"""Length of the longest payload: a reading of 32 channels."""


def crc_seed(type_number: int) -> int:
    """Return the seed of the checksum for a message type.

    `HelloRequest` and `Hello` have no seed, so that any two versions can identify each other. All other checksums
    include the schema hash, so that no version accepts the readings of another.
    """
    return 0 if type_number in {HelloRequest.TYPE, Hello.TYPE} else SCHEMA_HASH
