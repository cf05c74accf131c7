"""The event routes: pages, selection, CSV, single events."""

from __future__ import annotations

import csv
import io
from typing import TYPE_CHECKING, Any

import pytest

from service.event_story import RESTING, TOUCHING, Story

if TYPE_CHECKING:
    from service.conftest import Bench, MakeBatch


@pytest.fixture
def history(bench: Bench, make_batch: MakeBatch) -> Bench:
    """Seven contacts, at samples 1, 3, 5, ..."""
    Story(bench, make_batch, [RESTING, *[TOUCHING, RESTING] * 7]).deliver(0, 15)
    return bench


def test_pages_come_newest_first_and_hold_every_event_once(history: Bench) -> None:
    found, after = list[dict[str, Any]](), ""
    while True:
        page = history.get(f"/events?limit=3{after}").json()
        found += page["events"]
        if page["next"] is None:
            break
        after = f"&after={page['next']}"

    assert [event["id"] for event in found] == [7, 6, 5, 4, 3, 2, 1]


def test_the_list_can_be_limited_by_time_and_surface(history: Bench) -> None:
    def ids(query: str) -> list[int]:
        return [event["id"] for event in history.get(f"/events?{query}").json()["events"]]

    # Sample 5 is the touch of event 3.
    third = "2026-11-20T23:40:46.148456Z"
    assert ids(f"since={third}") == [7, 6, 5, 4, 3]
    assert ids(f"until={third}") == [2, 1]
    assert ids(f"since={third}&until=2026-11-21T00:40:46.150%2B01:00") == [3]
    assert ids("surface=press-7&limit=1") == [7]


def test_csv_has_a_row_per_event_and_a_link_to_the_next_page(history: Bench) -> None:
    response = history.get("/events?format=csv&limit=2&surface=press-7")

    assert response.headers["content-type"].startswith("text/csv")
    rows = list(csv.DictReader(io.StringIO(response.text)))
    assert [row["id"] for row in rows] == ["7", "6"]
    assert (rows[0]["surface"], rows[0]["end"], rows[0]["peak_force_n"]) == ("press-7", "lift", "8.75")
    assert history.get(response.links["next"]["url"]).text.splitlines()[1].startswith("5,")


@pytest.mark.parametrize(
    "query",
    [
        "limit=0",
        "limit=1001",
        "limit=many",
        "since=yesterday",
        "since=1795218046",
        "since=2026-11-20T23:40:46",
        "until=",
        "after=1",
        "after=x.y",
        "after=99999999999999999999999.1",
        "format=xml",
        "surface=a%20b",
        "sort=up",
        "path=maybe",
    ],
)
def test_a_wrong_query_is_a_problem_that_names_the_parameter(history: Bench, query: str) -> None:
    response = history.get(f"/events?{query}")

    assert (response.status_code, response.json()["type"]) == (422, "urn:beamtouch:problem:invalid-request")
    assert response.json()["errors"][0]["pointer"].startswith("#/query/" + query.split("=", maxsplit=1)[0])


def test_a_list_has_paths_only_on_request_and_is_then_short(history: Bench) -> None:
    (plain, *_), (full, *_) = (history.get(f"/events{query}").json()["events"] for query in ("", "?path=true&limit=50"))
    assert full.pop("path")
    assert full.pop("capture") == []
    assert plain == full

    response = history.get("/events?limit=51&path=true")
    assert (response.status_code, response.json()["errors"][0]["pointer"]) == (422, "#/query/limit")
    assert "with path=true, a page has at most 50 events" in response.json()["detail"]
    assert history.get("/events?limit=51&path=false").status_code == 200


def test_an_id_gives_one_event_with_its_path(history: Bench) -> None:
    assert [point["position_mm"] for point in history.get("/events/3").json()["path"]] == [150.0]

    missing = history.get("/events/8")
    assert (missing.status_code, missing.json()["type"]) == (404, "urn:beamtouch:problem:unknown-event")
    assert missing.json()["detail"].startswith("There is no event 8.")
    for wrong in ("0", "first", str(2**63)):
        problem = history.get(f"/events/{wrong}").json()
        assert (problem["status"], problem["errors"][0]["pointer"]) == (422, "#/path/id")


def test_an_unknown_surface_is_a_problem_and_one_without_events_has_an_empty_list(bench: Bench) -> None:
    assert bench.get("/events?surface=nobody").status_code == 404
    assert bench.get("/events?surface=press-7").json() == {"events": [], "next": None}
