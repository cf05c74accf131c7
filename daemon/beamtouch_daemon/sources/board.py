"""A device that speaks the protocol of `PROTOCOL.md` on a serial line.

A session: stop, hello, check the device, ping until its clock is known, start, then take readings and ping now and
then. It ends with SourceError when the port disappears, when the device falls silent or was reset, when its clock goes
back, or when it is not the device in the configuration. The next one uses the same port, if that stays open.
"""

import logging
import math
import secrets
from collections.abc import AsyncGenerator, Callable, Mapping, Sequence
from contextlib import AbstractContextManager, aclosing, suppress
from typing import NamedTuple, TypeGuard

from beamtouch_common.uptime import uptime_s
from beamtouch_common.waits import Backoff
from beamtouch_daemon.config.sources import SerialLine
from beamtouch_daemon.sources.clock import HostClock
from beamtouch_daemon.sources.frame_diagnosis import in_hex
from beamtouch_daemon.sources.kept_port import KeptPort
from beamtouch_daemon.sources.reading import Reading, SourceError
from beamtouch_daemon.sources.requests import Requests
from beamtouch_daemon.sources.serial_port import LineSettings, SerialPort
from beamtouch_daemon.sources.traffic import text_of
from beamtouch_protocol import messages
from beamtouch_protocol.framing import Decoder, encode
from beamtouch_protocol.messages import Hello, HelloRequest, Message, Ping, Pong, Start, Stop
from beamtouch_protocol.sequence import DeviceClock, missing_between

HELLO_TIMEOUT_S = 3.0
"""Shortest time for a hello, and time for an answer to a ping. The first hello after the port was opened may take as
long as a device boots."""
REPEAT_S, MAX_REPEAT_S = 0.3, 2.4
"""First and longest time between two requests for a hello: some boot loaders wait as long as bytes come."""
SILENCE_S, SILENCE_PERIODS = 0.5, 10.0
"""A device is silent after the longer of this time and this number of periods without a reading."""
MAX_COUNT = 65_535
PING_S, FIRST_PING_S, FIRST_PINGS = 0.5, 0.05, 10
"""Time between pings; the first ones come faster, so that the drift of the clocks is known soon."""
LATEST_PONG_S = 3.0
BACK_S = 0.1
"""A reading that is older than its predecessor by more than this shows that the device's clock went back."""
CLOCK_WENT_BACK = "the device's clock went back"
FROM_DEVICE = 0x80
"""Types of messages from here on come from devices, others from hosts."""
_logger = logging.getLogger(__name__)
_TOKENS = 1 << 16
_REPEATED = 1 << 15
"""More readings cannot be lost without a silence, so a larger step of the sequence is a repeated reading."""


class Arrival(NamedTuple):
    """A message and its arrival by the clock of `uptime_s`."""

    monotonic_s: float
    message: Message


