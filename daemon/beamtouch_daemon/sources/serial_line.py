"""A device that speaks the protocol of `PROTOCOL.md` on a serial line.

A session: stop, hello, check who it is, start, take readings. It ends in SourceError when the port goes away, the
device falls silent or was reset, or is not the device that the configuration describes.
"""

import contextlib
from collections.abc import AsyncGenerator, Sequence
from time import monotonic

from beamtouch_daemon.config import SerialLine
from beamtouch_daemon.sources.clock import HostClock
from beamtouch_daemon.sources.reading import Reading, SourceError
from beamtouch_daemon.sources.serial_port import Arrival, SerialPort
from beamtouch_protocol import messages
from beamtouch_protocol.messages import Hello, HelloRequest, Start, Stop
from beamtouch_protocol.sequence import DeviceClock, missing_between

HELLO_TIMEOUT_S = 3.0
"""Opening the port resets many a board, and its boot loader takes a while."""
HELLO_REPEAT_S = 0.3
SILENCE_S = 0.5
SILENCE_PERIODS = 10.0
"""A device is silent after the longer of a time and a number of periods."""
_REPEATED = 1 << 15
"""So many readings cannot be lost without a silence; a sequence number that says so was there before."""


class SerialSource:
    """Readings as the device sends them, stamped with the device's own clock mapped to the host's."""

    def __init__(self, settings: SerialLine, indices: Sequence[int], rate_hz: float, adc_bits: Sequence[int]) -> None:
        self._path = settings.port
        self._baud = settings.baud
        self._indices = tuple(indices)
        self._rate_hz = int(rate_hz)
        self._adc_bits = tuple(adc_bits)
        self._silence_s = max(SILENCE_S, SILENCE_PERIODS / rate_hz)

    async def readings(self) -> AsyncGenerator[list[Reading], None]:
        """Open the port, introduce, start the device and yield what it sends."""
        port = SerialPort(self._path, self._baud)
        try:
            hello = await self._introduce(port)
            self._require(hello)
            session = Session(hello, self._indices)
            port.send(Start(self._rate_hz))
            heard_s = monotonic()
            while True:
                arrivals = await port.receive(self._silence_s)
                readings = [reading for arrival in arrivals if (reading := session.take(arrival))]
                if readings:
                    heard_s = monotonic()
                    yield readings
                elif monotonic() - heard_s >= self._silence_s:
                    message = f"{self._path}: no reading for {self._silence_s:g} s{_damage(port)}"
                    raise SourceError(message)
        finally:
            with contextlib.suppress(SourceError):  # it may be gone already
                port.send(Stop())
            port.close()

    async def _introduce(self, port: SerialPort) -> Hello:
        """Return the device's hello; readings of a stream that still runs are passed over."""
        deadline_s = monotonic() + HELLO_TIMEOUT_S
        while (now_s := monotonic()) < deadline_s:
            port.send(Stop())
            port.send(HelloRequest())
            repeat_s = now_s + HELLO_REPEAT_S
            while (left_s := repeat_s - monotonic()) > 0:
                for arrival in reversed(await port.receive(left_s)):
                    if isinstance(arrival.message, Hello):
                        return arrival.message
        message = (
            f"{self._path}: no hello within {HELLO_TIMEOUT_S:g} s{_damage(port)}; "
            f"is it a beamtouch device, and is {self._baud} its baud rate?"
        )
        raise SourceError(message)

    def _require(self, hello: Hello) -> None:
        """Raise SourceError unless the device is what the configuration says."""
        wrong = ""
        if not hello.is_compatible:
            wrong = (
                f"the device speaks protocol {hello.protocol_version} ({hello.schema_hash:08x}), "
                f"this daemon {messages.PROTOCOL_VERSION} ({messages.SCHEMA_HASH:08x}); update the older of the two"
            )
        elif max(self._indices) >= hello.channel_count:
            wrong = f"the device has {hello.channel_count} channels; register {max(self._indices)} is beyond the last"
        elif any(bits != hello.adc_bits for bits in self._adc_bits):
            wrong = f"the device has {hello.adc_bits} ADC bits; correct adc_bits of its channels"
        elif self._rate_hz > hello.max_rate_hz:
            wrong = f"the device gives at most {hello.max_rate_hz} readings per second; lower rate_hz"
        if wrong:
            message = f"{self._path}: {wrong}"
            raise SourceError(message)


def _damage(port: SerialPort) -> str:
    return ", only damaged frames" if port.rejected else ""


class Session:
    """What is known of one run of the device: its boot, its sequence and its clock. No I/O."""

    def __init__(self, hello: Hello, indices: tuple[int, ...]) -> None:
        self._hello = hello
        self._indices = indices
        self._sequence: int | None = None
        self._device_clock = DeviceClock()
        self._host_clock = HostClock()

    def take(self, arrival: Arrival) -> Reading | None:
        """Return the reading that arrived, None for anything else; SourceError if the device was reset."""
        message = arrival.message
        if isinstance(message, Hello) and message.boot_id != self._hello.boot_id:
            text = "the device was reset"
            raise SourceError(text)
        if not isinstance(message, messages.Reading) or len(message.counts) != self._hello.channel_count:
            return None
        lost = 0 if self._sequence is None else missing_between(self._sequence, message.sequence)
        if lost >= _REPEATED:
            return None
        self._sequence = message.sequence
        device_s = self._device_clock.extend(message.device_us) / 1e6
        taken_s = self._host_clock.to_host(device_s, arrival.monotonic_s)
        return Reading(taken_s, tuple(message.counts[index] for index in self._indices), lost)
