"""Blocks of registers, filled at the moment of reading. Pure: the caller gives the time."""

import struct
from collections.abc import Iterable

from beamtouch_service.outputs.modbus.registers import BLOCK, Type, registers_of
from beamtouch_service.outputs.modbus.section import WordOrder
from beamtouch_service.surfaces.surface import Surface

_HALVES = struct.Struct(">HH")
_FORMATS = {Type.FLOAT32: struct.Struct(">f"), Type.UINT32: struct.Struct(">I")}


class NoSuchRegisterError(ValueError):
    """A range of addresses goes beyond the last block."""


class Blocks:
    """The blocks of several surfaces, one after the other."""

    def __init__(self, surfaces: Iterable[Surface], word_order: WordOrder) -> None:
        self._surfaces = list(surfaces)
        self._word_order = word_order

    def read(self, address: int, count: int, now_s: float) -> list[int]:
        """Return `count` registers from `address` on, as of `now_s` [s, monotonic].

        Registers of one block come from one sample.

        Raises
        ------
        NoSuchRegisterError
            Some of these addresses belong to no surface.
        """
        end = address + count
        if end > BLOCK * len(self._surfaces):
            raise NoSuchRegisterError(f"address {end - 1} belongs to no surface")
        first = address // BLOCK
        surfaces = self._surfaces[first : -(-end // BLOCK)]
        words = [word for surface in surfaces for word in self._block(surface, now_s)]
        return words[address - first * BLOCK : end - first * BLOCK]

    def _block(self, surface: Surface, now_s: float) -> list[int]:
        view, block = surface.view(now_s), [0] * BLOCK
        for register in registers_of(view.axes):
            end = register.offset + register.type.count
            block[register.offset : end] = self._words(register.type, register.value(view))
        return block

    def _words(self, kind: Type, value: float) -> list[int]:
        if kind.count == 1:
            return [int(value)]
        if kind is Type.CHANNELS:
            # The lowest bits first, in either word order: channel 17 is bit 0 of the second register.
            return [int(value) >> 16 * place & 0xFFFF for place in range(kind.count)]
        high, low = _HALVES.unpack(_FORMATS[kind].pack(value))
        return [high, low] if self._word_order == "big" else [low, high]
