"""The place of a channel in its source, and the data type of its counts."""

from beamtouch_daemon.config.modules import Encoding, module_of
from beamtouch_daemon.config.signal import Channel
from beamtouch_daemon.config.sources import ModbusRtu, SerialLine, Source


def place_of(source: Source, channel: Channel) -> tuple[str, int, int]:
    """Return host, unit and first register of a channel; ValueError if the configuration does not state them."""
    message = ""
    module = None if isinstance(source, SerialLine) or source.module is None else module_of(source.module)
    if isinstance(source, SerialLine) and (channel.input, channel.unit, channel.host, channel.type) != (None,) * 4:
        message = f"channel {channel.name}: input, unit, host and type are for Modbus; a serial channel has a register"
    elif isinstance(source, ModbusRtu) and channel.host is not None:
        message = f"channel {channel.name}: host is for modbus-tcp"
    elif (channel.input is None) == (channel.register_ is None):
        message = f"channel {channel.name}: state its register{' or its input' if module else ''}"
    elif channel.input is not None and module is None:
        message = f"channel {channel.name}: input needs the source's module; state the register"
    elif channel.input is not None and module is not None and channel.input >= module.inputs:
        message = f"channel {channel.name}: the module has inputs 0 to {module.inputs - 1}"
    if message:
        raise ValueError(message)
    register = channel.register_
    if register is None and module is not None and channel.input is not None:
        register = module.register_of(channel.input)
    host, unit = getattr(source, "host", ""), getattr(source, "unit", 0)
    return channel.host or host, unit if channel.unit is None else channel.unit, register or 0


def encoding_of(source: Source, channel: Channel) -> Encoding:
    """Return the data type of the counts of a channel; those of a serial device are whole numbers or their means."""
    module = None if isinstance(source, SerialLine) else source.module
    default: Encoding = "u16" if module is None else module_of(module).type
    return channel.type or default
