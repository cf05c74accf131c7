"""Modbus units that have some registers and refuse requests for others, as real ones do."""

from collections.abc import Callable

from .devices import Pieces, StampingUnit


class RegisterUnit(StampingUnit):
    """A unit with so many input registers and holding registers from 0, all 0."""

    def __init__(self, inputs: int, holdings: int) -> None:
        super().__init__()
        self._has = {4: inputs, 3: holdings}

    def answer(self, request: bytes, wrap: Callable[[bytes], bytes]) -> Pieces:
        """Take unit, function, address and count; return the registers, or a refusal if there are not so many."""
        unit, function, first, count = request[0], request[1], *(int.from_bytes(request[at : at + 2]) for at in (2, 4))
        self.requests += 1
        if first + count > self._has.get(function, 0):
            return [(0.0, wrap(bytes([unit, function | 0x80, 2])))]
        return [(0.0, wrap(bytes([unit, function, 2 * count]) + bytes(2 * count)))]
