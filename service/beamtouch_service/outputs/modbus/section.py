"""`[modbus_server]` of the configuration."""

from typing import Annotated, Literal

from pydantic import Field, FiniteFloat

from beamtouch_service.fields import Host, Port, Section

WordOrder = Literal["big", "little"]
"""The half of a 32-bit value that its first register holds: `big` the high one (ABCD), `little` the low one (CDAB)."""


class ModbusServerSection(Section):
    """`[modbus_server]`: contacts as Modbus input registers. Without this section, there is no Modbus server."""

    host: Host = "127.0.0.1"
    """Address to listen on. Modbus knows no tokens: everyone who reaches it can read the contacts."""
    port: Port = 502
    """0 picks a free port. Ports below 1024 require a privilege."""
    word_order: WordOrder = "big"
    """Order of the two registers of a 32-bit value: `big` (ABCD) or `little` (CDAB)."""
    max_clients: Annotated[int, Field(ge=1, le=4096)] = 32
    """Open connections. For one more, an idle one is closed; docs/reference/registers.md says which."""
    idle_s: Annotated[FiniteFloat, Field(ge=0.1, le=86_400)] = 60.0
    """A connection without a request for this long is closed."""
