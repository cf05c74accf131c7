"""A device that speaks the protocol of `PROTOCOL.md` on a serial line.

A session: stop, hello, check the device, ping until its clock is known, start, then take readings and ping now and
then. It ends with SourceError when the port disappears, when the device falls silent or was reset, when its clock goes
back, or when it is not the device in the configuration.
"""

import contextlib
from collections.abc import AsyncGenerator, Sequence

from beamtouch_daemon.config.sources import SerialLine
from beamtouch_daemon.sources.reading import Reading, SourceError
from beamtouch_daemon.sources.serial_port import SerialPort
from beamtouch_daemon.sources.serial_session import Session
from beamtouch_daemon.uptime import uptime_s
from beamtouch_protocol import messages
from beamtouch_protocol.messages import Hello, HelloRequest, Start, Stop

HELLO_TIMEOUT_S = 3.0
"""Opening the port resets many boards, whose boot loaders then take a while."""
HELLO_REPEAT_S = 0.3
SILENCE_S = 0.5
SILENCE_PERIODS = 10.0
"""A device is silent after the longer of this time and this number of periods without a reading."""
MAX_COUNT = 65_535


class SerialSource:
    """Yields readings as the device sends them, with device times mapped to the host's clock."""

    def __init__(self, settings: SerialLine, indices: Sequence[int], rate_hz: float, adc_bits: Sequence[int]) -> None:
        self._path = settings.port
        self._baud = settings.baud
        self._indices = tuple(indices)
        self._rate_hz = int(rate_hz)
        self._oversampling = settings.oversampling
        self._adc_bits = tuple(adc_bits)
        self._silence_s = max(SILENCE_S, SILENCE_PERIODS / rate_hz)

    @property
    def limits(self) -> tuple[str, ...]:
        """Empty: each reading has a number and the device's time."""
        return ()

    async def readings(self) -> AsyncGenerator[list[Reading], None]:
        """Open the port, check and start the device, and yield its readings."""
        port = SerialPort(self._path, self._baud)
        try:
            hello = await introduce(port, self._path, self._baud)
            self._require(hello)
            session = Session(hello, self._indices)
            await self._meet(port, session)
            port.send(Start(self._rate_hz, self._oversampling))
            heard_s = uptime_s()
            while True:
                if (ping := session.ping_if_due(uptime_s())) is not None:
                    port.send(ping)
                arrivals = await port.receive(self._silence_s)
                if readings := session.take(arrivals):
                    heard_s = uptime_s()
                    yield readings
                elif uptime_s() - heard_s >= self._silence_s:
                    asked = f"{self._rate_hz} Hz, oversampling {self._oversampling}"
                    message = f"{self._path}: no reading for {self._silence_s:g} s{_damage(port)} ({asked})"
                    raise SourceError(message)
        finally:
            with contextlib.suppress(SourceError):  # the port may be gone
                port.send(Stop())
            port.close()

    async def _meet(self, port: SerialPort, session: Session) -> None:
        """Ping until the device's clock is known, because the first reading may be an old one."""
        deadline_s = uptime_s() + HELLO_TIMEOUT_S
        while (now_s := uptime_s()) < deadline_s:
            port.send(session.ping(now_s))
            repeat_s = now_s + HELLO_REPEAT_S
            while (left_s := repeat_s - uptime_s()) > 0:
                session.take_answers(await port.receive(left_s))
                if session.knows_the_clocks:
                    return
        message = (
            f"{self._path}: no answer to a ping within {HELLO_TIMEOUT_S:g} s, so the age of its readings is unknown"
        )
        raise SourceError(message)

    def _require(self, hello: Hello) -> None:
        """Raise SourceError unless the device fits the configuration."""
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
        elif self._oversampling * (2**hello.adc_bits - 1) > MAX_COUNT:
            wrong = f"sums of {self._oversampling} conversions of {hello.adc_bits} bits do not fit; lower oversampling"
        if wrong:
            message = f"{self._path}: {wrong}"
            raise SourceError(message)


async def introduce(port: SerialPort, path: str, baud: int) -> Hello:
    """Return the hello of the device on a port; ignore readings of a stream that still runs.

    Raises
    ------
    SourceError
        None came within `HELLO_TIMEOUT_S`, or the port is gone; `path` and `baud` are for its text.
    """
    deadline_s = uptime_s() + HELLO_TIMEOUT_S
    while (now_s := uptime_s()) < deadline_s:
        port.send(Stop())
        port.send(HelloRequest())
        repeat_s = now_s + HELLO_REPEAT_S
        while (left_s := repeat_s - uptime_s()) > 0:
            for arrival in reversed(await port.receive(left_s)):
                if isinstance(arrival.message, Hello):
                    return arrival.message
    message = (
        f"{path}: no hello within {HELLO_TIMEOUT_S:g} s{_damage(port)}; "
        f"is it a beamtouch device, and is {baud} its baud rate?"
    )
    raise SourceError(message)


def _damage(port: SerialPort) -> str:
    return ", only damaged frames" if port.rejected else ""
