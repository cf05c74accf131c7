"""The source of readings that a configuration describes: Modbus TCP, Modbus RTU or the serial protocol."""

from beamtouch_daemon.config.settings import Surface
from beamtouch_daemon.config.sources import ModbusTcp, SerialLine
from beamtouch_daemon.sources.board import BoardSource
from beamtouch_daemon.sources.modbus_tcp import TcpLink
from beamtouch_daemon.sources.polled import Link, Part, PolledSource
from beamtouch_daemon.sources.reading import Source
from beamtouch_daemon.sources.registers import Value, blocks_of
from beamtouch_daemon.sources.rtu_bus import RtuBus, RtuLink

BOARD_BITS = 16
"""Bits of the ADC of a board whose channels do not state them."""
Buses = dict[str, RtuBus]
"""Serial buses by port, shared by all surfaces that read from them."""


def source_of(surface: Surface, name: str = "", buses: Buses | None = None) -> Source:
    """Return the source that a surface's configuration describes, not yet opened.

    Parameters
    ----------
    surface : The configuration.
    name : Name of the surface, for the log.
    buses : The buses in use; a new bus is added.
    """
    settings = surface.source
    if isinstance(settings, SerialLine):
        registers = [channel.register_ or 0 for channel in surface.channels]
        bits = [channel.adc_bits or BOARD_BITS for channel in surface.channels]
        return BoardSource(settings, registers, surface.rate_hz, bits)
    units: dict[tuple[str, int], dict[int, Value]] = {}
    for index, channel in enumerate(surface.channels):
        host, unit, register = surface.place_of(channel)
        value = Value(register, surface.value_type_of(channel), settings.byte_order)
        units.setdefault((host, unit), {})[index] = value
    shared = {} if buses is None else buses
    limits = settings.max_request_registers, settings.bridge_registers, settings.function_code
    parts = []
    for (host, unit), values in units.items():
        blocks = blocks_of(list(values.values()), *limits)
        link: Link
        if isinstance(settings, ModbusTcp):
            link = TcpLink(settings, host, unit)
        else:
            bus = shared.setdefault(settings.port, RtuBus(settings))
            link = RtuLink(bus, unit, blocks, settings.timeout_s)
        parts.append(Part(link, blocks, values))
    return PolledSource(name, parts, len(surface.channels), surface.rate_hz)
