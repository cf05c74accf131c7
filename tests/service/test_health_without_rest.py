"""Contacts before which no rest was seen say nothing of the sensors: their zeros are not known."""

import pytest

from service.bench import Bench, Row
from service.event_story import RESTING, TOUCHING, Story
from support.surfaces.small_model import model_of

CONTACT: list[Row] = [*[TOUCHING] * 3, *[RESTING] * 3]


def contacts_of(bench: Bench) -> set[int]:
    """Return the numbers of contacts that the health of the channels counts; empty before the first."""
    bench.get("/events")  # it writes what there is so far
    return {one["contacts"] for one in bench.get("/surfaces/press-7").json()["health"].values()}


@pytest.mark.promise("docs/reference/sensor-health.md", "a contact without a rest before it does not count")
def test_a_contact_after_a_start_under_load_does_not_count(bench: Bench) -> None:
    story = Story(bench, CONTACT * 3)
    story.deliver(0, 6)
    assert len(bench.get("/events").json()["events"]) == 1
    assert contacts_of(bench) == set()
    story.deliver(6, 18)
    assert len(bench.get("/events").json()["events"]) == 3
    assert contacts_of(bench) == {2}


def test_another_sender_that_begins_under_load_adds_none_to_those_before(bench: Bench) -> None:
    first = Story(bench, [RESTING, *CONTACT])
    first.deliver(0, 7)
    assert contacts_of(bench) == {1}
    second = Story(bench, CONTACT * 2, "boot-0002")
    second.later_us = 60_000_000
    second.deliver(0, 6)
    assert contacts_of(bench) == {1}
    second.deliver(6, 12)
    assert contacts_of(bench) == {2}


@pytest.mark.promise("docs/reference/sensor-health.md", "anew when the model changes")
def test_another_model_begins_anew(bench: Bench) -> None:
    story = Story(bench, [RESTING, *CONTACT * 4])
    story.deliver(0, 13)
    assert contacts_of(bench) == {2}
    bench.adopt(model_of("other"))
    story.deliver(13, 25)
    assert contacts_of(bench) == {1}
