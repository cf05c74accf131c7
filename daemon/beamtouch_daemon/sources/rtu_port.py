"""A serial port on the event loop that sends and receives bytes."""

import asyncio
import contextlib
import termios

import serial

from beamtouch_daemon.config.sources import ModbusRtu
from beamtouch_daemon.sources.reading import SourceError

_READ_BYTES = 4096
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
        try:
            self._serial = serial.Serial(
                settings.port,
                settings.baud,
                parity=_PARITIES[settings.parity],
                stopbits=settings.stop_bits,
                timeout=0,
                write_timeout=0,
                exclusive=True,
            )
        except (OSError, ValueError, termios.error) as error:
            message = f"{settings.port} cannot be opened ({error}); does it exist, and is no other program using it?"
            raise SourceError(message) from error
        self.received.clear()
        asyncio.get_running_loop().add_reader(self._serial.fileno(), self.read)
        return True

    def close(self) -> None:
        """Close the port if it is open; calls that wait for bytes raise SourceError."""
        if self._serial is not None:
            asyncio.get_running_loop().remove_reader(self._serial.fileno())
            with contextlib.suppress(OSError):  # an unplugged device may complain
                self._serial.close()
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
            data = self._serial.read(_READ_BYTES)
        except (OSError, termios.error):
            self.close()  # its users notice and open it again
            return
        if data:
            self.received += data
            del self.received[:-_READ_BYTES]
            self._arrived.set()

    def send(self, frame: bytes) -> None:
        """Send a frame; SourceError if the port does not accept all of it."""
        try:
            sent = self._serial.write(frame) if self._serial is not None else 0
        except (OSError, termios.error):
            self.close()
            sent = 0
        if sent != len(frame):
            message = f"{self._settings.port} is gone or accepts no data"
            raise SourceError(message)
