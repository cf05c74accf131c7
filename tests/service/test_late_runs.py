"""Late runs of samples that ring, move or are weak are decided as if they had come in order."""

from __future__ import annotations

import random
from itertools import pairwise
from typing import TYPE_CHECKING, Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from beamtouch_models import modelfile
from beamtouch_service.surfaces.surface import Surface
from service.event_story import HARDER, RESTING, START_US, TOUCHING, settle

if TYPE_CHECKING:
    from service.conftest import Bench, BuildModel, MakeBatch

    Sample = tuple[list[float | None], list[float] | None]

WEAK: list[float | None] = [0.1, 0.05, 0.025]
LITTLE, MUCH = ([s, 0.0, s, 0.0, 0.0, s] for s in (2e-4, 1.0))
"""Covariances of samples that move [mm^2]: such that shows the contacts below, and such that shows nothing."""
REST: Sample = (RESTING, None)
TOUCH: Sample = (TOUCHING, None)
LIFT: Sample = (RESTING, LITTLE)
RING: Sample = (WEAK, LITTLE)
HIDDEN: Sample = (RESTING, MUCH)
KINDS: list[Sample] = [
    REST, TOUCH, LIFT, RING, HIDDEN, (TOUCHING, LITTLE), (HARDER, MUCH), (WEAK, None), ([0.05, 0.0, 0.0], None),
    ([0.05, 0.0, 0.0], LITTLE), ([None, None, None], None),
]  # fmt: skip


class Line:
    """Samples 5 ms apart, delivered to a service in any parts and order."""

    def __init__(self, bench: Bench, make_batch: MakeBatch, samples: list[Sample]) -> None:
        self.bench, self.make_batch, self.samples, self.newest = bench, make_batch, samples, -1

    def deliver(self, first: int, last: int) -> None:
        """Send the samples from `first` up to, but not including, `last`; those before the newest are stated as old."""
        part = self.samples[first:last]
        body = self.make_batch(
            *(row for row, _ in part), sequence=first, age_ms=0.0 if last > self.newest else 60_000.0
        )
        for offset, (sample, (row, covariance_mm2)) in enumerate(zip(body["samples"], part, strict=True)):
            sample["acquired_unix_us"] = START_US + (first + offset) * 5000
            sample["quality"] = ["missing" if value is None else "good" for value in row]
            sample["readings"] = 1
            if covariance_mm2:
                sample["covariance_mm2"] = covariance_mm2
        self.newest = max(self.newest, last)
        self.bench.now_s += 0.001
        assert self.bench.post(body).status_code == 200

    @property
    def events(self) -> list[dict[str, Any]]:
        """All events, oldest first, without what depends on the order of delivery."""
        settle(self.bench)
        events = self.bench.get("/events?path=true&limit=50").json()["events"]
        return [{name: event[name] for name in event if name not in ("id", "model")} for event in reversed(events)]

    @property
    def told(self) -> list[tuple[str, str, float]]:
        """Begin, end and dwell of each event."""
        return [(event["begin"], event["end"], event["dwell_ms"]) for event in self.events]


def test_late_ringing_after_a_lift_is_no_second_contact(bench: Bench, make_batch: MakeBatch) -> None:
    samples = [*[REST] * 6, *[TOUCH] * 10, REST, *[RING] * 2, *[REST, RING] * 4, *[REST] * 8]
    line = Line(bench, make_batch, samples)
    line.deliver(0, 17)
    line.deliver(27, 35)
    line.deliver(17, 27)

    assert line.told == [("touch", "lift", 50.0)]


def test_late_samples_with_a_large_covariance_cut_no_contact(bench: Bench, make_batch: MakeBatch) -> None:
    line = Line(bench, make_batch, [*[REST] * 6, *[TOUCH] * 10, *[HIDDEN] * 10, *[TOUCH] * 10, *[REST] * 6])
    line.deliver(0, 16)
    line.deliver(26, 42)
    line.deliver(16, 26)

    assert line.told == [("touch", "lift", 150.0)]


def test_a_moving_contact_after_a_gap_is_neither_lifted_nor_touched(bench: Bench, make_batch: MakeBatch) -> None:
    samples = [*[REST] * 6, *[TOUCH] * 10, *[HIDDEN] * 50, *[TOUCH] * 4, *[REST] * 6]
    line = Line(bench, make_batch, samples)
    line.deliver(0, 16)
    line.deliver(18, 76)
    assert line.told == [("touch", "unseen", 45.0), ("unseen", "lift", 20.0)]

    line.deliver(16, 18)
    assert line.told == [("touch", "lift", 320.0)]


def test_the_rest_before_a_gap_is_not_the_rest_before_the_touch(bench: Bench, make_batch: MakeBatch) -> None:
    line = Line(bench, make_batch, [*[REST] * 6, *[TOUCH] * 10, *[REST] * 6])
    line.deliver(0, 4)
    line.deliver(8, 22)

    header, row = bench.get("/surfaces/press-7/calibration-data").text.splitlines()
    assert dict(zip(header.split(","), row.split(","), strict=True))["s1_rest_mm"] == ""


def test_doubtful_samples_are_decided_with_the_model_that_estimated_them(
    make_bench: type[Bench], build_model: BuildModel, make_batch: MakeBatch
) -> None:
    surface = Surface("press-7", modelfile.load(build_model(channels=4)))
    bench = make_bench(surface)
    weak, rest = [*WEAK, 0.0], [0.0] * 4
    assert bench.post(make_batch(weak, sequence=1)).status_code == 200
    surface.adopt(modelfile.load(build_model(name="other", channels=3)))
    assert bench.post(make_batch(rest, [*TOUCHING, 0.0], rest, sequence=2)).status_code == 200

    (event,) = bench.get("/events").json()["events"]
    assert (event["model"].partition("@")[0], event["begin"], event["end"]) == ("other", "touch", "lift")


_shared: dict[str, Any] = {}


@pytest.fixture(autouse=True)
def _share(make_bench: type[Bench], build_model: BuildModel, make_batch: MakeBatch) -> None:
    # Hypothesis runs a test many times with the same fixtures, and each run needs a new service.
    _shared.update(bench=make_bench, build=build_model, batch=make_batch)


def _record(samples: list[Sample], parts: list[tuple[int, int]], stale_ms: float) -> list[dict[str, Any]]:
    if "model" not in _shared:
        _shared["model"] = modelfile.load(_shared["build"]())
    line = Line(_shared["bench"](Surface("press-7", _shared["model"], stale_ms)), _shared["batch"], samples)
    for first, last in parts:
        line.deliver(first, last)
    return line.events


@settings(max_examples=60, deadline=None)
@given(rng=st.randoms(use_true_random=True), held=st.booleans())
def test_any_order_of_delivery_gives_the_same_events(rng: random.Random, *, held: bool) -> None:
    samples = [REST] * 6
    while len(samples) < 80:
        samples += [rng.choice(KINDS)] * rng.choice([1, 1, 2, 3, 6])
    samples += [REST] * 6
    parts = list(pairwise([0, *sorted(rng.sample(range(1, len(samples)), 12)), len(samples)]))
    # With or without a state that is held over the gaps.
    stale_ms = 500.0 if held else 4.0
    straight = _record(samples, parts, stale_ms)
    rng.shuffle(parts)

    assert _record(samples, parts, stale_ms) == straight
