"""Batches that waited on the way are as old as they are, though the clocks of both sides have nothing in common."""

from __future__ import annotations

from typing import TYPE_CHECKING

import pytest

from beamtouch_service.samples import Batch, Quality, Sample
from beamtouch_service.surfaces.transit import MAX_DRIFT, WINDOW_S, Transit

if TYPE_CHECKING:
    from service.conftest import Bench, MakeBatch

BOOT_ID = "aaaaaaaa-1"


def sent_at(sent_s: float | None, boot_id: str = BOOT_ID) -> Batch:
    sample = Sample(sequence=1, acquired_unix_us=0, deflection_mm=[0.0], quality=[Quality.GOOD])
    sent_us = None if sent_s is None else round(sent_s * 1e6)
    return Batch(boot_id=boot_id, channels=["a"], newest_age_ms=1.0, samples=[sample], sent_us=sent_us)


def waited_s(transit: Transit, sent_s: float | None, received_s: float, boot_id: str = BOOT_ID) -> float:
    return transit.waited_s(sent_at(sent_s, boot_id), received_s)


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


def test_what_a_wire_held_for_a_minute_is_never_a_contact(bench: Bench, make_batch: MakeBatch) -> None:
    for sequence in range(1, 4):
        bench.now_s += 1.0
        assert bench.post({**make_batch(sequence=sequence), "sent_us": 1_000_000 * sequence}).status_code == 200
    bench.now_s += 65.0
    # Sent when the wire was pulled out. The kernel delivers it once the wire is back.
    assert bench.post({**make_batch(sequence=4), "sent_us": 4_000_000}).status_code == 200
    assert_stale(bench)
    assert bench.post({**make_batch(sequence=5), "sent_us": 68_000_000}).status_code == 200
    assert bench.get("/contact").json()["sequence"] == 5


def assert_stale(bench: Bench) -> None:
    refused = bench.get("/contact")
    assert refused.status_code == 503
    assert refused.json()["type"] == "urn:beamtouch:problem:stale"
