"""Patterns of faults of a Modbus RTU bus, and how many values of other requests come through them.

The registers of the unit hold the number of the request. A value is stale if it is not that of the newest request, and
foreign if it answers a request that another master sent.
"""

import asyncio
import random
from collections.abc import Callable
from contextlib import aclosing
from dataclasses import dataclass, field
from time import monotonic

from beamtouch_daemon.tasks import cancel

from .devices import Fault, NumberingUnit, Pieces, no_echo, no_fault, rtu_units, with_crc
from .lines import terminal
from .sessions import Buses, Reading, Source, SourceError, source_in

FOREIGN = 60_000
"""Values of the answers to another master are from here on."""
TIMEOUT_S = 0.04
UNIT = 1
NEVER_IN_TIME_HZ = 1e4
"""Every poll begins at once."""
LATENCY_S = 0.016
"""Latency timer of a USB adapter."""


@dataclass(frozen=True)
class Pattern:
    """What goes wrong on a bus."""

    fault: Fault = no_fault
    registers: int = 3
    echo: Callable[[bytes], Pieces] = no_echo
    timeout_s: float = TIMEOUT_S
    sessions: int = 1
    """Sessions that the polls are spread over, each ended at a random moment."""
    is_killed: bool = False
    """Whether a new session knows nothing of the one before, as after kill -9."""
    busy_s: float = 0.0
    """How long the unit and the adapter take for an answer without a fault."""
    is_provable: bool = True
    """False: `check` says that this cannot be told from what is right."""
    is_quick: bool = True
    """False: it takes many polls, or a long time, until its faults have struck."""


@dataclass
class Outcome:
    """What came through."""

    polls: int = 0
    answered: int = 0
    stale: int = 0
    foreign: int = 0
    took_s: float = 0.0
    errors: set[str] = field(default_factory=set)

    @property
    def rate_hz(self) -> float:
        """Answered polls per second."""
        return self.answered / self.took_s


def _busy(busy_s: float) -> Fault:
    return lambda _number, frame: [(busy_s, frame)]


def values_only(fault: Fault) -> Fault:
    """A unit that is silent unless it is asked for one register with function 4."""
    return lambda number, frame: fault(number, frame) if frame[1:3] == b"\4\2" else []


def _one_probe(fault: Fault) -> Fault:
    """A unit of two registers that is silent for other functions and lengths, so that one probe is answered."""
    return lambda number, frame: fault(number, frame) if frame[1:3] in {b"\4\2", b"\4\4"} else []


def _outage(number: int, frame: bytes) -> Pieces:
    """A value and the probe after it are lost, once."""
    return [] if 30 <= number < 32 else [(0.0, frame)]


def _answer_of(unit: int) -> bytes:
    return with_crc(bytes([unit, 4, 6]) + FOREIGN.to_bytes(2, "big") * 3)


