"""Modbus TCP: a connection per session.

Within a connection the transaction number tells answers apart. A request that timed out ends the connection, and with
it any answer that is still under way.
"""

from collections.abc import Sequence

from pymodbus.client import AsyncModbusTcpClient
from pymodbus.client.base import ModbusBaseClient

from beamtouch_daemon.config import ModbusTcp
from beamtouch_daemon.sources.modbus import ModbusSource
from beamtouch_daemon.sources.reading import SourceError


class ModbusTcpSource(ModbusSource):
    """Readings of one unit behind a Modbus TCP server."""

    def __init__(self, settings: ModbusTcp, registers: Sequence[int], rate_hz: float) -> None:
        super().__init__(registers, settings.unit, rate_hz, settings.timeout_ms / 1e3)
        self._host = settings.host
        self._port = settings.port

    async def _connect(self) -> ModbusBaseClient:
        client = AsyncModbusTcpClient(
            self._host, port=self._port, timeout=self._timeout_s, retries=0, reconnect_delay=0
        )
        if not await client.connect():
            message = f"no connection to {self._host}:{self._port}; is the device on, and is the address right?"
            raise SourceError(message)
        return client

    async def _before_request(self) -> None:
        """Wait for nothing: the transaction number keeps answers apart."""
