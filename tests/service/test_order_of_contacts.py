"""The order of the contacts that a calibration takes from the record, and which of them a limit leaves."""

import csv
import io

import pytest

from service.bench import Bench, Row
from service.event_story import RESTING, TOUCHING, Story

CONTACT: list[Row] = [RESTING, *[TOUCHING] * 3, *[RESTING] * 3]
CONTACTS = 6


@pytest.fixture
def events(bench: Bench) -> list[str]:
    """The numbers of the contacts on record, oldest first."""
    story = Story(bench, CONTACT * CONTACTS)
    story.deliver(0, len(story.rows))
    answer = bench.get("/events").json()["events"]
    return [str(event["id"]) for event in answer][::-1]


def rows(bench: Bench, query: str = "") -> list[tuple[str, str]]:
    """Return event and time of each row of the file for a calibration."""
    answer = bench.get(f"/surfaces/press-7/calibration-data{query}")
    assert answer.status_code == 200
    return [(row["event"], row["time"]) for row in csv.DictReader(io.StringIO(answer.text))]


def test_contacts_come_oldest_first(bench: Bench, events: list[str]) -> None:
    found = rows(bench)
    assert [event for event, _ in found] == events
    times = [time for _, time in found]
    assert times == sorted(times)
    assert len(set(times)) == CONTACTS


@pytest.mark.promise("docs/reference/http.md", "the best sample of each contact as CSV, oldest first")
@pytest.mark.promise("docs/reference/loads.md", "(the newest 1000; at most 5000)")
@pytest.mark.parametrize("limit", [1, 4, CONTACTS + 1])
def test_a_limit_leaves_the_newest_oldest_first(bench: Bench, events: list[str], limit: int) -> None:
    assert [event for event, _ in rows(bench, f"?limit={limit}")] == events[-limit:]
