"""Services with a record, and stories of samples that several of them take."""

from pathlib import Path
from typing import Any

import pytest

from beamtouch_service.sections import EventsSection
from service.bench import Bench, Row, surface_with
from service.event_story import RESTING, TOUCHING, Story
from support.surfaces.small_model import model_of

CONTACT: list[Row] = [RESTING, *[TOUCHING] * 8, RESTING]


class Services:
    """Services of one surface, each with a record of its own or with one that they share."""

    def __init__(self) -> None:
        self.model = model_of()

    def story(self, rows: list[Row], place: Path | str | None = None) -> Story:
        """Return a service that has started now, and the samples to deliver."""
        events = EventsSection(url=place) if isinstance(place, str) else EventsSection(file=place)
        return Story(Bench(surface_with(self.model), events=events), rows)

    def straight(self, rows: list[Row]) -> list[dict[str, Any]]:
        """Return the events of a service without faults."""
        story = self.story(rows)
        story.deliver(0, len(rows))
        return story.events


def rounded(events: list[dict[str, Any]]) -> list[dict[str, Any]]:
    """Return events with figures as near as float32 allows."""
    for event in events:
        for figures in (event, *event["path"]):
            for name in figures:
                if name.endswith(("_mm", "_n")):
                    figures[name] = figures[name] and pytest.approx(figures[name], abs=1e-3)
        event["capture"] = [one["sequence"] for one in event["capture"]]
    return events


def ends(story: Story) -> list[tuple[str, str]]:
    return [(event["begin"], event["end"]) for event in story.events]
