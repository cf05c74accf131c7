"""When a batch counts as arrived, and its samples as taken: at the bounds of pauses, windows and ages."""

from math import inf, nextafter

from beamtouch_service.samples import Batch, Sample
from beamtouch_service.surfaces.freshness import Moment, SampleClock, StallDetector, Transit
from beamtouch_service.surfaces.order import MAX_SENDERS

PAUSE_S, CATCH_UP_S = 0.1, 0.5


def ticked(*times_s: float) -> StallDetector:
    ticks = StallDetector()
    for now_s in times_s:
        ticks.tick(now_s)
    return ticks


def test_nothing_waits_while_the_process_ticks() -> None:
    assert StallDetector().earliest_s(9.0) == 9.0
    assert ticked(0.0).earliest_s(PAUSE_S) == PAUSE_S
    assert ticked(0.0, PAUSE_S).earliest_s(0.15) == 0.15


def test_after_a_pause_what_is_read_may_have_arrived_since_the_last_tick_for_half_a_second() -> None:
    late_s = nextafter(PAUSE_S, inf)
    assert ticked(0.0).earliest_s(late_s) == 0.0
    ticks = ticked(0.0, 4.0)
    assert [ticks.earliest_s(now_s) for now_s in (4.0, 4.0 + CATCH_UP_S)] == [0.0, 0.0]
    # A second pause, before what had waited during the first one is read.
    assert ticked(0.0, 4.0, 4.5, 4.75).earliest_s(5.25) == 0.0
    assert ticked(0.0, 4.0, 4.5, 5.25).earliest_s(5.5) == 0.0
    sixteenths = [4.0 + number / 16 for number in range(11)]
    assert ticked(0.0, *sixteenths, 5.25).earliest_s(5.5) == 4.625


def batch_of(boot_id: str, sent_s: float | None, *, backlog: bool = False) -> Batch:
    members = {"boot_id": boot_id, "channels": ["s1"], "samples": [], "backlog": backlog}
    sent_us = None if sent_s is None else round(sent_s * 1e6)
    return Batch.model_validate(members | {"newest_age_ms": None if backlog else 0.0, "sent_us": sent_us})


def test_a_batch_that_does_not_say_when_it_was_sent_arrived_when_it_may_have_been_there() -> None:
    transit = Transit()
    assert transit.arrival_s(batch_of("boot-0001", None), 10.0, 9.0) == 9.0
    assert transit.arrival_s(batch_of("boot-0001", None), 10.0, 10.0) == 10.0
    assert transit.arrival_s(batch_of("boot-0001", None, backlog=True), 10.0, 9.0) == 9.0


def test_a_sender_that_is_not_known_yet_is_learnt_from_a_batch_that_did_not_wait() -> None:
    transit = Transit()
    assert transit.arrival_s(batch_of("boot-0001", 3.0), 10.0, 9.0) == 9.0
    assert transit.arrival_s(batch_of("boot-0001", 4.0), 10.0, 10.0) == 10.0
    assert transit.arrival_s(batch_of("boot-0001", 4.0), 11.0, 10.5) == 10.0


def test_the_ways_of_sixteen_senders_are_known() -> None:
    transit = Transit()
    for number in range(MAX_SENDERS):
        transit.arrival_s(batch_of(f"boot-{number:04}", 4.0), 10.0, 10.0)
    assert transit.arrival_s(batch_of("boot-0000", 4.0), 11.0, 11.0) == 10.0
    transit.arrival_s(batch_of("boot-last", 4.0), 10.0, 10.0)
    # The one that was heard last is known still, and of the first of the others nothing.
    assert transit.arrival_s(batch_of("boot-0000", 4.0), 12.0, 12.0) == 10.0
    assert transit.arrival_s(batch_of("boot-0001", 4.0), 12.0, 12.0) == 12.0


def test_the_quickest_way_is_that_of_two_windows_and_drifts_between_them() -> None:
    transit = Transit()

    def waited_s(read_s: float, way_s: float) -> float:
        sent = batch_of("boot-0001", read_s - way_s)
        return round(read_s - transit.arrival_s(sent, read_s, read_s), 6)

    assert waited_s(100.0, 0.0) == 0.0
    assert waited_s(130.0, 0.5) == 0.5  # the window is not over
    assert waited_s(132.0, 0.5) == 0.5 - 400e-6
    assert waited_s(162.0, 0.5) == 0.5 - 400e-6
    assert waited_s(163.0, 0.5) == 0.0


def samples_at(*times_us: int) -> list[Sample]:
    return [
        Sample.model_validate({"sequence": number, "acquired_unix_us": us, "deflection_mm": [0.5], "quality": ["good"]})
        for number, us in enumerate(times_us, 1)
    ]


def test_samples_were_taken_before_the_newest_one_by_what_the_clock_of_the_sender_says() -> None:
    clock = SampleClock(max_pause_s=0.5)
    assert clock.tell(samples_at(0, 250_000, 500_000), 100.0) == [
        Moment(99.5, 0.5),  # nothing is known of longer
        Moment(99.75, 0.25),
        Moment(100.0, 0.25),
    ]
    # A batch that travelled more quickly: no time counts twice. And a clock that was set back.
    assert clock.tell(samples_at(0, 250_000), 100.125) == [Moment(100.0, 0.0), Moment(100.125, 0.125)]
    assert clock.tell(samples_at(9_000_000, 0), 100.25) == [Moment(100.25, 0.125), Moment(100.25, 0.0)]
