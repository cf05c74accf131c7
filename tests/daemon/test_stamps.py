"""Best estimates of when readings were taken: what a beam that rings is followed by."""

import math

import numpy as np
import pytest

from beamtouch_daemon.sources.board import Arrival, Session
from beamtouch_daemon.sources.stamps import Stamps
from beamtouch_protocol.messages import PROTOCOL_VERSION, SCHEMA_HASH, Hello
from beamtouch_protocol.messages import Reading as Frame

from .devices import StampingUnit, tcp_unit
from .sessions import polled, take_across_sessions

SLOT_S = 0.005
FAST_S, SLOW_S = 0.01, 0.5
"""Of the unit below, between a request and its answer."""


def test_a_reading_was_taken_in_the_middle_of_its_request() -> None:
    stamps = Stamps(SLOT_S)
    for number in range(20):
        asked_s = number * SLOT_S
        assert stamps.date(asked_s, asked_s + 0.001) == pytest.approx(asked_s + 0.0005)


def test_an_answer_that_is_late_says_nothing_of_when() -> None:
    stamps = Stamps(SLOT_S)
    took_s = [0.0007] * 10 + [0.0011, 0.0013, 0.003] + [0.0007]
    assert [math.isnan(stamps.date(0.0, took)) for took in took_s] == [False] * 11 + [True, True, False]


def test_answers_that_are_always_slow_are_usual() -> None:
    stamps = Stamps(SLOT_S)
    took_s = np.full(300, 0.0007)
    took_s[100:] = 0.02
    late = [math.isnan(stamps.date(0.0, took)) for took in took_s]
    assert late[100:110] == [True] * 10
    assert late[120:] == [False] * 180
    assert not math.isnan(stamps.date(0.0, 0.0295))
    assert math.isnan(stamps.date(0.0, 0.031)), "more than half as long again is late even then"


@pytest.mark.anyio
async def test_a_polled_device_is_dated_by_its_requests_and_not_at_all_where_they_are_slow() -> None:
    slow: list[int] = []

    def answer(number: int, frame: bytes) -> list[tuple[float, bytes]]:
        if number % 5 == 4:
            slow.append(number)
        return [(SLOW_S if number % 5 == 4 else FAST_S, frame)]

    async with tcp_unit(StampingUnit(answer)) as port:
        source = f'kind = "modbus-tcp"\nhost = "127.0.0.1"\nport = {port}\ntimeout_ms = 30_000'
        readings, errors = await take_across_sessions(polled(source, [0], 1.0), 10)
    assert errors == []
    assert len(slow) >= 2
    dated = [one.likely_s - one.monotonic_s for one in readings if not math.isnan(one.likely_s)]
    assert sum(math.isnan(one.likely_s) for one in readings) >= 2
    assert len(dated) >= 5
    assert all(FAST_S / 2 <= since_s < SLOW_S / 2 for since_s in dated)


@pytest.mark.parametrize("rate", [0.99, 1.01])
def test_the_readings_of_a_board_are_as_far_apart_as_its_clock_says(rate: float) -> None:
    chance = np.random.default_rng(2)
    session = Session(Hello(PROTOCOL_VERSION, SCHEMA_HASH, 7, 1, 10, 2000), (0,))
    device_s = np.cumsum(chance.uniform(0.003, 0.007, 500))
    taken = []
    for number, at_s in enumerate(device_s.tolist()):
        arrival_s = 1000.0 + at_s / rate + 0.02 * chance.random() ** 2
        frame = Frame(number, round(at_s * 1e6) % 2**32, 1, (5,))
        taken += session.take([Arrival(arrival_s, frame)])
    assert len(taken) == len(device_s)
    likely_s = np.array([one.likely_s for one in taken])
    assert np.diff(likely_s) == pytest.approx(np.diff(device_s), abs=2e-6)
    assert abs(likely_s[0] - taken[0].monotonic_s) < 1e-9
