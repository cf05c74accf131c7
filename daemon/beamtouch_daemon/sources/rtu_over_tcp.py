"""Finds serial converters among devices that were taken for Modbus TCP ones."""

from contextlib import closing

from beamtouch_daemon.sources.converter import connect
from beamtouch_daemon.sources.host_address import HostAddress
from beamtouch_daemon.sources.reading import NoAnswerError, SourceError
from beamtouch_daemon.sources.registers import Block
from beamtouch_daemon.sources.rtu_line import RtuLine
from beamtouch_daemon.sources.serial_port import SerialPort


async def answers_in_rtu(address: HostAddress, unit: int, block: Block, timeout_s: float) -> bool:
    """Return whether a unit answers a request in an RTU frame over a connection of its own. It only reads."""
    try:
        with closing(SerialPort(f"tcp://{address}", await connect(address))) as port:
            await RtuLine(port, 0.0).exchange(unit, block, timeout_s)
    except (NoAnswerError, SourceError):
        return False
    return True
