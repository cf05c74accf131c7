"""Registers of Modbus units: their grouping into requests, and their decoding. Pure; no I/O."""

import math
import struct
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from beamtouch_daemon.config.modules import Encoding, words_of
from beamtouch_daemon.config.sources import ByteOrder

MAX_REGISTERS = 125
"""Limit of registers in one request."""

_FORMATS = {"u16": ">H", "i16": ">h", "u32": ">I", "i32": ">i", "f32": ">f"}


@dataclass(frozen=True, slots=True)
class Block:
    """Consecutive registers, read with one request."""

    first: int
    count: int


@dataclass(frozen=True, slots=True)
class Value:
    """A value in one register, or in two consecutive ones."""

    register: int
    encoding: Encoding = "u16"
    byte_order: ByteOrder = "ABCD"

    @property
    def registers(self) -> range:
        """The registers of the value."""
        return range(self.register, self.register + words_of(self.encoding))

    @property
    def swaps_bytes(self) -> bool:
        """Whether the two bytes of each register are swapped."""
        return self.byte_order in {"BADC", "DCBA"}

    def decode(self, contents: Mapping[int, int]) -> float | None:
        """Return the value; None if a register is missing, or if the value is not finite.

        Parameters
        ----------
        contents
            Contents of the registers that were read, 0 to 65535.
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


def blocks_of(values: Sequence[Value], max_registers: int = MAX_REGISTERS, bridge: int = 0) -> tuple[Block, ...]:
    """Return the smallest number of blocks with all values. No value is split, so its halves are of one instant.

    Parameters
    ----------
    values
        The values to read.
    max_registers
        Limit of registers in a block.
    bridge
        Largest number of consecutive unused registers within a block.
    """
    blocks: list[Block] = []
    for registers in sorted({(value.registers.start, value.registers.stop) for value in values}):
        begin, end = registers
        last = blocks[-1] if blocks else None
        # The longest possible blocks give the smallest number of them.
        if last and begin - (last.first + last.count) <= bridge and end - last.first <= max_registers:
            blocks[-1] = Block(last.first, max(last.count, end - last.first))
        else:
            blocks.append(Block(begin, end - begin))
    return tuple(blocks)
