"""Batches that waited on the way are as old as they are, though the clocks of both sides have nothing in common."""

from __future__ import annotations

from typing import TYPE_CHECKING

import pytest

from beamtouch_service.sections import SurfaceSection
from beamtouch_service.surfaces.freshness import SampleClock, StallDetector, Transit
from service.bench import Bench, parsed, surface_of

if TYPE_CHECKING:
    from beamtouch_service.samples import Batch

WINDOW_S = 30.0
"""Of the quickest batch: it counts for one to two of these."""
OTHER = "boot-other"


class Senders:
    """Send samples with the time of clocks that began at another time than that of the service."""

    def __init__(self, stale_ms: float) -> None:
        self.bench = Bench(surface_of(section=SurfaceSection(stale_ms=stale_ms)))
        self._number = 0

    def send(self, apart_s: float | None, boot_id: str = "boot-0001") -> None:
        """Send a sample of this moment, by a clock that is so far from that of the service."""
        self._number += 1
        sent_us = None if apart_s is None else round((self.bench.now_s + 1e7 - apart_s) * 1e6)
        self.bench.send(sequence=self._number, boot_id=boot_id, members={"sent_us": sent_us})

    def waited_s(self, apart_s: float | None, boot_id: str = "boot-0001") -> float:
        """Send such a sample; return its age."""
        self.send(apart_s, boot_id)
        contact = self.bench.contact()
        assert contact["sequence"] == self._number
        return float(contact["age_ms"]) / 1e3

    def tick(self, for_s: float) -> None:
        """Let the process run for so long, and tick as it does."""
        for _ in range(round(for_s / 0.05)):
            self.bench.now_s += 0.05
            self.bench.app.context.stalls.tick(self.bench.now_s)


@pytest.fixture
def senders() -> Senders:
    """To a surface that gives a contact of any age that occurs here."""
    return Senders(60_000)


@pytest.mark.promise("docs/reference/samples.md", "With it, the service notices a batch that was held up on its way.")
@pytest.mark.parametrize("apart_s", [-1e6, 0.0, 1e6])
def test_what_waited_is_seen_beside_the_quickest_whatever_the_clocks_say(senders: Senders, apart_s: float) -> None:
    waited_s = [senders.waited_s(apart_s + way_s) for way_s in (0.004, 0.002, 0.352, 0.003)]
    assert waited_s == pytest.approx([0.0, 0.0, 0.35, 0.001], abs=1e-3)
    # One that does not say when it sent changes nothing.
    assert senders.waited_s(None) == 0.0
    assert senders.waited_s(apart_s + 0.202) == pytest.approx(0.2, abs=1e-3)


