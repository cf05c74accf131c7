"""The answers of the service in pages are those of today: their members, titles and sentences."""

import json
from collections.abc import Set
from typing import Any

import pytest
from pydantic import BaseModel

from beamtouch_service.api.events import EventList
from beamtouch_service.problems import Kind
from beamtouch_service.record import EventWithPath
from beamtouch_service.surfaces import surface_problems
from beamtouch_service.surfaces.channels import ChannelHealth
from beamtouch_service.surfaces.fields import Contact
from support.pages.pasted import ROOT, blocks_of

PAGES = [str(page.relative_to(ROOT)) for page in (ROOT / "README.md", *sorted((ROOT / "docs").rglob("*.md")))]
SHOWN = [
    pytest.param(json.loads(block.text), id=page)
    for page in PAGES
    for block in blocks_of(page)
    if block.word == "json" and block.text.startswith("{")
]
KINDS = {kind.type_uri: kind for kind in Kind}


@pytest.mark.parametrize("shown", SHOWN)
def test_an_answer_in_a_page_is_one_of_today(shown: dict[str, Any]) -> None:
    if "state" in shown:
        assert_is(shown, Contact, left_out={"zones"})  # a surface without zones has no such member
    elif "type" in shown:
        assert_is_problem(shown)
    else:
        (health,) = shown.values()
        assert_is(health, ChannelHealth)


def test_the_page_of_events_names_every_member_of_an_event() -> None:
    page = (ROOT / "docs" / "reference" / "events.md").read_text()

    assert [name for kind in (EventWithPath, EventList) for name in kind.model_fields if f"`{name}`" not in page] == []


def assert_is(shown: dict[str, Any], model: type[BaseModel], left_out: Set[str] = frozenset()) -> None:
    assert list(shown) == [name for name in model.model_fields if name not in left_out]
    model.model_validate(shown)


def assert_is_problem(shown: dict[str, Any]) -> None:
    kind = KINDS[shown["type"]]
    assert (shown["title"], shown["status"]) == (kind.title, kind.status)
    if kind is Kind.STALE:
        problem = surface_problems.stale(shown["surface"], shown["age_ms"], shown["stale_ms"])
        assert shown == problem.body()
