"""Batches that waited on the way are as old as they are, though the clocks of both sides have nothing in common."""

from __future__ import annotations

from typing import TYPE_CHECKING

import pytest

from beamtouch_service.host import models
from beamtouch_service.sections import SurfaceSection
from beamtouch_service.surfaces.surface import Surface
from service.conftest import Bench, batch_of, kind

if TYPE_CHECKING:
    from service.conftest import BuildModel

WINDOW_S = 30.0
"""Of the quickest batch: it counts for one to two of these."""
OTHER = "boot-other"


class Senders:
    """Send samples with the time of clocks that began at another time than that of the service."""

    def __init__(self, bench: Bench) -> None:
        self.bench = bench
        self._number = 0

    def waited_s(self, apart_s: float | None, boot_id: str = "boot-0001") -> float:
        """Send a sample of this moment, by a clock that is so far from that of the service; returns its age."""
        self._number += 1
        sent_us = None if apart_s is None else round((self.bench.now_s + 1e7 - apart_s) * 1e6)
        batch = batch_of(sequence=self._number, boot_id=boot_id) | {"sent_us": sent_us}
        assert self.bench.post(batch).status_code == 200
        contact = self.bench.get("/contact").json()
        assert contact["sequence"] == self._number
        age_ms: float = contact["age_ms"]
        return age_ms / 1e3


@pytest.fixture
def senders(model_bench: Bench) -> Senders:
    return Senders(model_bench)


@pytest.fixture
def model_bench(build_model: BuildModel) -> Bench:
    """A surface that gives a contact of any age that occurs here."""
    return Bench(Surface("press-7", models.load(build_model()), SurfaceSection(stale_ms=60_000)))


@pytest.mark.parametrize("apart_s", [-1e6, 0.0, 1e6])
def test_what_waited_is_seen_beside_the_quickest_whatever_the_clocks_say(senders: Senders, apart_s: float) -> None:
    waited_s = [senders.waited_s(apart_s + way_s) for way_s in (0.004, 0.002, 0.352, 0.003)]
    assert waited_s == pytest.approx([0.0, 0.0, 0.35, 0.001], abs=1e-3)


def test_another_start_of_the_sender_has_another_clock(senders: Senders) -> None:
    senders.waited_s(500.0)
    senders.bench.now_s += 1
    assert senders.waited_s(1000.0, OTHER) == 0.0
    senders.bench.now_s += 1
    assert senders.waited_s(1000.5, OTHER) == pytest.approx(0.5)


def test_clocks_that_drift_apart_are_met_anew(senders: Senders) -> None:
    drift, begin_s, waited_s = 100e-6, senders.bench.now_s, 0.0  # of the worst oscillators
    while senders.bench.now_s < begin_s + 20 * WINDOW_S:
        senders.bench.now_s += 2.0
        waited_s = max(waited_s, senders.waited_s((senders.bench.now_s - begin_s) * drift))
    assert 0 < waited_s <= 2.1 * WINDOW_S * drift
    # After a rest of an hour they may be that far apart.
    senders.bench.now_s += 3600
    assert senders.waited_s((senders.bench.now_s - begin_s) * drift) == 0.0


def test_a_clock_that_lost_time_counts_as_a_wait_for_a_minute_only(senders: Senders) -> None:
    senders.waited_s(0.0)
    waited_s = []
    for _ in range(100):
        senders.bench.now_s += 1
        waited_s.append(senders.waited_s(7.0))
    lasted = sum(one > 0 for one in waited_s)
    assert WINDOW_S <= lasted <= 2 * WINDOW_S + 2
    assert waited_s == [pytest.approx(7.0, abs=0.01)] * lasted + [0.0] * (100 - lasted)
    seldom_s = []  # as of a slow sender
    for _ in range(2):
        senders.bench.now_s += 1000
        seldom_s.append(senders.waited_s(14.0))
    assert seldom_s == [pytest.approx(7.0, abs=1.0), 0.0]