@pytest.mark.parametrize("outage_s", [0.6, 5.0, 31.0, 600.0])
@pytest.mark.parametrize("before_s", [1, 70])
def test_a_batch_that_was_held_over_an_outage_is_no_contact(before_s: int, outage_s: float) -> None:
    senders = Senders(500)
    for _ in range(max(1, before_s // 5)):
        senders.bench.now_s += 5.0
        senders.send(0.0)
    senders.bench.now_s += outage_s
    senders.send(outage_s)
    assert senders.bench.problem() == "stale"
    # What is sent now is not held up any longer.
    assert senders.waited_s(0.0) <= 0.2


def test_clocks_that_drift_apart_are_met_anew(senders: Senders) -> None:
    drift, begin_s, waited_s = 100e-6, senders.bench.now_s, 0.0  # of the worst oscillators
    while senders.bench.now_s < begin_s + 10 * WINDOW_S:
        senders.bench.now_s += 6.0
        waited_s = max(waited_s, senders.waited_s((senders.bench.now_s - begin_s) * drift))
    assert 0 < waited_s <= 2.1 * WINDOW_S * drift
    # After a rest of an hour they may be that far apart.
    senders.bench.now_s += 3600
    assert senders.waited_s((senders.bench.now_s - begin_s) * drift) == 0.0


@pytest.mark.parametrize("quiet_s", [10.0, 600.0, 3600.0])
def test_of_a_wait_no_more_stays_unseen_than_clocks_may_have_drifted(senders: Senders, quiet_s: float) -> None:
    senders.waited_s(0.0)
    senders.bench.now_s += quiet_s
    assert 2.0 - 200e-6 * quiet_s - 1e-3 <= senders.waited_s(2.0) <= 2.0 + 1e-3


def test_a_clock_that_lost_time_counts_as_a_wait_for_a_minute_only(senders: Senders) -> None:
    senders.waited_s(0.0)
    waited_s = []
    for _ in range(70):
        senders.bench.now_s += 1
        waited_s.append(senders.waited_s(7.0))
    lasted = sum(one > 0 for one in waited_s)
    assert WINDOW_S <= lasted <= 2 * WINDOW_S + 2
    assert waited_s == [pytest.approx(7.0, abs=0.01)] * lasted + [0.0] * (70 - lasted)
    seldom_s = []  # as of a slow sender
    for _ in range(2):
        senders.bench.now_s += 1000
        seldom_s.append(senders.waited_s(14.0))
    assert seldom_s == [pytest.approx(7.0, abs=1.0), 0.0]


def test_senders_that_take_turns_are_known_both(senders: Senders) -> None:
    for apart_s, boot_id in [(500.0, "boot-0001"), (90.0, OTHER)] * 3:
        senders.bench.now_s += 61  # each may come back once the sample of the other is stale
        assert senders.waited_s(apart_s, boot_id) == 0.0
    for apart_s, boot_id, waited_s in [(500.4, "boot-0001", 0.4), (90.5, OTHER, 0.5)]:
        senders.bench.now_s += 61
        assert senders.waited_s(apart_s, boot_id) == pytest.approx(waited_s, abs=0.03)


def test_what_is_read_after_a_pause_may_have_arrived_since_the_last_tick(senders: Senders) -> None:
    senders.tick(1.0)
    senders.bench.now_s += 0.04
    assert senders.waited_s(None) == 0.0  # the process runs
    senders.tick(0.05)
    paused_s = senders.bench.now_s
    # It is noticed at once, before the first tick and after it.
    senders.bench.now_s = paused_s + 4.0
    assert senders.waited_s(None) == pytest.approx(4.0)
    senders.tick(0.05)
    senders.bench.now_s = paused_s + 4.1
    assert senders.waited_s(None) == pytest.approx(4.1)
    # A second one, before all that waited during the first one is read.
    senders.bench.now_s = paused_s + 4.25
    senders.tick(0.5)
    assert senders.waited_s(None) == pytest.approx(4.75)
    senders.tick(0.15)
    assert senders.waited_s(None) == 0.0


def test_after_a_pause_a_known_sender_is_as_old_as_it_says_and_a_new_one_as_the_pause() -> None:
    for boot_id, apart_s, waited_s in (("boot-0001", 500.5, 0.5), (OTHER, 90.0, 5.0)):
        senders = Senders(60_000)
        senders.tick(1.0)
        assert senders.waited_s(500.0) == 0.0
        senders.bench.now_s += 5.0
        assert senders.waited_s(apart_s, boot_id) == pytest.approx(waited_s)
    senders.bench.now_s += 0.1
    assert senders.waited_s(90.5, OTHER) == pytest.approx(5.1)
    # Neither counts as the quickest of its sender.
    senders.tick(1.0)
    assert senders.waited_s(92.0, OTHER) == 0.0
    assert senders.waited_s(92.5, OTHER) == pytest.approx(0.5)


def stalls_after(*ticks_s: float) -> StallDetector:
    stalls = StallDetector()
    for tick_s in ticks_s:
        stalls.tick(tick_s)
    return stalls


def test_what_is_read_within_a_tenth_of_a_second_of_a_tick_has_not_waited() -> None:
    assert StallDetector().earliest_s(5.0) == 5.0
    assert stalls_after(-7.0).earliest_s(-7.0) == -7.0, "a clock may begin anywhere"
    stalls = stalls_after(0.0)
    assert [stalls.earliest_s(read_s) for read_s in (0.0, 0.1, 0.1001, 7.0)] == [0.0, 0.1, 0.0, 0.0]
    assert stalls_after(0.0, 0.1).earliest_s(0.15) == 0.15


def test_half_a_second_after_a_pause_what_had_waited_is_still_being_read() -> None:
    stalls = stalls_after(0.0, 0.125)
    assert [stalls.earliest_s(read_s) for read_s in (0.125, 0.2, 0.625, 0.626)] == [0.0, 0.0, 0.0, 0.125]
    on_time = [0.125 + 0.0625 * tick for tick in range(11)]
    assert stalls_after(0.0, *on_time).earliest_s(0.75) == 0.75
    # A pause that begins before that, or just then, is one with the pause before it.
    assert stalls_after(0.0, 0.125, 0.5).earliest_s(1.0) == 0.0
    assert stalls_after(0.0, *on_time[:9], 1.0).earliest_s(1.5) == 0.0
    assert stalls_after(0.0, *on_time[:10], 1.0).earliest_s(1.5) == 0.6875


def sent(apart_s: float, read_s: float, boot_id: str = "boot-0001") -> Batch:
    """Return a batch that was sent when it was read, by a clock so far behind."""
    return parsed(boot_id=boot_id).model_copy(update={"sent_us": round((read_s - apart_s) * 1e6)})


def test_a_batch_has_waited_for_as_long_as_the_quickest_of_this_window_and_the_one_before_did_not() -> None:
    transit = Transit()

    def waited_s(apart_s: float, read_s: float) -> float:
        return read_s - transit.arrival_s(sent(apart_s, read_s), read_s, read_s)

    assert [waited_s(60.0, 100.0), waited_s(62.0, 110.0), waited_s(59.0, 120.0)] == [0.0, 2.0, 0.0]
    assert waited_s(62.0, 130.0) == 3.0  # the window ends
    # Two clocks drift apart by 200 us each second.
    assert waited_s(64.0, 140.0) == pytest.approx(64.0 - (59.0 + 200e-6 * 10.0), abs=1e-6)
    assert waited_s(61.0, 170.0) == pytest.approx(61.0 - 59.002, abs=1e-6)
    assert waited_s(63.0, 175.0) == pytest.approx(63.0 - (61.0 + 200e-6 * 5.0), abs=1e-6)


def test_a_batch_of_an_unknown_path_counts_from_the_earliest_time_and_is_not_the_quickest() -> None:
    transit = Transit()
    assert transit.arrival_s(parsed(), 100.0, 97.0) == 97.0  # it does not say when it was sent
    assert transit.arrival_s(sent(60.0, 100.0).model_copy(update={"backlog": True}), 100.0, 97.0) == 97.0
    assert transit.arrival_s(sent(60.0, 100.0), 100.0, 97.0) == 97.0
    assert transit.arrival_s(sent(66.0, 101.0), 101.0, 101.0) == 101.0
    # From then on, the batches themselves say it.
    assert transit.arrival_s(sent(68.5, 102.0), 102.0, 90.0) == 99.5


def test_the_paths_of_the_last_sixteen_senders_are_known() -> None:
    transit = Transit()

    def waited_s(number: int, apart_s: float) -> float:
        return 100.0 - transit.arrival_s(sent(apart_s, 100.0, f"boot-{number:04}"), 100.0, 100.0)

    assert [waited_s(number, 60.0) for number in (*range(16), 0, 16)] == [0.0] * 18
    # The first was heard of late; of the second nothing is known any more, so that it is the quickest again.
    assert [waited_s(number, 63.0) for number in (0, 2, 16, 1)] == [3.0, 3.0, 3.0, 0.0]


def test_samples_are_as_old_as_the_newest_one_and_what_is_before_it_and_no_time_counts_twice() -> None:
    clock = SampleClock(0.5)

    def tell(acquired_s: float, *at_us: int) -> list[tuple[float, float]]:
        samples = [parsed().samples[0].model_copy(update={"acquired_unix_us": one}) for one in at_us]
        return [(one.taken_s, one.passed_s) for one in clock.tell(samples, acquired_s)]

    assert tell(100.0, 7_000_000, 7_250_000, 8_000_000) == [(99.0, 0.5), (99.25, 0.25), (100.0, 0.5)]
    # One of a clock that was set back is no newer than the newest; and this batch was quicker than the one before.
    assert tell(100.125, 6_750_000, 9_000_000, 7_000_000) == [(100.0, 0.0), (100.125, 0.125), (100.125, 0.0)]
    assert tell(100.375, 7_250_000) == [(100.375, 0.25)]


@pytest.mark.parametrize(("after_s", "samples"), [(1.9995, 5), (2.0005, 6)])
def test_of_a_pause_no_more_than_the_limit_of_age_counts(after_s: float, samples: int) -> None:
    """Of a channel whose samples are a minute apart, half a second each; the first only begins."""
    section = SurfaceSection(stale_ms=500, degraded_after_s=after_s)
    surface, quality = surface_of(section=section, channels=4), ["good", "good", "missing", "good"]
    found = []
    for number in range(1, 7):
        surface.receive(parsed([0.0, 0.0, None, 0.0], sequence=number, quality=quality), 1000.0 + 60.0 * number)
        found.append(surface.channels_out.any)
    assert found.index(True) + 1 == samples
