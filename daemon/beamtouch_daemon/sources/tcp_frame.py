"""Headers of Modbus TCP, which assign answers to requests. Pure; no I/O."""

import struct

_HEADER = struct.Struct(">HHHB")
_BEFORE_UNIT_BYTES = 6
"""Bytes of the header before those that its length field counts: unit, function and data."""
NO_TRANSACTION = 0xFFFF
"""A transaction number that pymodbus never uses."""
DEVICE_ITSELF = (0, 255)
"""Unit numbers of the device at the other end of the connection, as opposed to units behind it."""


class AnswerHeaders:
    """Corrects headers of answers that pymodbus would judge wrongly.

    pymodbus accepts transaction number 0 for any request; here it is refused. pymodbus refuses a device that always
    answers as unit 0 or 255; here it is accepted, because the transaction number proves the answer. An answer of any
    other unit is refused: behind a gateway it comes from another device.

    Parameters
    ----------
    unit
        Number of the unit that is asked.
    """

    def __init__(self, unit: int) -> None:
        self.complaint: str | None = None
        """Reason why the answer to the newest request was refused; None if it was not."""
        self._unit = unit
        self._transaction = NO_TRANSACTION

    def trace(self, sending: bool, data: bytes) -> bytes:
        """Note a request, or return received bytes corrected for pymodbus, with the same length."""
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
                self.complaint = "answers with transaction number 0, which does not identify the request"
            return transaction or NO_TRANSACTION, unit
        if unit in DEVICE_ITSELF:
            return transaction, self._unit
        if unit != self._unit:
            self.complaint = f"answers as unit {unit}; state unit = {unit} if that is the device"
        return transaction, unit
