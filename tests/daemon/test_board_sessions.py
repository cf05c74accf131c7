"""A session with a board, message by message: its pings, its clock, its readings, and a board that does not fit."""

import math
from dataclasses import replace
from itertools import pairwise

import pytest

from beamtouch_daemon.config.sources import SerialLine
from beamtouch_daemon.sources.board import Arrival, BoardSource, Session
from beamtouch_daemon.sources.reading import Reading, SourceError
from beamtouch_protocol.messages import PROTOCOL_VERSION, SCHEMA_HASH, Hello, Message, Ping, Pong
from beamtouch_protocol.messages import Reading as Frame

HELLO = Hello(PROTOCOL_VERSION, SCHEMA_HASH, 7, 3, 10, 2000)
"""Boot 7 of a board with three channels of 10 bits, which gives up to 2000 readings a second."""


def session(*indices: int) -> Session:
    return Session(HELLO, indices or (0, 2))


def frame(sequence: int, device_s: float, *counts: int, oversampling: int = 1) -> Frame:
    return Frame(sequence, round(device_s * 1e6), oversampling, counts or (10, 20, 30))


def taken(open_session: Session, *arrivals: tuple[float, Message]) -> list[Reading]:
    return open_session.take([Arrival(*arrival) for arrival in arrivals])


def test_pings_come_twenty_times_a_second_and_from_the_tenth_on_each_half() -> None:
    one, sent_s, pings = session(), [], list[Ping]()
    for tick in range(300):
        now_s = 5.0 + tick / 100
        if (ping := one.ping_if_due(now_s)) is not None:
            sent_s.append(now_s)
            pings.append(ping)
    assert [later - earlier for earlier, later in pairwise(sent_s)] == pytest.approx([0.05] * 10 + [0.5] * 4, abs=0.011)
    assert [(later.token - earlier.token) % 65_536 for earlier, later in pairwise(pings)] == [1] * 14


@pytest.mark.parametrize(("after_s", "is_known"), [(2.99, True), (3.0, False)])
def test_an_answer_to_a_ping_counts_within_3_s(after_s: float, is_known: bool) -> None:
    one = session()
    ping = one.ping(100.0)
    one.ping(100.0 + after_s)
    assert not one.knows_the_clocks
    one.take_answers([Arrival(100.5 + after_s, Pong(ping.token, 5_000_000))])
    assert one.knows_the_clocks == is_known


def test_an_answer_to_a_ping_that_was_not_sent_or_was_answered_says_nothing() -> None:
    one = session()
    ping = one.ping(100.0)
    one.take_answers([Arrival(100.1, Pong((ping.token + 1) % 65_536, 5_000_000))])
    assert not one.knows_the_clocks
    one.take_answers([Arrival(100.1, Pong(ping.token, 5_000_000))])
    # A second answer would show a clock that went back.
    one.take_answers([Arrival(108.0, Pong(ping.token, 1_000_000))])
    assert one.knows_the_clocks


def test_another_boot_of_the_device_ends_the_session() -> None:
    one = session()
    one.take_answers([Arrival(100.0, HELLO)])
    with pytest.raises(SourceError, match=r"^the device was reset$"):
        taken(one, (100.0, Hello(PROTOCOL_VERSION, SCHEMA_HASH, 8, 3, 10, 2000)))


def test_a_reading_has_the_counts_of_the_configured_channels_over_the_conversions() -> None:
    (reading,) = taken(session(2, 0), (100.0, frame(5, 1.0, 1000, 7, 90, oversampling=4)))
    assert (reading.counts, reading.lost) == ((22.5, 250.0), 0)
    assert (reading.monotonic_s, reading.taken_s) == (100.0, 100.0)


@pytest.mark.parametrize(("sequence", "lost"), [(6, 0), (7, 1), (5 + 32_768, 32_767), (5 + 32_769, None), (5, None)])
def test_readings_between_two_numbers_are_lost_and_a_step_back_is_a_repeated_one(
    sequence: int, lost: int | None
) -> None:
    one = session()
    taken(one, (100.0, frame(5, 1.0)))
    found = taken(one, (100.01, frame(sequence, 1.01)))
    assert [reading.lost for reading in found] == ([] if lost is None else [lost])


@pytest.mark.parametrize(("back_s", "goes_back"), [(0.099, False), (0.101, True)])
def test_a_reading_that_is_older_than_the_one_before_by_a_tenth_of_a_second_ends_the_session(
    back_s: float, goes_back: bool
) -> None:
    one = session()
    taken(one, (100.0, frame(5, 1.0)))
    if goes_back:
        with pytest.raises(SourceError, match=r"^the device's clock went back$"):
            taken(one, (100.01, frame(6, 1.0 - back_s)))
    else:
        (reading,) = taken(one, (100.01, frame(6, 1.0 - back_s)))
        assert reading.taken_s == pytest.approx(100.0 - back_s)