class Faults:
    """What may happen to an answer or to an echo; drawn at random."""

    def __init__(self, seed: int) -> None:
        self._chance = random.Random(seed)  # noqa: S311 - faults, not secrets

    def now_and_then(self, share: float, rarely: Callable[[bytes], Pieces], usually: Fault = no_fault) -> Fault:
        return lambda number, frame: rarely(frame) if self._chance.random() < share else usually(number, frame)

    def late(self, frame: bytes) -> Pieces:
        return [(self._chance.uniform(1.1, 12.0) * TIMEOUT_S, frame)]

    def very_late(self, frame: bytes) -> Pieces:
        return [(1.5, frame)]

    def lost(self, _frame: bytes) -> Pieces:
        return []

    def split(self, frame: bytes) -> Pieces:
        cut = self._chance.randrange(1, len(frame) - 1)
        return [(0.0, frame[:cut]), (0.002, frame[cut:-1]), (LATENCY_S, frame[-1:])]

    def doubled(self, frame: bytes) -> Pieces:
        return [(0.0, frame), (0.0005, frame)]

    def noisy(self, frame: bytes) -> Pieces:
        noise = self._chance.randbytes(self._chance.randrange(1, 30))
        return [(0.0, noise), (0.005, frame + noise[:3])]

    def noise_long_before(self, frame: bytes) -> Pieces:
        return [(0.0, self._chance.randbytes(20)), (0.02, frame)]

    def flipped(self, frame: bytes) -> Pieces:
        damaged = bytearray(frame)
        damaged[self._chance.randrange(len(frame))] ^= 1 << self._chance.randrange(8)
        return [(0.0, bytes(damaged))]

    def foreign(self, frame: bytes) -> Pieces:
        return [(0.0, _answer_of(2)), (0.001, frame), (0.0005, _answer_of(3))]

    def refused(self, frame: bytes) -> Pieces:
        return [(0.0, with_crc(bytes([frame[0], frame[1] | 0x80, 6])))]

    def any_of_them(self, frame: bytes) -> Pieces:
        kinds = [self.late, self.lost, self.split, self.doubled, self.noisy, self.flipped, self.foreign]
        kinds.append(self.refused)
        return self._chance.choice(kinds)(frame)

    def echo(self, request: bytes) -> Pieces:
        return [(0.0, request)]

    def echo_in_parts(self, request: bytes) -> Pieces:
        return [(0.0, request[:5]), (LATENCY_S, request[5:])]

    def damaged_echo(self, request: bytes) -> Pieces:
        return self.flipped(request) if self._chance.random() < 0.02 else [(0.0, request)]

    def copied_late(self, frame: bytes) -> Pieces:
        return [(0.0, frame), (0.004, frame)]

    def asked_by_another_master(self, frame: bytes) -> Pieces:
        return [(0.0, _answer_of(UNIT)), (0.001, frame)]


def patterns(seed: int) -> dict[str, Pattern]:
    """All patterns by name; the same seed gives the same faults."""
    faults = Faults(seed)
    often = faults.now_and_then
    lossy = often(0.01, faults.lost, _busy(0.02))
    return {
        "none": Pattern(),
        "late, 3 %": Pattern(often(0.03, faults.late)),
        "late, 3 %, one register": Pattern(often(0.03, faults.late), registers=1, is_quick=False),
        "late by 1.5 s, 0.3 %": Pattern(often(0.003, faults.very_late), is_quick=False),
        "late by 1.5 s, 0.3 %, one register": Pattern(often(0.003, faults.very_late), registers=1, is_quick=False),
        "late, 0.2 %, answers only values": Pattern(
            values_only(often(0.002, faults.late)), registers=1, is_quick=False
        ),
        "one probe, outage": Pattern(_one_probe(_outage), registers=2),
        "lost, 3 %": Pattern(often(0.03, faults.lost)),
        "in three parts, the last byte 16 ms late": Pattern(often(1.0, faults.split), busy_s=LATENCY_S + 0.002),
        "doubled at once": Pattern(lambda _number, frame: [(0.0, frame + frame)]),
        "doubled, before the next request": Pattern(often(1.0, faults.doubled)),
        "answers of other units, 20 %": Pattern(often(0.2, faults.foreign)),
        "noise before and behind, 20 %": Pattern(often(0.2, faults.noisy)),
        "noise, 20 ms before each answer": Pattern(often(1.0, faults.noise_long_before), busy_s=0.02),
        "a flipped bit, 10 %": Pattern(often(0.1, faults.flipped)),
        "each second request refused": Pattern(
            lambda number, frame: faults.refused(frame) if number % 2 else [(0.0, frame)]
        ),
        "refused, 30 %, one register": Pattern(often(0.3, faults.refused), registers=1),
        "refused or late, 20 %": Pattern(often(0.1, faults.refused, often(0.1, faults.late)), is_quick=False),
        "refused, 30 %, answers only values": Pattern(values_only(often(0.3, faults.refused)), registers=1),
        "echo": Pattern(echo=faults.echo),
        "echo, one register": Pattern(echo=faults.echo, registers=1),
        "echo, 20 ms, 1 % lost": Pattern(lossy, echo=faults.echo, busy_s=0.02),
        "echo, 20 ms, 1 % lost, one register": Pattern(lossy, echo=faults.echo, registers=1, busy_s=0.02),
        "echo in parts, 16 ms late, 20 ms, one register": Pattern(
            _busy(0.02), echo=faults.echo_in_parts, registers=1, busy_s=0.02
        ),
        "echo, 2 % of it damaged, 20 ms": Pattern(_busy(0.02), echo=faults.damaged_echo, busy_s=0.02),
        "one of these, 10 %, echo": Pattern(often(0.1, faults.any_of_them), echo=faults.echo),
        "200 sessions anew, 30 ms": Pattern(_busy(0.03), sessions=200, timeout_s=0.1, busy_s=0.03, is_quick=False),
        "200 killed and started anew, 30 ms": Pattern(
            _busy(0.03), sessions=200, timeout_s=0.1, busy_s=0.03, is_killed=True, is_quick=False
        ),
        "50 killed, late 10 %, one register": Pattern(
            often(0.1, faults.late, _busy(0.01)), sessions=50, registers=1, is_killed=True, busy_s=0.01, is_quick=False
        ),
        "a copy after the next request, 1 %": Pattern(often(0.01, faults.copied_late), is_provable=False),
        "another master asks the same, 1 %": Pattern(often(0.01, faults.asked_by_another_master), is_provable=False),
    }