def test_senders_that_take_turns_are_known_both(senders: Senders) -> None:
    for _ in range(5):
        senders.bench.now_s += 61  # each may come back once the sample of the other is stale
        assert senders.waited_s(500.0) == 0.0
        senders.bench.now_s += 61
        assert senders.waited_s(90.0, OTHER) == 0.0
    senders.bench.now_s += 61
    assert senders.waited_s(500.4) == pytest.approx(0.4, abs=0.03)
    senders.bench.now_s += 61
    assert senders.waited_s(90.5, OTHER) == pytest.approx(0.5, abs=0.03)


def test_a_sender_that_does_not_say_when_changes_nothing(senders: Senders) -> None:
    assert senders.waited_s(None) == 0.0
    senders.waited_s(1000.0)
    assert senders.waited_s(None) == 0.0
    assert senders.waited_s(1000.2) == pytest.approx(0.2)


def tick(bench: Bench, for_s: float) -> None:
    """Let the process run for so long, and tick as it does."""
    for _ in range(round(for_s / 0.05)):
        bench.now_s += 0.05
        bench.app.context.ticks.tick(bench.now_s)


def test_what_a_running_process_reads_has_just_arrived(senders: Senders) -> None:
    tick(senders.bench, 2.0)
    senders.bench.now_s += 0.04
    assert senders.waited_s(None) == 0.0


def test_what_is_read_after_a_pause_may_have_arrived_since_the_last_tick(senders: Senders) -> None:
    bench = senders.bench
    tick(bench, 1.0)
    paused_s = bench.now_s
    # It is noticed at once, before the first tick and after it.
    bench.now_s = paused_s + 4.0
    assert senders.waited_s(None) == pytest.approx(4.0)
    bench.app.context.ticks.tick(bench.now_s)
    bench.now_s = paused_s + 4.1
    assert senders.waited_s(None) == pytest.approx(4.1)
    # A second one, before all that waited during the first one is read.
    bench.now_s = paused_s + 4.3
    bench.app.context.ticks.tick(bench.now_s)
    tick(bench, 0.45)
    assert senders.waited_s(None) == pytest.approx(4.75)
    tick(bench, 0.15)
    assert senders.waited_s(None) == 0.0


def test_after_a_pause_a_sender_that_is_known_is_as_old_as_it_says(senders: Senders) -> None:
    tick(senders.bench, 1.0)
    assert senders.waited_s(500.0) == 0.0
    senders.bench.now_s += 5.0
    assert senders.waited_s(500.5) == pytest.approx(0.5)


def test_after_a_pause_a_new_sender_is_as_old_as_the_pause(senders: Senders) -> None:
    bench = senders.bench
    tick(bench, 1.0)
    assert senders.waited_s(500.0) == 0.0
    bench.now_s += 5.0
    assert senders.waited_s(90.0, OTHER) == pytest.approx(5.0)
    bench.now_s += 0.1
    assert senders.waited_s(90.5, OTHER) == pytest.approx(5.1)
    # Neither counts as the quickest of its sender.
    bench.app.context.ticks.tick(bench.now_s)
    tick(bench, 1.0)
    assert senders.waited_s(92.0, OTHER) == 0.0
    assert senders.waited_s(92.5, OTHER) == pytest.approx(0.5)


def test_a_contact_is_stale_by_the_time_on_its_way(bench: Bench) -> None:
    assert bench.post(batch_of(sequence=1, age_ms=1.0) | {"sent_us": 5_000_000}).status_code == 200
    bench.now_s += 1.0
    assert bench.post(batch_of(sequence=2, age_ms=1.0) | {"sent_us": 5_700_000}).status_code == 200
    assert bench.get("/contact").json()["age_ms"] == pytest.approx(301.0, abs=0.1)
    bench.now_s += 0.2
    assert kind(bench.get("/contact")) == "stale"
