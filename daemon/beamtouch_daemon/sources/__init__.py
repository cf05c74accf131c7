"""Where readings come from: Modbus TCP, Modbus RTU and the serial protocol."""

from beamtouch_daemon.config import ModbusRtu, ModbusTcp, Surface
from beamtouch_daemon.sources.modbus_rtu import ModbusRtuSource
from beamtouch_daemon.sources.modbus_tcp import ModbusTcpSource
from beamtouch_daemon.sources.reading import Source
from beamtouch_daemon.sources.serial_line import SerialSource


def source_of(surface: Surface) -> Source:
    """Return the source that a surface's configuration describes, not yet opened."""
    registers = [channel.register_ for channel in surface.channels]
    match surface.source:
        case ModbusTcp() as settings:
            return ModbusTcpSource(settings, registers, surface.rate_hz)
        case ModbusRtu() as settings:
            return ModbusRtuSource(settings, registers, surface.rate_hz)
        case settings:
            adc_bits = [channel.adc_bits for channel in surface.channels]
            return SerialSource(settings, registers, surface.rate_hz, adc_bits)
