"""Batches that waited on the way are as old as they are, though the clocks of both sides have nothing in common."""

from __future__ import annotations

from typing import TYPE_CHECKING

import pytest

from beamtouch_service.samples import Batch, Quality, Sample
from beamtouch_service.surfaces.freshness import CATCH_UP_S, MAX_DRIFT, PAUSE_S, TICK_S, WINDOW_S, Ticks, Transit

if TYPE_CHECKING:
    from service.conftest import Bench, MakeBatch

BOOT_ID = "aaaaaaaa-1"


def sent_at(sent_s: float | None, boot_id: str = BOOT_ID) -> Batch:
    sample = Sample(sequence=1, acquired_unix_us=0, deflection_mm=[0.0], quality=[Quality.GOOD])
    sent_us = None if sent_s is None else round(sent_s * 1e6)
    return Batch(boot_id=boot_id, channels=["a"], newest_age_ms=1.0, samples=[sample], sent_us=sent_us)


def waited_s(transit: Transit, sent_s: float | None, received_s: float, boot_id: str = BOOT_ID) -> float:
    return received_s - transit.arrival_s(sent_at(sent_s, boot_id), received_s, received_s)


@pytest.mark.parametrize("apart_s", [-1e6, 0.0, 1e6])
def test_what_waited_is_seen_beside_the_quickest_whatever_the_clocks_say(apart_s: float) -> None:
    transit, sent_s = Transit(), 2e6
    seen = [waited_s(transit, sent_s + at, sent_s + apart_s + at + way) for at, way in enumerate((0.004, 0.002, 0.352))]
    assert seen == pytest.approx([0.0, 0.0, 0.35], abs=1e-6)
    assert waited_s(transit, sent_s + 5, sent_s + apart_s + 5.003) == pytest.approx(0.001, abs=1e-6)


def test_another_start_of_the_sender_has_another_clock() -> None:
    transit = Transit()
    waited_s(transit, 500.0, 1000.0)
    assert waited_s(transit, 1.0, 1001.0, "bbbbbbbb-2") == 0.0
    assert waited_s(transit, 2.0, 1002.5, "bbbbbbbb-2") == pytest.approx(0.5)


def test_clocks_that_drift_apart_are_met_anew() -> None:
    transit, received_s, waited = Transit(), 0.0, 0.0
    drift = 100e-6  # of the worst oscillators
    while received_s < 20 * WINDOW_S:
        received_s += 0.1
        waited = max(waited, waited_s(transit, received_s * (1 - drift), received_s))
    assert 0 < waited <= 2.1 * WINDOW_S * drift
    # After a rest of an hour they may be that far apart.
    later_s = received_s + 3600
    assert waited_s(transit, later_s * (1 - drift), later_s) == 0.0


@pytest.mark.parametrize("outage_s", [1.0, 29.0, 31.0, 59.0, 61.0, 3600.0])
def test_a_batch_that_was_held_during_an_outage_is_as_old_as_that(outage_s: float) -> None:
    transit, received_s = Transit(), 5000.0
    while received_s < 5000 + 2.5 * WINDOW_S:
        received_s += 0.5
        assert waited_s(transit, received_s - 4000, received_s) == 0.0
    held_s = waited_s(transit, received_s - 4000, received_s + outage_s)
    assert held_s == pytest.approx(outage_s, rel=MAX_DRIFT)
    assert waited_s(transit, received_s - 4000 + outage_s, received_s + outage_s) == 0.0


def test_a_clock_that_lost_time_counts_as_a_wait_for_a_minute_only() -> None:
    transit, lost_s = Transit(), 7.0
    waited_s(transit, 1000.0, 1000.0)
    lasted = [at_s for at_s in range(100) if waited_s(transit, 1001.0 + at_s - lost_s, 1001.0 + at_s) > 0]
    assert lasted == list(range(len(lasted)))
    assert len(lasted) <= 2 * WINDOW_S + 2
    seldom = [waited_s(transit, at_s - 2 * lost_s, at_s) for at_s in (5000.0, 6000.0)]  # as of a slow sender
    assert seldom == [pytest.approx(lost_s, abs=1.0), 0.0]