class BoardLine:
    """An open port that carries messages."""

    def __init__(self, port: SerialPort) -> None:
        self.path = port.path
        self._port = port
        self._decoder = Decoder()

    @property
    def observed(self) -> str:
        """Description of the bytes that came through the port instead of messages; empty if any came lately."""
        return self._port.traffic.describe(uptime_s())

    def send(self, message: Message) -> None:
        """Send a message; SourceError if the port does not accept it."""
        _logger.debug("%s: sent %s", self.path, message)
        self._port.send(encode(message))

    async def receive(self, within_s: float) -> list[Arrival]:
        """Wait for bytes and return the messages in them, if any; SourceError without a port."""
        received = await self._port.receive(within_s)
        arrived = self._decoder.feed(received)
        if _logger.isEnabledFor(logging.DEBUG):
            self._debug_arrivals(received, arrived)
        if any(message.TYPE >= FROM_DEVICE for message in arrived):
            self._port.traffic.note_frame(self._port.taken_s)
        elif not arrived:  # else an echo
            self._port.traffic.note_other(received)
        return [Arrival(self._port.taken_s, message) for message in arrived]

    def _debug_arrivals(self, received: bytes, arrived: Sequence[Message]) -> None:
        """Write to the debug log what came."""
        for message in arrived:
            _logger.debug("%s: received %s", self.path, message)
        if received and not arrived:
            text = text_of(received)
            kind = f"text: {text!r}" if text else "no whole message, or one with a wrong checksum"
            _logger.debug("%s: %d bytes came (%s): %s", self.path, len(received), in_hex(received), kind)

    async def ask(
        self, question: Callable[[], Sequence[Message]], within_s: float, max_repeat_s: float = REPEAT_S
    ) -> AsyncGenerator[list[Arrival], None]:
        """Send a question again and again for a time, and yield what arrives. The pauses grow to `max_repeat_s`."""
        deadline_s, pauses = uptime_s() + within_s, Backoff(REPEAT_S, max_repeat_s)
        while (now_s := uptime_s()) < deadline_s:
            for message in question():
                self.send(message)
            repeat_s = min(now_s + pauses.next(), deadline_s)
            while (left_s := repeat_s - uptime_s()) > 0:
                yield await self.receive(left_s)

    async def introduce(self) -> Hello:
        """Return the hello of the device, without the readings of a stream that still runs.

        Raises
        ------
        SourceError
            None came within `HELLO_TIMEOUT_S`, or as long as the device may boot, or the port is gone.
        """
        within_s = max(HELLO_TIMEOUT_S, self._port.traffic.boots_until_s - uptime_s())
        async with aclosing(self.ask(lambda: (Stop(), HelloRequest()), within_s, MAX_REPEAT_S)) as stream:
            async for arrivals in stream:
                for arrival in reversed(arrivals):
                    if isinstance(arrival.message, Hello):
                        return arrival.message
        raise SourceError(f"{self.path}: no hello of a Beamtouch board", self.observed)


class Session:
    """The state of one session: the boot of the device, the sequence of its readings, and both clocks."""

    def __init__(self, hello: Hello, indices: tuple[int, ...]) -> None:
        self.knows_the_clocks = False
        """True if there was a round trip."""
        self._hello = hello
        self._indices = indices
        self._sequence: int | None = None
        self._device_s = -math.inf
        """Time of the last reading on the device's clock [s]."""
        self._begun_s: float | None = None
        """Time of the host when that clock began, as the first reading says."""
        self._device_clock = DeviceClock()
        self._host_clock = HostClock()
        self._pinged_s: dict[int, float] = {}
        self._pings = 0
        self._next_ping_s = 0.0
        # Tokens differ between sessions, because an adapter may hold back an answer to an earlier ping.
        self._first_token = secrets.randbelow(_TOKENS)

    def ping(self, now_s: float) -> Ping:
        """Return the next ping, which is sent now."""
        self._next_ping_s = now_s + (FIRST_PING_S if self._pings < FIRST_PINGS else PING_S)
        token = (self._first_token + self._pings) % _TOKENS
        self._pings += 1
        self._pinged_s = {old: at_s for old, at_s in self._pinged_s.items() if now_s - at_s < LATEST_PONG_S}
        self._pinged_s[token] = now_s
        return Ping(token)

    def ping_if_due(self, now_s: float) -> Ping | None:
        """Return the ping to send now; None if it is not time yet."""
        return None if now_s < self._next_ping_s else self.ping(now_s)

    def take(self, arrivals: Sequence[Arrival]) -> list[Reading]:
        """Return the readings among the arrivals; SourceError if the device was reset or its clock went back.

        The clock sees all arrivals before the first reading gets its time: in a burst only the newest is fresh.
        """
        self.take_answers(arrivals)
        fitting = [(at_s, message) for at_s, message in arrivals if self._fits(message)]
        dated = [(at_s, self._device_clock.follow(reading.device_us) / 1e6, reading) for at_s, reading in fitting]
        dated = [row for row in dated if not self._host_clock.is_beyond(row[1], row[0])]
        for arrival_s, device_s, _ in dated:
            self._host_clock.add_frame(device_s, arrival_s)
        readings = []
        for arrival_s, device_s, reading in dated:
            lost = 0 if self._sequence is None else missing_between(self._sequence, reading.sequence)
            if lost >= _REPEATED:
                continue
            if device_s < self._device_s - BACK_S:
                raise SourceError(CLOCK_WENT_BACK)
            self._sequence, self._device_s = reading.sequence, device_s
            counts = tuple(reading.counts[index] / reading.oversampling for index in self._indices)
            monotonic_s = self._host_clock.to_host(device_s, arrival_s)
            if self._begun_s is None:
                self._begun_s = monotonic_s - device_s
            # By the device's own clock, which is steadier than what the host knows of it.
            readings.append(Reading(monotonic_s, counts, lost, taken_s=self._begun_s + device_s))
        return readings

    def take_answers(self, arrivals: Sequence[Arrival]) -> None:
        """Use the answers to pings among the arrivals; SourceError if the device was reset or its clock went back."""
        for arrival_s, message in arrivals:
            if isinstance(message, Hello) and message.boot_id != self._hello.boot_id:
                text = "the device was reset"
                raise SourceError(text)
            if isinstance(message, Pong) and (sent_s := self._pinged_s.pop(message.token, None)) is not None:
                device_s = self._device_clock.follow(message.device_us) / 1e6
                if self._host_clock.is_behind(device_s, sent_s):
                    raise SourceError(CLOCK_WENT_BACK)
                self._host_clock.round_trip(sent_s, device_s, arrival_s)
                self.knows_the_clocks = True

    def _fits(self, message: Message) -> TypeGuard[messages.Reading]:
        """Return whether a message is a plausible reading of this device."""
        if not isinstance(message, messages.Reading):
            return False
        highest = message.oversampling * (2**self._hello.adc_bits - 1)
        return len(message.counts) == self._hello.channel_count and highest > 0 and max(message.counts) <= highest


