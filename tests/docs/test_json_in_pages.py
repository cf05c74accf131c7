"""The answers of the service in pages are those of today: their members, titles and sentences."""

from typing import Any

import pytest

from beamtouch_service.api.events import EventList
from beamtouch_service.api.surfaces import CandidateReport
from beamtouch_service.api.trail import TrailPage
from beamtouch_service.fields import example_of
from beamtouch_service.problems import Kind
from beamtouch_service.record import EventWithPath
from beamtouch_service.surfaces import surface_problems
from beamtouch_service.surfaces.channels import ChannelHealth
from beamtouch_service.surfaces.fields import Contact, fields_of
from support.pages.pasted import ROOT, blocks_of, is_part_of, shown_in

PAGES = [str(page.relative_to(ROOT)) for page in (ROOT / "README.md", *sorted((ROOT / "docs").rglob("*.md")))]
SHOWN = [
    pytest.param(shown_in(block.text), id=page)
    for page in PAGES
    for block in blocks_of(page)
    if block.word == "json" and block.text.startswith("{")
]
KINDS = {kind.type_uri: kind for kind in Kind}


@pytest.mark.parametrize("shown", SHOWN)
def test_an_answer_in_a_page_is_one_of_today(shown: dict[str, Any]) -> None:
    if "state" in shown:
        assert is_part_of(shown, Contact.model_fields)
        Contact.model_validate(example_of(fields_of()) | shown)
    elif "type" in shown:
        assert_is_problem(shown)
    elif "comparison" in shown:
        CandidateReport.model_validate(shown, extra="forbid")
    elif "entries" in shown:
        TrailPage.model_validate(shown, extra="forbid")
    else:
        (health,) = shown.values()
        assert list(health) == list(ChannelHealth.model_fields)
        ChannelHealth.model_validate(health)


def test_the_page_of_events_names_every_member_of_an_event() -> None:
    page = (ROOT / "docs" / "reference" / "events.md").read_text()

    assert [name for kind in (EventWithPath, EventList) for name in kind.model_fields if f"`{name}`" not in page] == []


def assert_is_problem(shown: dict[str, Any]) -> None:
    kind = KINDS[shown["type"]]
    assert (shown["title"], shown["status"]) == (kind.title, kind.status)
    if kind is Kind.STALE:
        problem = surface_problems.stale(shown["surface"], shown["age_ms"], shown["stale_ms"], shown["since"])
        assert shown == problem.body()