def test_senders_that_take_turns_are_known_both() -> None:
    transit, other = Transit(), "bbbbbbbb-2"
    for at_s in range(5):
        assert waited_s(transit, 500.0 + at_s, 1000.0 + at_s) == 0.0
        assert waited_s(transit, 90.0 + at_s, 1000.5 + at_s, other) == 0.0
    assert waited_s(transit, 505.0, 1005.4) == pytest.approx(0.4)
    assert waited_s(transit, 95.0, 1006.0, other) == pytest.approx(0.5)


def test_a_sender_that_does_not_say_when_changes_nothing() -> None:
    transit = Transit()
    assert waited_s(transit, None, 1000.0) == 0.0
    waited_s(transit, 0.0, 1001.0)
    assert waited_s(transit, None, 1009.0) == 0.0
    assert waited_s(transit, 1.0, 1002.2) == pytest.approx(0.2)


def test_a_contact_is_as_old_as_its_way_was_long(bench: Bench, make_batch: MakeBatch) -> None:
    # Sent by a clock that began much later than that of the service.
    assert bench.post({**make_batch(sequence=1), "newest_age_ms": 1.0, "sent_us": 5_000_000}).status_code == 200
    bench.now_s += 1.0
    assert bench.post({**make_batch(sequence=2), "newest_age_ms": 1.0, "sent_us": 5_700_000}).status_code == 200
    assert bench.get("/contact").json()["age_ms"] == pytest.approx(301.0, abs=0.1)
    bench.now_s += 0.2
    assert_stale(bench)


def assert_stale(bench: Bench) -> None:
    refused = bench.get("/contact")
    assert refused.status_code == 503
    assert refused.json()["type"] == "urn:beamtouch:problem:stale"


def ticked(ticks: Ticks, now_s: float, for_s: float) -> float:
    """Let a process run for so long; returns the time."""
    for _ in range(round(for_s / TICK_S)):
        now_s += TICK_S
        ticks.tick(now_s)
    return now_s


def test_what_a_running_process_reads_has_just_arrived() -> None:
    ticks = Ticks()
    assert ticks.earliest_s(7.0) == 7.0
    now_s = ticked(ticks, 1000.0, 2.0)
    assert ticks.earliest_s(now_s + PAUSE_S / 2) == now_s + PAUSE_S / 2


def test_what_is_read_after_a_pause_may_have_arrived_since_the_last_tick() -> None:
    ticks = Ticks()
    paused_s = ticked(ticks, 1000.0, 1.0)
    # It is noticed at once, before the first tick and after it.
    assert ticks.earliest_s(paused_s + 4.0) == paused_s
    ticks.tick(paused_s + 4.0)
    assert ticks.earliest_s(paused_s + 4.1) == paused_s
    # A second one, before all that waited during the first one is read.
    ticks.tick(paused_s + 4.3)
    now_s = ticked(ticks, paused_s + 4.3, CATCH_UP_S)
    assert ticks.earliest_s(now_s - 0.01) == paused_s
    now_s = ticked(ticks, now_s, 2 * TICK_S)
    assert ticks.earliest_s(now_s) == now_s


def test_after_a_pause_a_sender_that_is_known_is_as_old_as_it_says_and_a_new_one_as_old_as_the_pause() -> None:
    transit = Transit()
    assert waited_s(transit, 500.0, 1000.0) == 0.0
    assert transit.arrival_s(sent_at(504.5), 1005.0, 1000.0) == pytest.approx(1004.5)
    new = "bbbbbbbb-2"
    assert transit.arrival_s(sent_at(90.0, new), 1005.0, 1000.0) == 1000.0
    # It does not count as the quickest of its sender.
    assert transit.arrival_s(sent_at(90.5, new), 1005.1, 1000.0) == 1000.0
    assert waited_s(transit, 95.0, 1006.0, new) == 0.0
    assert waited_s(transit, 96.0, 1007.5, new) == pytest.approx(0.5)
    assert transit.arrival_s(sent_at(None), 1005.0, 1000.0) == 1000.0
