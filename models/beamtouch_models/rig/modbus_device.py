"""A Modbus module that measures the virtual surface: unit 1, input registers (function 4) from 0, one per channel."""

from collections.abc import Callable

from pymodbus.constants import ExcCodes
from pymodbus.server import ModbusSerialServer, ModbusTcpServer
from pymodbus.simulator import DataType, SimData, SimDevice

UNIT = 1
BAUD = 115_200

Convert = Callable[[], list[int]]
"""Converts all channels now and returns their counts."""


def tcp_server(convert: Convert, channels: int, host: str, port: int) -> ModbusTcpServer:
    """Return a Modbus TCP server, not yet listening."""
    return ModbusTcpServer(_device(convert, channels), address=(host, port))


def rtu_server(convert: Convert, channels: int, port: str) -> ModbusSerialServer:
    """Return a Modbus RTU server on a serial port, not yet listening."""
    return ModbusSerialServer(_device(convert, channels), port=port, baudrate=BAUD)


def _device(convert: Convert, channels: int) -> SimDevice:
    async def action(  # the signature is pymodbus's
        _function_code: int,
        _start_address: int,
        _address: int,
        _count: int,
        current_registers: list[int],
        _set_values: list[int] | list[bool] | None,
    ) -> ExcCodes | None:
        # Convert on request, as modules that sample on demand do, so that successive readings are independent.
        current_registers[:channels] = convert()
        return None

    registers = [SimData(address=0, count=channels, values=0, datatype=DataType.REGISTERS)]
    return SimDevice(id=UNIT, simdata=registers, action=action)
