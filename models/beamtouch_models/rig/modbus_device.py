"""A Modbus module that measures the virtual surface: one value per channel, in consecutive registers."""

import struct
from collections.abc import Callable
from dataclasses import dataclass
from typing import Literal

from pymodbus.constants import ExcCodes
from pymodbus.exceptions import NoSuchIdException
from pymodbus.server import ModbusSerialServer, ModbusTcpServer
from pymodbus.simulator import DataType, SimData, SimDevice

from beamtouch_common.errors import InputError

BAUD = 115_200
TYPES = {"u16": ">H", "i16": ">h", "u32": ">I", "i32": ">i", "f32": ">f"}
BYTE_ORDERS = ("ABCD", "CDAB", "BADC", "DCBA")

Convert = Callable[[], list[int]]
"""Converts all channels now and returns their counts."""


@dataclass(frozen=True)
class Module:
    """Where a module has its values, and their form, in the words of the daemon's configuration."""

    unit: int = 1
    function: Literal[3, 4] = 4
    register: int = 0
    """Address of the first register, from 0."""
    type: str = "u16"
    byte_order: str = "ABCD"

    def check(self, channels: int, adc_bits: int) -> None:
        """Raise InputError unless the counts of all channels fit into the registers."""
        largest = 2**adc_bits - 1
        try:
            words = len(self.registers_of([largest] * channels))
        except struct.error:
            message = f"counts up to {largest} do not fit --type {self.type}; set sensors.adc_bits = 15 in the scene"
            raise InputError(message) from None
        if self.register + words > 2**16:
            raise InputError(f"--register {self.register}: {words} registers from there go beyond 65535")

    def registers_of(self, counts: list[int]) -> list[int]:
        """Return the registers of these counts."""
        data = b"".join(struct.pack(TYPES[self.type], count) for count in counts)
        words = [int.from_bytes(data[at : at + 2]) for at in range(0, len(data), 2)]
        if self.byte_order in ("CDAB", "DCBA") and struct.calcsize(TYPES[self.type]) == 4:
            words = [words[index ^ 1] for index in range(len(words))]
        if self.byte_order in ("BADC", "DCBA"):
            words = [word >> 8 | (word & 0xFF) << 8 for word in words]
        return words


def tcp_server(convert: Convert, channels: int, module: Module, host: str, port: int) -> ModbusTcpServer:
    """Return a Modbus TCP server, not yet listening. To requests for another unit it answers exception 11."""
    return ModbusTcpServer(_devices(convert, channels, module), address=(host, port))


def rtu_server(convert: Convert, channels: int, module: Module, port: str) -> ModbusSerialServer:
    """Return a Modbus RTU server on a serial port, not yet listening. It is silent on requests for another unit."""
    devices = _devices(convert, channels, module)
    return ModbusSerialServer(devices, port=port, baudrate=BAUD, ignore_missing_devices=True)


def _devices(convert: Convert, channels: int, module: Module) -> list[SimDevice]:
    async def action(  # the signature is pymodbus's
        function_code: int,
        _start_address: int,
        _address: int,
        _count: int,
        current_registers: list[int],
        _set_values: list[int] | list[bool] | None,
    ) -> ExcCodes | None:
        if function_code != module.function:
            return ExcCodes.ILLEGAL_FUNCTION
        # Convert on request, as modules that sample on demand do, so that successive readings are independent.
        current_registers[:] = module.registers_of(convert())
        return None

    async def refuse(*_request: object) -> ExcCodes | None:
        raise NoSuchIdException

    def device(unit: int, first: int, count: int, act: Callable[..., object]) -> SimDevice:
        registers = SimData(address=first, count=count, values=0, datatype=DataType.REGISTERS)
        return SimDevice(id=unit, simdata=[registers], action=act)  # type: ignore[arg-type]

    count = len(module.registers_of([0] * channels))
    own = device(module.unit, module.register, count, action)
    # pymodbus takes unit 0 for all units that have no device of their own.
    return [own] if module.unit == 0 else [own, device(0, 0, 2**16, refuse)]
