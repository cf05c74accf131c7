"""A serial port on the event loop that sends and receives bytes."""

import asyncio

import serial

from beamtouch_daemon.config.sources import ModbusRtu
from beamtouch_daemon.sources import port
from beamtouch_daemon.sources.reading import SourceError

_PARITIES = {"none": serial.PARITY_NONE, "even": serial.PARITY_EVEN, "odd": serial.PARITY_ODD}


class RtuPort:
    """One serial port, open or not."""

    def __init__(self, settings: ModbusRtu) -> None:
        self.received = bytearray()
        """Received bytes that are not used yet."""
        self._settings = settings
        self._serial: serial.Serial | None = None
        self._arrived = asyncio.Event()

    def open(self) -> bool:
        """Open the port; return False if it was open already. SourceError if it cannot be opened."""
        if self._serial is not None:
            return False
        settings = self._settings
        self._serial = port.opened(settings.port, settings.baud, _PARITIES[settings.parity], settings.stop_bits)
        self.received.clear()
        asyncio.get_running_loop().add_reader(self._serial.fileno(), self.read)
        return True

    def close(self) -> None:
        """Close the port if it is open; calls that wait for bytes raise SourceError."""
        if self._serial is not None:
            asyncio.get_running_loop().remove_reader(self._serial.fileno())
            port.close(self._serial)
            self._serial = None
            self._arrived.set()

    async def more(self, within_s: float) -> bool:
        """Wait for more bytes; return whether any came. SourceError if the port is gone."""
        self._arrived.clear()
        if self._serial is not None:
            try:
                async with asyncio.timeout(within_s):
                    await self._arrived.wait()
            except TimeoutError:
                return False
        if self._serial is None:
            message = f"{self._settings.port} is gone"
            raise SourceError(message)
        return True

    def read(self) -> None:
        """Collect received bytes."""
        if self._serial is None:
            return
        try:
            data = self._serial.read(port.READ_BYTES)
        except port.FAILURES:
            self.close()  # its users notice and open it again
            return
        if data:
            self.received += data
            del self.received[: -port.READ_BYTES]
            self._arrived.set()

    def send(self, frame: bytes) -> None:
        """Send a frame; SourceError if the port does not accept all of it."""
        try:
            sent = self._serial.write(frame) if self._serial is not None else 0
        except port.FAILURES:
            self.close()
            sent = 0
        if sent != len(frame):
            message = f"{self._settings.port} is gone or accepts no data"
            raise SourceError(message)
