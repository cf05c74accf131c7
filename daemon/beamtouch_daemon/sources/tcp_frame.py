"""Headers of Modbus TCP: which answers belong to a request. Pure; no I/O."""

import struct

_HEADER = struct.Struct(">HHHB")
_BEFORE_UNIT_BYTES = 6
"""The length in a header counts what comes after it: unit, function and data."""
NO_TRANSACTION = 0xFFFF
"""A transaction number that no request has: pymodbus stays below."""
DEVICE_ITSELF = (0, 255)
"""Units that mean the device at the other end of the connection, and no unit behind it."""


class AnswerHeaders:
    """Corrects the headers of answers where pymodbus judges them otherwise than it should.

    pymodbus takes transaction number 0 for any; here it is none. pymodbus refuses a device that always answers as
    unit 0 or 255; here it is accepted, as the transaction number alone proves which request an answer belongs to.
    An answer of another unit is still refused: behind a gateway it is that of another device.

    Parameters
    ----------
    unit
        The one that is asked.
    """

    def __init__(self, unit: int) -> None:
        self.complaint: str | None = None
        """Why the answer to the newest request was refused, if one was."""
        self._unit = unit
        self._transaction = NO_TRANSACTION

    def trace(self, sending: bool, data: bytes) -> bytes:
        """Take note of a request, or return received bytes as pymodbus is to see them, as many as there were."""
        if sending:
            self._transaction, *_ = _HEADER.unpack_from(data)
            self.complaint = None
            return data
        corrected, begin = bytearray(data), 0
        while begin + _HEADER.size <= len(data):
            transaction, protocol, length, unit = _HEADER.unpack_from(data, begin)
            transaction, unit = self._judge(transaction, unit)
            _HEADER.pack_into(corrected, begin, transaction, protocol, length, unit)
            begin += _BEFORE_UNIT_BYTES + max(length, 1)
        return bytes(corrected)

    def _judge(self, transaction: int, unit: int) -> tuple[int, int]:
        if transaction != self._transaction:
            if not transaction:
                self.complaint = "answers with transaction number 0, which does not say what it answers"
            return transaction or NO_TRANSACTION, unit
        if unit in DEVICE_ITSELF:
            return transaction, self._unit
        if unit != self._unit:
            self.complaint = f"answers as unit {unit}; state unit = {unit} if that is the device"
        return transaction, unit
