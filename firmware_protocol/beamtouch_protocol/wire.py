"""Wire types of message fields, and the packing of messages.

A message class states the wire type of each field in its annotation (`rate_hz: U16`). Packing, unpacking and the
schema text all read these annotations, so they cannot disagree.
"""

import struct
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Annotated, Any, ClassVar, Self, get_type_hints

MAX_CHANNELS = 32
"""Largest number of counts in a reading; it bounds the memory of every decoder."""


@dataclass(frozen=True, slots=True)
class Unsigned:
    """An unsigned little-endian integer of 8, 16 or 32 bits."""

    bits: int

    def __str__(self) -> str:
        return f"u{self.bits}"

    @property
    def max_bytes(self) -> int:
        """Length on the wire, in bytes; always the same."""
        return self.bits // 8

    def pack(self, name: str, value: object) -> bytes:
        """Return the bytes of `value`; ValueError with the field's name if it is out of range."""
        if not isinstance(value, int) or not 0 <= value < 1 << self.bits:
            raise ValueError(f"{name} must be a whole number from 0 to {(1 << self.bits) - 1}, not {value!r}")
        return value.to_bytes(self.max_bytes, "little")

    def unpack(self, name: str, data: bytes) -> int:
        """Return the value of `data`; ValueError with the field's name if the length is wrong."""
        if len(data) != self.max_bytes:
            raise ValueError(f"{name} is cut off: {len(data)} of {self.max_bytes} bytes")
        return int.from_bytes(data, "little")


@dataclass(frozen=True, slots=True)
class Run:
    """One to `max_count` u16 values that fill the rest of the payload; their number follows from its length."""

    max_count: int

    def __str__(self) -> str:
        return f"u16[1..{self.max_count}]"

    @property
    def max_bytes(self) -> int:
        """The greatest length on the wire, in bytes."""
        return 2 * self.max_count

    def pack(self, name: str, values: Sequence[int]) -> bytes:
        """Return the bytes of `values`; ValueError with the field's name if a value or their number is out of range."""
        if not 1 <= len(values) <= self.max_count:
            raise ValueError(f"{name} must hold 1 to {self.max_count} values, not {len(values)}")
        return b"".join(Unsigned(16).pack(f"{name}[{index}]", value) for index, value in enumerate(values))

    def unpack(self, name: str, data: bytes) -> tuple[int, ...]:
        """Return the values in `data`; ValueError with the field's name if it is empty or of odd length."""
        if not data or len(data) % 2:
            raise ValueError(f"{name} cannot be {len(data)} bytes long")
        return struct.unpack(f"<{len(data) // 2}H", data)


U8 = Annotated[int, Unsigned(8)]
U16 = Annotated[int, Unsigned(16)]
U32 = Annotated[int, Unsigned(32)]
Counts = Annotated[tuple[int, ...], Run(MAX_CHANNELS)]
"""One u16 per channel. It must be the last field of a message, because it takes all remaining bytes."""


class Payload:
    """Base class of the messages: dataclasses with a type number and fields in wire order."""

    __slots__ = ()

    TYPE: ClassVar[int]
    """The first byte of the body, before the payload."""
    FIELDS: ClassVar[tuple[tuple[str, Unsigned | Run], ...]]
    """Name and wire type of each field, read from the annotations."""

    def __init_subclass__(cls) -> None:
        hints = get_type_hints(cls, include_extras=True)
        cls.FIELDS = tuple(
            (name, hint.__metadata__[0]) for name, hint in hints.items() if hasattr(hint, "__metadata__")
        )

    def to_bytes(self) -> bytes:
        """Return the payload; ValueError with the field's name if a value is out of range."""
        return b"".join(kind.pack(name, getattr(self, name)) for name, kind in self.FIELDS)

    @classmethod
    def from_bytes(cls, payload: bytes) -> Self:
        """Return the message in `payload`; ValueError only if its length is wrong."""
        values: list[Any] = []
        for name, kind in cls.FIELDS:
            values.append(kind.unpack(name, payload[: kind.max_bytes]))
            payload = payload[kind.max_bytes :]
        if payload:
            raise ValueError(f"{cls.__name__} is {len(payload)} bytes too long")
        return cls(*values)

    @classmethod
    def schema(cls) -> str:
        """Return this message's line of the schema text: type number, name, and each field with its wire type."""
        return " ".join([f"0x{cls.TYPE:02x}", cls.__name__, *(f"{name}:{kind}" for name, kind in cls.FIELDS)])

    @classmethod
    def max_payload_bytes(cls) -> int:
        """Return the length of the longest payload of this message, in bytes."""
        return sum(kind.max_bytes for _, kind in cls.FIELDS)
