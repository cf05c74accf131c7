"""The schedule of polled sources, and device time on the host's clock."""

import math
import random

import pytest

from beamtouch_daemon.sources.clock import HostClock, RoundTrips
from beamtouch_daemon.sources.reading import Schedule


def test_slots_do_not_drift_however_late_each_poll_was() -> None:
    schedule, now_s = Schedule(rate_hz=3.0, start_s=10.0), 10.0
    for slot in range(20_000):
        delay_s, missed = schedule.advance(now_s)
        assert missed == 0
        begins_s = now_s + delay_s
        assert begins_s == pytest.approx(10.0 + slot / 3.0, abs=1e-9)
        now_s = begins_s + 0.3  # the poll takes nearly the whole slot


def test_slots_that_have_passed_are_skipped_and_counted_and_not_caught_up() -> None:
    schedule = Schedule(rate_hz=10.0, start_s=0.0)
    assert schedule.advance(0.0) == (0.0, 0)
    assert schedule.advance(0.55) == (0.0, 4)  # slots 1 to 4 are gone, 5 has begun
    delay_s, missed = schedule.advance(0.56)
    assert (delay_s == pytest.approx(0.04), missed) == (True, 0)


@pytest.mark.parametrize("rate", [0.995, 1.005])
def test_device_times_follow_the_host_whether_the_device_runs_slow_or_fast(rate: float) -> None:
    chance = random.Random(3)  # noqa: S311
    clock = HostClock()
    worst_s, last_s = 0.0, -math.inf
    for number in range(12_000):  # a minute at 200 Hz
        true_s = 1000.0 + number / 200.0
        arrival_s = true_s + 0.001 + 0.010 * chance.random() ** 4
        mapped_s = clock.to_host(7.0 + rate * number / 200.0, arrival_s)
        assert last_s <= mapped_s <= arrival_s
        last_s, worst_s = mapped_s, max(worst_s, abs(mapped_s - true_s))
    assert worst_s < 0.011


def test_round_trips_find_offset_and_drift_though_one_way_is_slow_now_and_then() -> None:
    chance = random.Random(4)  # noqa: S311
    clock = HostClock()
    rate, worst_s, start = 1.004, 0.0, 5000.0
    for number in range(12_000):  # a minute at 200 Hz
        true_s = number / 200.0
        device_s = 77.0 + rate * true_s
        if number % 100 == 0:
            there_s = 0.0002 + (0.03 * chance.random() if chance.random() < 0.4 else 0.0)
            back_s = 0.0002 + 0.0001 * chance.random()
            clock.round_trip(start + true_s - there_s, device_s, start + true_s + back_s)
        mapped_s = clock.to_host(device_s, start + true_s + 0.02 + 0.01 * chance.random())  # each reading 20 ms late
        if number > 4000:
            worst_s = max(worst_s, abs(mapped_s - start - true_s))
    assert worst_s < 0.0003  # where arrivals alone are 20 ms off


@pytest.mark.parametrize(("held_s", "drift"), [(0.1, 0.0), (0.4, -0.005), (0.7, 0.005)])
def test_no_stamp_is_later_than_the_truth_behind_an_adapter_that_holds_everything_back(
    held_s: float, drift: float
) -> None:
    chance = random.Random(5)  # noqa: S311
    clock, start_s, later_s, earlier_s, ping_s = HostClock(), 300.0, -math.inf, -math.inf, 0.0
    pings: list[float] = []
    clock.round_trip(start_s, 9.0, start_s + 0.5 * held_s)
    for burst in range(1, round(60 / held_s)):
        arrival_s = start_s + burst * held_s
        while ping_s < arrival_s - 0.001:
            pings.append(ping_s := max(ping_s, start_s) + 0.5)
        trues = [arrival_s - held_s + (number + chance.random()) / 200.0 for number in range(round(held_s * 200))]
        for sent_s in [sent_s for sent_s in pings if sent_s < arrival_s]:
            handled_s = sent_s + 0.001
            clock.round_trip(sent_s, 9.0 + (1 + drift) * (handled_s - start_s), arrival_s)
            pings.remove(sent_s)
        for true_s in sorted(trues):
            clock.add_frame(9.0 + (1 + drift) * (true_s - start_s), arrival_s)
        for true_s in sorted(trues):
            mapped_s = clock.to_host(9.0 + (1 + drift) * (true_s - start_s), arrival_s)
            later_s, earlier_s = max(later_s, mapped_s - true_s), max(earlier_s, true_s - mapped_s)
    assert later_s < 0.001
    assert earlier_s < 0.03


def test_the_first_burst_of_a_session_is_as_old_as_it_is() -> None:
    clock = HostClock()
    for number in range(140):
        clock.add_frame(number / 200.0, 100.7)  # 0.7 s of readings, all at once, and no round trip
    assert clock.to_host(0.0, 100.7) == pytest.approx(100.0, abs=0.013)


def test_a_device_time_that_has_not_come_yet_is_told() -> None:
    clock = HostClock()
    clock.round_trip(50.0, 7.0, 50.001)
    assert clock.is_beyond(2000.0, 51.0)
    assert not clock.is_beyond(8.0, 51.0)


def test_readings_that_a_stalled_line_delivers_in_a_burst_stay_old() -> None:
    clock = HostClock()
    for number in range(200):
        clock.to_host(number / 200.0, 100.0 + number / 200.0)
    late = [clock.to_host(1.0 + number / 200.0, 104.0) for number in range(600)]  # 3 s of readings, all at 104 s
    assert late[0] == pytest.approx(101.0, abs=0.001)
    assert late[400] == pytest.approx(103.0, abs=0.03)


