"""The packets in a stream of MQTT."""

from collections.abc import Iterator
from typing import BinaryIO, NamedTuple


class Packet(NamedTuple):
    """A packet."""

    kind: int
    """Its first byte: type and flags."""
    rest: bytes
    """What follows its length."""
    whole: bytes


def read_packets(stream: BinaryIO) -> Iterator[Packet]:
    """Yield the packets of a stream up to its end."""
    while head := stream.read(1):
        size = stream.read(1)
        while size[-1] & 0x80:
            size += stream.read(1)
        rest = stream.read(sum((byte & 0x7F) << 7 * index for index, byte in enumerate(size)))
        yield Packet(head[0], rest, head + size + rest)
