"""Registers of Modbus units: their grouping into requests, the answers, and their decoding. Pure; no I/O."""

import math
import struct
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import NamedTuple

from pymodbus.pdu import DecodePDU

from beamtouch_daemon.config.value_types import FORMATS, ByteOrder, ValueType, has_fractions, words_of

MAX_REGISTERS = 125
"""Limit of registers in one request."""
READ_INPUT_REGISTERS, READ_HOLDING_REGISTERS = 4, 3
DECODER = DecodePDU(is_server=False)
"""Decodes the answers of units."""
LASTING = (1, 2, 3)
"""Exceptions by which a unit refuses a request each time: function, address and number of registers. Others may pass:
the unit is busy, or a gateway does not reach it."""
UNREAD = (6, 10)
"""Refusals of requests that were not looked at: the unit is busy, or a gateway did not pass them on."""


@dataclass(frozen=True, slots=True)
class Block:
    """Consecutive registers, read with one request."""

    first: int
    count: int
    function: int = READ_INPUT_REGISTERS

    @property
    def request(self) -> bytes:
        """The request, without the number of the unit and without a checksum."""
        return struct.pack(">BHH", self.function, self.first, self.count)


class RegisterAnswer(NamedTuple):
    """An answer to a request for registers."""

    registers: Sequence[int] = ()
    exception: int = 0
    """Code of the refusal; 0: not refused."""
    asked_s: float = 0.0
    """Time of the first request by the clock of `uptime_s`."""
    refusals: tuple[int, ...] = ()
    """Codes of the refusals after which the request was repeated."""

    @property
    def may_pass(self) -> bool:
        """True if it is a refusal that may pass."""
        return self.exception not in (0, *LASTING)


def answer_to(block: Block, data: bytes, asked_s: float = 0.0) -> RegisterAnswer | None:
    """Return the answer to the request for a block; None if the data answer another request.

    Parameters
    ----------
    block : Registers that were asked for. Of other functions than 3 and 4, the contents are left out.
    data : Function and contents of the answer, as in `Block.request`.
    asked_s : Time of the request.
    """
    answer = DECODER.decode(data)
    if answer is None or answer.function_code & 0x7F != block.function:
        return None
    if answer.isError():
        return RegisterAnswer(exception=answer.exception_code, asked_s=asked_s)
    if block.function not in (READ_INPUT_REGISTERS, READ_HOLDING_REGISTERS):
        return RegisterAnswer(asked_s=asked_s)
    return RegisterAnswer(answer.registers, asked_s=asked_s) if len(answer.registers) == block.count else None


@dataclass(frozen=True, slots=True)
class Value:
    """A value in one register, or in several consecutive ones."""

    register: int
    value_type: ValueType = "u16"
    byte_order: ByteOrder = "ABCD"

    @property
    def registers(self) -> range:
        """The registers of the value."""
        return range(self.register, self.register + words_of(self.value_type))

    @property
    def swaps_bytes(self) -> bool:
        """True if the two bytes of each register are swapped."""
        return self.byte_order in {"BADC", "DCBA"}

    def decode(self, contents: Mapping[int, int]) -> float | None:
        """Return the value; None if a register is missing, or if the value is not finite.

        Parameters
        ----------
        contents : Contents of the registers that were read, 0 to 65535.
        """
        if self.value_type == "u16" and not self.swaps_bytes:
            return contents.get(self.register)
        try:
            words = [contents[register] for register in self.registers]
        except KeyError:
            return None
        data = struct.pack(self._format, *(reversed(words) if self._swaps_words else words))
        value: float = struct.unpack(FORMATS[self.value_type], data)[0]
        return value if math.isfinite(value) else None

    def encode(self, value: float) -> list[int]:
        """Return the contents of the registers of a value."""
        whole = value if has_fractions(self.value_type) else round(value)
        words = struct.unpack(self._format, struct.pack(FORMATS[self.value_type], whole))
        return list(reversed(words) if self._swaps_words else words)

    @property
    def _swaps_words(self) -> bool:
        return self.byte_order in {"CDAB", "DCBA"}

    @property
    def _format(self) -> str:
        return f"{'<' if self.swaps_bytes else '>'}{len(self.registers)}H"


def blocks_of(
    values: Sequence[Value],
    max_registers: int = MAX_REGISTERS,
    bridge: int = 0,
    function: int = READ_INPUT_REGISTERS,
) -> tuple[Block, ...]:
    """Return the smallest number of blocks with all values. No value is split, so its halves are of one instant.

    Values do not overlap.

    Parameters
    ----------
    values : The values to read.
    max_registers : Limit of registers in a block.
    bridge : Largest number of consecutive unused registers within a block.
    function : Reads them.
    """
    blocks: list[Block] = []
    for begin, end in sorted({(value.registers.start, value.registers.stop) for value in values}):
        last = blocks[-1] if blocks else None
        # The longest possible blocks give the smallest number of them.
        if last and begin - (last.first + last.count) <= bridge and end - last.first <= max_registers:
            blocks[-1] = Block(last.first, end - last.first, function)
        else:
            blocks.append(Block(begin, end - begin, function))
    return tuple(blocks)
