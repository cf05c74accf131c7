"""`[modbus_server]` in the configuration."""

from typing import Annotated, ClassVar, Literal

from pydantic import Field, FiniteFloat

from beamtouch_service.outputs.section import OutputSection
from beamtouch_service.sections import Host, Port

WordOrder = Literal["big", "little"]
"""The half of a 32-bit value that its first register holds: `big` the high one (ABCD), `little` the low one (CDAB)."""


class ModbusServerSection(OutputSection):
    """`[modbus_server]`: contacts as Modbus input registers. Without this section, there is no Modbus server."""

    name: ClassVar[str] = "modbus_server"
    module: ClassVar[str] = "beamtouch_service.outputs.modbus.server"
    extra: ClassVar[str] = "modbus-server"

    host: Host = "127.0.0.1"
    """Address to listen on. Modbus knows no tokens: everyone who reaches it can read the contacts."""
    port: Port = 502
    """0 picks a free port. Ports below 1024 require a privilege."""
    word_order: WordOrder = "big"
    """Order of the two registers of a 32-bit value: `big` (ABCD) or `little` (CDAB)."""
    max_clients: Annotated[int, Field(ge=1, le=4096)] = 32
    """Open connections. Further ones are closed at once."""
    idle_s: Annotated[FiniteFloat, Field(ge=0.1, le=86_400)] = 60.0
    """A connection without a request for this long is closed."""