class CountingUnit(NumberingUnit):
    """A unit that knows how often it was asked for values."""

    def __init__(self, fault: Fault, registers: int) -> None:
        super().__init__(fault)
        self.polls = 0
        self._registers = registers

    def answer(self, request: bytes, wrap: Callable[[bytes], bytes]) -> Pieces:
        self.polls += (request[1], request[5]) == (4, self._registers)
        return super().answer(request, wrap)

    def value(self) -> int:
        return super().value() % FOREIGN


async def run(pattern: Pattern, polls: int, seed: int, answers: int = 0) -> Outcome:
    """Poll a unit with a pattern of faults as often as was said, as fast as it answers, and until so many are answered.

    A starved machine misses many of the short times for an answer.
    """
    outcome = Outcome()
    chance = random.Random(seed)  # noqa: S311 - moments, not secrets
    with terminal() as line:
        unit = CountingUnit(pattern.fault, pattern.registers)
        table = f'kind = "modbus-rtu"\nport = "{line.path}"\ntimeout_ms = {pattern.timeout_s * 1e3}'
        places = [f"register = {index}" for index in range(pattern.registers)]
        async with rtu_units(line, {UNIT: unit}, echo=pattern.echo):
            begin_s = monotonic()
            buses: Buses = {}
            for session in range(1, pattern.sessions + 1):
                buses = {} if pattern.is_killed else buses
                reading = asyncio.create_task(_read(source_in(buses, table, places, NEVER_IN_TIME_HZ), unit, outcome))
                # The first values of a session are not used.
                least = answers if session == pattern.sessions else 0
                while unit.polls < (polls / pattern.sessions + 1) * session or outcome.answered < least:
                    await asyncio.wait({reading}, timeout=0.01)
                    assert not reading.done()
                if pattern.sessions > 1:
                    await asyncio.sleep(chance.uniform(0.0, pattern.timeout_s))
                await cancel([reading])
            outcome.polls, outcome.took_s = unit.polls, monotonic() - begin_s
    return outcome


async def _read(source: Source, unit: CountingUnit, outcome: Outcome) -> None:
    """Read for ever; sessions that fail are followed by others."""
    while True:
        try:
            async with aclosing(source.readings()) as stream:
                async for readings in stream:
                    for reading in readings:
                        _judge(reading, unit, outcome)
        except SourceError as error:
            outcome.errors.add(str(error))
            await asyncio.sleep(0.1)


def _judge(reading: Reading, unit: CountingUnit, outcome: Outcome) -> None:
    counts = set(reading.counts)
    outcome.answered += 1
    if any(count is None or count >= FOREIGN for count in counts):
        outcome.foreign += 1
    elif counts != {unit.newest % FOREIGN}:
        outcome.stale += 1
