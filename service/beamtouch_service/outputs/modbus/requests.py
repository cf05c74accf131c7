"""Requests of Modbus TCP and their answers, as bytes. Pure.

pymodbus encodes and decodes. Its server is not used: it has no bound on connections, idle time or unread answers, loses
all but the first of several requests that arrive together, and keeps a connection that sends other bytes than Modbus.
"""

from collections.abc import Callable

from pymodbus.constants import ExcCodes
from pymodbus.framer import FramerSocket
from pymodbus.pdu import DecodePDU, ExceptionResponse, ModbusPDU
from pymodbus.pdu.register_message import ReadInputRegistersRequest, ReadInputRegistersResponse

from beamtouch_service.outputs.modbus.blocks import NoSuchRegisterError

HEAD_BYTES = 6
"""Transaction, protocol and length. The rest of the frame follows: unit, function and data."""
MAX_FRAME_BYTES = 260
_MIN_REST_BYTES = 2

Read = Callable[[int, int], list[int]]
"""Takes an address and a count and returns this number of registers; raises NoSuchRegisterError."""

_FRAMER = FramerSocket(DecodePDU(is_server=True))


class NotModbusError(ValueError):
    """Bytes that begin no frame. Where the next frame begins is then not known."""


def frame_bytes(head: bytes) -> int:
    """Return the length of the frame that begins with these HEAD_BYTES; raises NotModbusError if none does."""
    protocol, rest_bytes = int.from_bytes(head[2:4]), int.from_bytes(head[4:])
    if protocol != 0 or not _MIN_REST_BYTES <= rest_bytes <= MAX_FRAME_BYTES - HEAD_BYTES:
        raise NotModbusError(f"protocol {protocol}, length {rest_bytes}")
    return HEAD_BYTES + rest_bytes


def answer(frame: bytes, read: Read) -> bytes:
    """Return the answer to one whole frame. Any unit is answered, under its own number."""
    return _encode(frame, _answer(frame[7], frame[8:], read))


def refuse(frame: bytes) -> bytes:
    """Return the answer to one whole frame of a server that fails."""
    return _encode(frame, ExceptionResponse(frame[7], ExcCodes.DEVICE_FAILURE))


def _encode(frame: bytes, pdu: ModbusPDU) -> bytes:
    """Return an answer to a frame as bytes."""
    pdu.transaction_id, pdu.dev_id = int.from_bytes(frame[:2]), frame[6]
    return _FRAMER.buildFrame(pdu)


def _answer(function: int, data: bytes, read: Read) -> ModbusPDU:
    if function != ReadInputRegistersRequest.function_code:
        return ExceptionResponse(function, ExcCodes.ILLEGAL_FUNCTION)
    request = ReadInputRegistersRequest()
    try:
        if len(data) != 4:
            raise ValueError("an address and a count take 4 bytes")
        request.decode(data)
    except ValueError:
        return ExceptionResponse(function, ExcCodes.ILLEGAL_VALUE)
    try:
        return ReadInputRegistersResponse(registers=read(request.address, request.count))
    except NoSuchRegisterError:
        return ExceptionResponse(function, ExcCodes.ILLEGAL_ADDRESS)
