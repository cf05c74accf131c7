"""A session with a device that speaks the protocol of `PROTOCOL.md`: its boot, sequence and clock. No I/O."""

import secrets
from collections.abc import Sequence

from beamtouch_daemon.sources.clock import HostClock
from beamtouch_daemon.sources.reading import Reading, SourceError
from beamtouch_daemon.sources.serial_port import Arrival
from beamtouch_protocol import messages
from beamtouch_protocol.messages import Hello, Message, Ping, Pong
from beamtouch_protocol.sequence import DeviceClock, missing_between

PING_S = 0.5
FIRST_PINGS = 10
FIRST_PING_S = 0.05
"""Time between pings; the first ones come faster, so that the drift of the clocks is known soon."""
LATEST_PONG_S = 3.0
BACK_S = 0.1
"""A reading that is older than its predecessor by more than this shows that the device's clock went back."""
CLOCK_WENT_BACK = "the device's clock went back"
_TOKENS = 1 << 16
_REPEATED = 1 << 15
"""More readings cannot be lost without a silence, so a larger step of the sequence is a repeated reading."""


class Session:
    """The state of one session: the boot of the device, the sequence of its readings, and both clocks."""

    def __init__(self, hello: Hello, indices: tuple[int, ...]) -> None:
        self.knows_the_clocks = False
        """Whether there was a round trip."""
        self._hello = hello
        self._indices = indices
        self._sequence: int | None = None
        self._device_s = 0.0
        """Time of the last reading on the device's clock [s]."""
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
        fitting = [(at_s, reading) for at_s, message in arrivals if (reading := self._fitting(message)) is not None]
        dated = [(at_s, self._device_clock.follow(reading.device_us) / 1e6, reading) for at_s, reading in fitting]
        dated = [row for row in dated if not self._host_clock.is_beyond(row[1], row[0])]
        for arrival_s, device_s, _ in dated:
            self._host_clock.heard(device_s, arrival_s)
        readings = []
        for arrival_s, device_s, reading in dated:
            lost = 0 if self._sequence is None else missing_between(self._sequence, reading.sequence)
            if lost >= _REPEATED:
                continue
            if self._sequence is not None and device_s < self._device_s - BACK_S:
                raise SourceError(CLOCK_WENT_BACK)
            self._sequence, self._device_s = reading.sequence, device_s
            counts = tuple(reading.counts[index] / reading.oversampling for index in self._indices)
            readings.append(Reading(self._host_clock.to_host(device_s, arrival_s), counts, lost))
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

    def _fitting(self, message: Message) -> messages.Reading | None:
        """Return a message if it is a plausible reading of this device."""
        return message if isinstance(message, messages.Reading) and self._fits(message) else None

    def _fits(self, message: messages.Reading) -> bool:
        """Return whether a reading is plausible for this device."""
        highest = message.oversampling * (2**self._hello.adc_bits - 1)
        return len(message.counts) == self._hello.channel_count and highest > 0 and max(message.counts) <= highest
