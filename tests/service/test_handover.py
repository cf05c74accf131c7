"""Two services that take turns with the samples of one sender: their record is that of a single service."""

from __future__ import annotations

import random
from itertools import pairwise
from typing import TYPE_CHECKING, Any
from uuid import uuid4

import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

from beamtouch_models import modelfile
from beamtouch_service.events.recorder import Recorder
from beamtouch_service.surfaces.surface import Surface
from service.event_story import BETWEEN, HARDER, ODD, RESTING, TOUCHING, Row, Story

if TYPE_CHECKING:
    from collections.abc import Iterator

    from service.conftest import Bench, BuildModel, MakeBatch

STALE_S = 10.0
KINDS: list[Row] = [TOUCHING, HARDER, RESTING, BETWEEN]
"""Without odd samples: how long a stretch lasts may differ by a few samples after any gap."""


class Shared:
    """Services of one surface, some of which share a database."""

    def __init__(self, model: modelfile.ModelFile, url: str, make_bench: type[Bench], make_batch: MakeBatch) -> None:
        self._model, self._url, self._make_bench, self._make_batch = model, url, make_bench, make_batch
        self._recorders: list[Recorder] = []

    def story(self, rows: list[Row], *, alone: bool = False) -> Story:
        """Return a service that has started now, and the samples to deliver."""
        recorder = Recorder(None if alone else self._url)
        self._recorders.append(recorder)
        return Story(self._make_bench(Surface("press-7", self._model), recorder=recorder), self._make_batch, rows)

    def close(self) -> None:
        for recorder in self._recorders:
            recorder.close()
        self._recorders.clear()


@pytest.fixture
def shared(
    events_url: str, build_model: BuildModel, make_bench: type[Bench], make_batch: MakeBatch
) -> Iterator[Shared]:
    shared = Shared(modelfile.load(build_model()), events_url, make_bench, make_batch)
    yield shared
    shared.close()


def rest(story: Story) -> None:
    """Let a service have no new samples until its surface is stale, and do what it does each second."""
    story.bench.now_s += STALE_S
    recorder = story.bench.app.context.recorder
    for _ in range(3):
        story.bench.get("/events")
        recorder.maintain()
        recorder.ask(lambda _: None).result()


def told(story: Story, boot_id: str) -> list[dict[str, Any]]:
    """Return the events of a sender, with means that rounding does not change."""
    found = [event for event in story.events if event["boot_id"] == boot_id]
    for event in found:
        event["mean_position_mm"] = event["mean_position_mm"] and pytest.approx(event["mean_position_mm"])
    return found


@pytest.mark.parametrize("cut", range(1, 12))
def test_a_contact_is_one_event_wherever_another_service_takes_over(shared: Shared, cut: int) -> None:
    rows = [RESTING, RESTING, TOUCHING, HARDER, BETWEEN, TOUCHING, ODD, TOUCHING, RESTING, RESTING, TOUCHING, RESTING]
    single, one, other = shared.story(rows, alone=True), shared.story(rows), shared.story(rows)
    single.deliver(0, cut)
    single.deliver(cut, len(rows))
    one.deliver(0, cut)
    other.deliver(cut, len(rows))
    for story in (single, one, other, one):
        rest(story)

    assert told(one, "boot-0001") == told(other, "boot-0001") == told(single, "boot-0001")


_given: dict[str, Shared] = {}


@pytest.fixture
def _shared(shared: Shared) -> None:
    # Hypothesis runs a test many times with the same fixtures.
    _given["shared"] = shared


@pytest.mark.usefixtures("_shared")
@settings(max_examples=8, deadline=None)
@given(rng=st.randoms(use_true_random=True))
# A first run of two samples is too short to tell what it leaves to the next service.
@example(rng=random.Random(306))  # noqa: S311  # a story, no secret
def test_services_that_take_turns_record_what_one_service_would(rng: random.Random) -> None:
    shared, boot_id = _given["shared"], f"boot-{uuid4()}"
    rows: list[Row] = [RESTING]
    while len(rows) < 60:
        rows += [rng.choice(KINDS)] * rng.randint(1, 6)
    rows += [RESTING] * 3
    cuts = [0, *sorted(rng.sample(range(1, len(rows)), 5)), len(rows)]
    single, *services = (shared.story(rows, alone=True), shared.story(rows), shared.story(rows))
    for number, (first, last) in enumerate(pairwise(cuts)):
        single.deliver(first, last, boot_id=boot_id)
        services[number % 2].deliver(first, last, boot_id=boot_id)
        if rng.random() < 0.5:
            rest(services[1 - number % 2])
    for story in (single, *services, *services):
        rest(story)

    expected = told(single, boot_id)
    assert told(services[0], boot_id) == expected
    assert told(services[1], boot_id) == expected
    shared.close()