@pytest.mark.parametrize(("device_s", "goes_back"), [(4.2, False), (3.5, True)])
def test_an_answer_with_a_time_from_well_before_its_ping_ends_the_session(device_s: float, goes_back: bool) -> None:
    one = session()
    first = one.ping(100.0)
    one.take_answers([Arrival(100.0, Pong(first.token, 5_000_000))])
    second = one.ping(100.0 + 0.0)
    arrival = Arrival(100.1, Pong(second.token, round(device_s * 1e6)))
    if goes_back:
        with pytest.raises(SourceError, match=r"^the device's clock went back$"):
            one.take_answers([arrival])
    else:
        one.take_answers([arrival])


@pytest.mark.parametrize(
    ("message", "fits"),
    [
        (frame(5, 1.0, 1023, 0, 0), True),
        (frame(5, 1.0, 0, 1024, 0), False),
        (frame(5, 1.0, 0, 4092, 0, oversampling=4), True),
        (frame(5, 1.0, 0, 4093, 0, oversampling=4), False),
        (frame(5, 1.0, 0, 0, 0, oversampling=0), False),
        (frame(5, 1.0, 1, 2), False),
        (frame(5, 1.0, 1, 2, 3, 4), False),
        (Ping(5), False),
    ],
)
def test_a_reading_that_the_device_cannot_have_sent_is_left_out(message: Message, fits: bool) -> None:
    assert len(taken(session(), (100.0, message))) == fits


def test_of_a_burst_the_newest_reading_dates_the_others() -> None:
    one = session()
    old, new = taken(one, (100.0, frame(5, 1.0)), (100.0, frame(6, 1.75)))
    latest_s = 100.0 - 0.75 * (1 - 0.01)  # the device's clock may be wrong by a hundredth
    assert [old.monotonic_s, new.monotonic_s] == pytest.approx([latest_s, 100.0])
    assert [old.taken_s, new.taken_s] == pytest.approx([latest_s, latest_s + 0.75])


def source(
    *indices: int, rate_hz: float = 200.0, bits: tuple[int, ...] = (10, 10), oversampling: int = 64
) -> BoardSource:
    settings = SerialLine(kind="serial", port="/dev/x", oversampling=oversampling)
    return BoardSource(settings, indices or (0, 2), rate_hz, bits)


@pytest.mark.parametrize(
    ("board", "hello", "said"),
    [
        (
            source(),
            replace(HELLO, protocol_version=9, schema_hash=0xAB12),
            f"the device speaks protocol 9 (0000ab12), this daemon {PROTOCOL_VERSION} ({SCHEMA_HASH:08x}); update the "
            "older of the two",
        ),
        (source(3, 0), HELLO, "the device has 3 channels; register 3 is beyond the last"),
        (source(bits=(10, 12)), HELLO, "the device has 10 ADC bits; correct adc_bits of its channels"),
        (source(rate_hz=2001.0), HELLO, "the device gives at most 2000 readings per second; lower rate_hz"),
        (source(oversampling=65), HELLO, "sums of 65 conversions of 10 bits do not fit; lower oversampling"),
    ],
)
def test_a_device_that_does_not_fit_is_refused_with_the_reason(board: BoardSource, hello: Hello, said: str) -> None:
    with pytest.raises(SourceError) as raised:
        board._require("/dev/x", hello)
    assert raised.value.reason == f"/dev/x: {said}"


def test_a_device_that_just_fits_is_taken() -> None:
    source(2, 0, rate_hz=2000.0)._require("/dev/x", HELLO)
    source(oversampling=1, bits=(16, 16))._require("/dev/x", replace(HELLO, adc_bits=16))


@pytest.mark.parametrize(("rate_hz", "silence_s"), [(1.0, 10.0), (16.0, 0.625), (20.0, 0.5), (2000.0, 0.5)])
def test_a_device_is_silent_after_half_a_second_or_ten_readings(rate_hz: float, silence_s: float) -> None:
    assert source(rate_hz=rate_hz)._silence_s == silence_s


def test_a_reading_from_far_in_the_future_is_left_out() -> None:
    one = session()
    ping = one.ping(100.0)
    one.take_answers([Arrival(100.0, Pong(ping.token, 5_000_000))])
    assert taken(one, (100.1, frame(5, 6.5))) == []
    (reading,) = taken(one, (100.1, frame(6, 5.1)))
    assert (reading.lost, math.isclose(reading.monotonic_s, 100.1, abs_tol=2e-3)) == (0, True)
