"""The source of readings that a configuration describes: Modbus TCP, Modbus RTU or the serial protocol."""

from collections.abc import Sequence

from beamtouch_daemon.config.places import encoding_of, place_of
from beamtouch_daemon.config.settings import Surface
from beamtouch_daemon.config.sources import ModbusRtu, ModbusTcp, SerialLine
from beamtouch_daemon.sources.links import RtuLink, TcpLink
from beamtouch_daemon.sources.part import Link, Part
from beamtouch_daemon.sources.polled import PolledSource
from beamtouch_daemon.sources.reading import Source
from beamtouch_daemon.sources.registers import Block, Value, blocks_of
from beamtouch_daemon.sources.rtu_bus import RtuBus
from beamtouch_daemon.sources.serial_line import SerialSource

Buses = dict[str, RtuBus]
"""Serial buses by port, shared by all surfaces that read from them."""


def source_of(surface: Surface, name: str = "", buses: Buses | None = None) -> Source:
    """Return the source that a surface's configuration describes, not yet opened.

    Parameters
    ----------
    surface
        The configuration.
    name
        Name of the surface, for the log.
    buses
        The buses in use; a new bus is added.
    """
    settings = surface.source
    if isinstance(settings, SerialLine):
        registers = [channel.register_ or 0 for channel in surface.channels]
        return SerialSource(settings, registers, surface.rate_hz, [channel.adc_bits for channel in surface.channels])
    together: dict[tuple[str, int], dict[int, Value]] = {}
    for index, channel in enumerate(surface.channels):
        host, unit, register = place_of(settings, channel)
        value = Value(register, encoding_of(settings, channel), settings.byte_order)
        together.setdefault((host, unit), {})[index] = value
    known = {} if buses is None else buses
    parts = []
    for (host, unit), values in together.items():
        blocks = blocks_of(list(values.values()), settings.max_request_registers, settings.bridge_registers)
        parts.append(Part(_link(settings, host, unit, blocks, known), blocks, values))
    return PolledSource(name, parts, len(surface.channels), surface.rate_hz)


def _link(settings: ModbusTcp | ModbusRtu, host: str, unit: int, blocks: Sequence[Block], buses: Buses) -> Link:
    if isinstance(settings, ModbusTcp):
        return TcpLink(settings, host, unit)
    bus = buses.setdefault(settings.port, RtuBus(settings))
    function = settings.function_code
    return RtuLink(bus, bus.unit(unit, function, blocks), function, settings.timeout_ms / 1e3)