class BoardSource:
    """Yields readings as the device sends them, with device times mapped to the host's clock."""

    limits: tuple[str, ...] = ()
    """None: each reading has a number and the device's time."""

    def __init__(self, settings: SerialLine, indices: Sequence[int], rate_hz: float, adc_bits: Sequence[int]) -> None:
        self.requests: Mapping[str, Requests] = {}
        """None: the device sends by itself."""
        self._port = KeptPort(settings.port, LineSettings(settings.baud))
        self._indices = tuple(indices)
        self._rate_hz = int(rate_hz)
        self._oversampling = settings.oversampling
        self._adc_bits = tuple(adc_bits)
        self._silence_s = max(SILENCE_S, SILENCE_PERIODS / rate_hz)

    def kept_open(self) -> AbstractContextManager[None]:
        """Let the port stay open between the sessions in the block."""
        return self._port.kept_open()

    async def readings(self) -> AsyncGenerator[list[Reading], None]:
        """Open the port, check and start the device, and yield its readings."""
        async with self._port.used() as port:
            line = BoardLine(port)
            try:
                hello = await line.introduce()
                self._require(line.path, hello)
                session = Session(hello, self._indices)
                await self._meet(line, session)
                line.send(Start(self._rate_hz, self._oversampling))
                last_reading_s = uptime_s()
                while True:
                    if (ping := session.ping_if_due(uptime_s())) is not None:
                        line.send(ping)
                    arrivals = await line.receive(self._silence_s)
                    if readings := session.take(arrivals):
                        last_reading_s = uptime_s()
                        yield readings
                    elif uptime_s() - last_reading_s >= self._silence_s:
                        asked = f"{self._rate_hz} Hz, oversampling {self._oversampling}"
                        raise SourceError(f"{line.path}: no reading for {self._silence_s:g} s ({asked})", line.observed)
            finally:
                with suppress(SourceError):  # the port may be gone
                    line.send(Stop())

    async def _meet(self, line: BoardLine, session: Session) -> None:
        """Ping until the device's clock is known, because the first reading may be an old one."""
        async with aclosing(line.ask(lambda: (session.ping(uptime_s()),), HELLO_TIMEOUT_S)) as stream:
            async for arrivals in stream:
                session.take_answers(arrivals)
                if session.knows_the_clocks:
                    return
        doubt = "so the age of its readings is unknown"
        raise SourceError(f"{line.path}: no answer to a ping within {HELLO_TIMEOUT_S:g} s, {doubt}", line.observed)

    def _require(self, path: str, hello: Hello) -> None:
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
            raise SourceError(f"{path}: {wrong}")
