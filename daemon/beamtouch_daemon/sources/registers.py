"""Registers of Modbus units: which to ask for with one request, and what their contents mean. Pure; no I/O."""

import math
import struct
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from beamtouch_daemon.config.modules import Encoding, words_of
from beamtouch_daemon.config.sources import ByteOrder

MAX_REGISTERS = 125
"""The most that one request may ask for."""

_FORMATS = {"u16": ">H", "i16": ">h", "u32": ">I", "i32": ">i", "f32": ">f"}


@dataclass(frozen=True, slots=True)
class Block:
    """Registers in a row, read with one request."""

    first: int
    count: int


@dataclass(frozen=True, slots=True)
class Value:
    """A value in one register, or in two in a row."""

    register: int
    encoding: Encoding = "u16"
    byte_order: ByteOrder = "ABCD"

    @property
    def registers(self) -> range:
        """The registers that it takes."""
        return range(self.register, self.register + words_of(self.encoding))

    @property
    def swaps_bytes(self) -> bool:
        """Whether the two bytes of a register are the other way round."""
        return self.byte_order in {"BADC", "DCBA"}

    def decode(self, contents: Mapping[int, int]) -> float | None:
        """Return the value; None where a register is missing, or where it is no number.

        Parameters
        ----------
        contents
            Content of each register that was read, 0 to 65535.
        """
        if self.encoding == "u16" and not self.swaps_bytes:
            return contents.get(self.register)
        try:
            words = [contents[register] for register in self.registers]
        except KeyError:
            return None
        swaps_words = self.byte_order in {"CDAB", "DCBA"}
        order = "<" if self.swaps_bytes else ">"
        data = struct.pack(f"{order}{len(words)}H", *(reversed(words) if swaps_words else words))
        value: float = struct.unpack(_FORMATS[self.encoding], data)[0]
        return value if math.isfinite(value) else None


def blocks_of(values: Sequence[Value], most: int = MAX_REGISTERS, bridge: int = 0) -> tuple[Block, ...]:
    """Return the fewest blocks that hold the values, each whole in one, so that its halves are of one instant.

    Parameters
    ----------
    values
        What is needed.
    most
        The most registers of a block.
    bridge
        So many registers in a row that nobody needs may lie in a block.
    """
    blocks: list[Block] = []
    for registers in sorted({(value.registers.start, value.registers.stop) for value in values}):
        begin, end = registers
        last = blocks[-1] if blocks else None
        # Taking each block as long as it may be gives the fewest of them.
        if last and begin - (last.first + last.count) <= bridge and end - last.first <= most:
            blocks[-1] = Block(last.first, max(last.count, end - last.first))
        else:
            blocks.append(Block(begin, end - begin))
    return tuple(blocks)