def test_the_smallest_delay_so_far_creeps_by_a_hundredth_of_the_time_of_the_device() -> None:
    clock = HostClock()
    clock.add_frame(20.0, 120.0)
    assert clock.to_host(60.0, 190.0) == pytest.approx(160.0 + 0.4)  # 30 s late, of which 0.4 s may be drift
    assert clock.to_host(70.0, 170.3) == pytest.approx(170.3)  # it is 0.2 s earlier than the drift allows
    assert clock.to_host(80.0, 400.0) == pytest.approx(180.3 + 0.1)
    # An earlier reading of the same burst is later than what was said of it before by as much as clocks drift.
    assert HostClock().to_host(5.0, 50.0) == 50.0


def test_an_older_reading_of_a_burst_is_dated_from_the_newest() -> None:
    clock = HostClock()
    for device_s in (10.0, 14.0):
        clock.add_frame(device_s, 100.0)
    assert clock.to_host(10.0, 100.0) == pytest.approx(96.0 + 0.04)
    assert clock.to_host(14.0, 100.0) == pytest.approx(100.0)


@pytest.mark.parametrize(("device_s", "is_beyond"), [(8.5, False), (9.05, True)])
def test_a_time_is_beyond_if_it_is_a_second_in_the_future_whatever_the_drift(device_s: float, is_beyond: bool) -> None:
    clock = HostClock()
    assert not clock.is_beyond(1e6, 0.0)  # nothing is known before a round trip
    clock.round_trip(50.0, 7.0, 50.001)
    assert clock.is_beyond(device_s, 51.0) == is_beyond  # 51.5, and 52.05 less the drift of 2 s


@pytest.mark.parametrize(("device_s", "is_behind"), [(17.9, True), (18.05, False), (30.0, False)])
def test_an_answer_is_behind_if_its_time_is_a_second_before_the_ping(device_s: float, is_behind: bool) -> None:
    clock = HostClock()
    clock.add_frame(7.0, 50.0)
    # At 62, a device that was at 7 at 50 is at 19, and may be a hundredth of 11 s slower.
    assert clock.is_behind(device_s - 0.11, 62.0) == is_behind


def test_without_enough_round_trips_a_stamp_is_earlier_by_a_hundredth_of_the_time_since() -> None:
    trips = RoundTrips()
    assert trips.to_host(7.0) is None
    for number in range(4):
        trips.add(50.0 + number, 7.0 + number, 50.004 + number)
    assert trips.to_host(10.0) == pytest.approx(53.0)  # at the best ping, the newest
    assert trips.to_host(20.0) == pytest.approx(63.0 - 0.1)
    assert trips.to_host(5.0) == pytest.approx(48.0 - 0.05)


def test_with_round_trips_over_a_while_the_slope_is_known_and_its_doubt_is_small() -> None:
    trips = RoundTrips()
    for number in range(21):  # over 20 s of the device, whose clock is quick by 0.5 %
        trips.add(50.0 + number / 1.005, 7.0 + number, 50.004 + number / 1.005)
    at_s = trips.to_host(127.0)
    assert at_s is not None
    # The best ping may be any, by a doubt of 4 ms in the 4 s or more that the fastest span.
    assert 50.0 + 120 / 1.005 - 0.121 <= at_s <= 50.0 + 120 / 1.005 + 1e-6


def test_five_round_trips_tell_the_slope_if_they_span_enough() -> None:
    trips, slopes = RoundTrips(), []
    for number in range(5):  # over 8 s of the device, whose clock is quick by 0.5 %
        trips.add(50.0 + 2 * number / 1.005, 7.0 + 2 * number, 50.000001 + 2 * number / 1.005)
        early_s, late_s = trips.to_host(1007.0), trips.to_host(2007.0)
        assert early_s is not None
        assert late_s is not None
        slopes.append((late_s - early_s) / 1000)
    assert slopes == pytest.approx([0.99] * 4 + [1 / 1.005], abs=1e-5)


def test_the_drift_is_that_of_the_middles_of_round_trips() -> None:
    trips = RoundTrips()
    for number, took_s in enumerate((0.01, 0.02, 0.03, 0.04, 0.05)):  # ever slower, there and back alike
        middle_s = 50.0 + 2 * number / 1.005
        trips.add(middle_s - took_s / 2, 7.0 + 2 * number, middle_s + took_s / 2)
    early_s, late_s = trips.to_host(1007.0), trips.to_host(2007.0)
    assert early_s is not None
    assert late_s is not None
    assert (late_s - early_s) / 1000 == pytest.approx(1 / 1.005 - 0.05 / 8, abs=1e-6)  # less the doubt of the slope


def test_a_slope_beyond_what_clocks_have_is_taken_for_a_hundredth() -> None:
    for rate, slope in ((1.05, 1.01), (0.95, 0.99)):
        trips = RoundTrips()
        for number in range(40):
            trips.add(50.0 + rate * number, 7.0 + number, 50.000001 + rate * number)
        early_s, late_s = trips.to_host(1007.0), trips.to_host(2007.0)
        assert early_s is not None
        assert late_s is not None
        assert (late_s - early_s) / 1000 == pytest.approx(slope, abs=1e-5)


def test_only_the_newest_sixty_round_trips_count() -> None:
    trips = RoundTrips()
    trips.add(1000.0, 0.0, 1000.1)  # a ping that was not delayed at all: the best one
    for number in range(1, 60):
        trips.add(999.0 + number, float(number), 999.2 + number)
    before = trips.to_host(60.0)
    trips.add(999.0 + 60, 60.0, 999.2 + 60)
    after = trips.to_host(60.0)
    assert before is not None
    assert after == pytest.approx(1059.0)
    assert before > 1059.3
