"""The routes that give events: pages, filters, CSV, single events."""

import csv
import io
import json
import time
from urllib.parse import urljoin

import pytest

from beamtouch_service.api import events
from service.bench import START_US, Bench, kind
from service.event_story import RESTING, TOUCHING, Story, story_of
from service.read_tables import tables_read


@pytest.fixture
def history(bench: Bench) -> Bench:
    """Seven contacts, at samples 1, 3, 5, ..."""
    story_of(bench, [RESTING, *[TOUCHING, RESTING] * 7])
    return bench


def ids(bench: Bench, query: str) -> list[int]:
    return [event["id"] for event in bench.get(f"/events?{query}").json()["events"]]


@pytest.mark.promise(
    "docs/reference/events.md",
    "`next` is the value of `after` for the events that follow it, and null if there are none.",
)
def test_pages_come_newest_first_and_can_be_limited_by_time_kind_and_surface(history: Bench) -> None:
    found, after = list[int](), ""
    while after is not None:
        page = history.get(f"/events?limit=3{after and f'&after={after}'}").json()
        found += [event["id"] for event in page["events"]]
        after = page["next"]
    assert found == [7, 6, 5, 4, 3, 2, 1]
    # Sample 5 is the touch of event 3.
    third = "2026-11-20T23:40:46.148456Z"
    assert ids(history, f"since={third}") == [7, 6, 5, 4, 3]
    assert ids(history, f"until={third}") == [2, 1]
    assert ids(history, f"since={third}&until=2026-11-21T00:40:46.150%2B01:00") == [3]
    assert (ids(history, "surface=press-7&limit=1"), ids(history, "kind=unexplained")) == ([7], [])
    assert history.problem("/events?surface=nobody") == "unknown-surface"


@pytest.mark.promise("docs/reference/events.md", "`format=csv` gives a table")
def test_csv_has_a_row_per_event_and_a_link_to_the_next_page(history: Bench) -> None:
    response = history.get("/events?format=csv&limit=2&surface=press-7")
    assert response.headers["content-type"].startswith("text/csv")
    rows = list(csv.DictReader(io.StringIO(response.text)))
    assert [row["id"] for row in rows] == ["7", "6"]
    assert (rows[0]["surface"], rows[0]["end"], rows[0]["peak_force_n"]) == ("press-7", "lift", "8.75")
    assert rows[0]["unsteady"] == "false"
    following = urljoin("/events?format=csv", response.links["next"]["url"])
    assert history.get(following).text.splitlines()[1].startswith("5,")
    # Below the path of a proxy, too.
    assert urljoin("https://hall.example/touch/events", response.links["next"]["url"]).startswith(
        "https://hall.example/touch/events?"
    )


@pytest.mark.promise(
    "docs/reference/events.md", "an address from the one that was asked for. The last page has no such header."
)
@pytest.mark.parametrize("query", ["format=csv&limit=2", "kind=contact&format=csv&limit=3", "format=csv&limit=1000"])
def test_who_follows_the_links_of_tables_gets_each_event_once(history: Bench, query: str) -> None:
    address, found = f"/events?{query}", list[str]()
    while True:
        response = history.get(address)
        found += [row["id"] for row in csv.DictReader(io.StringIO(response.text))]
        if "next" not in response.links:
            break
        address = urljoin(address, response.links["next"]["url"])
    assert found == ["7", "6", "5", "4", "3", "2", "1"]


@pytest.mark.promise("docs/reference/events.md", "`format=ndjson` streams all of them, one event in JSON per line")
@pytest.mark.parametrize("path", ["", "&path=true"])
def test_ndjson_has_a_line_for_each_event_of_the_period_however_many_there_are(
    history: Bench, monkeypatch: pytest.MonkeyPatch, path: str
) -> None:
    monkeypatch.setattr(events, "_MAX_LIMIT", 1)  # it reads them so many at a time, and one more
    whole = history.get(f"/events?limit=50{path}").json()["events"]

    def lines(query: str) -> list[dict[str, object]]:
        answer = history.get(f"/events?format=ndjson{query}{path}")
        assert (answer.status_code, answer.headers["content-type"]) == (200, "application/x-ndjson")
        return [json.loads(line) for line in answer.text.splitlines()]

    third = "2026-11-20T23:40:46.148456Z"
    assert len(whole) == 7
    assert lines("") == whole
    assert lines(f"&since={third}") == whole[:5]
    assert lines(f"&until={third}") == whole[5:]
    assert lines("&kind=unexplained") == []
    assert history.problem("/events?format=ndjson&surface=nobody") == "unknown-surface"


@pytest.mark.promise("docs/reference/http.md", "To HEAD, the record is read as far as the headers need it.")
def test_head_of_a_period_reads_no_event(history: Bench) -> None:
    history.get("/events")  # all of them are durable
    with tables_read() as tables:
        head = history.client.head("/events?format=ndjson")
        assert (head.status_code, head.content) == (200, b"")
        of_head = len(tables)
        assert head.headers == history.client.get("/events?format=ndjson").headers
    # The keys of events now and of those of a clock ahead; then their content, and what follows them.
    assert tables == ["events"] * (of_head * 2 + 3)


def test_ndjson_with_a_limit_comes_in_pages(history: Bench) -> None:
    address, found = "/events?format=ndjson&limit=3", list[list[int]]()
    while address:
        response = history.get(address)
        found.append([json.loads(line)["id"] for line in response.text.splitlines()])
        address = urljoin("/events", response.links["next"]["url"]) if "next" in response.links else ""
    assert found == [[7, 6, 5], [4, 3, 2], [1]]


@pytest.mark.parametrize(
    "query",
    [
        *("limit=0", "limit=1001", "limit=many", "since=yesterday", "since=1795218046", "since=2026-11-20T23:40:46"),
        *("until=", "after=1", "after=x.y", "after=99999999999999999999999.1", "format=xml", "surface=a%20b"),
        *("kind=press", "sort=up", "path=maybe", "limit=51&path=true"),
    ],
)
def test_a_wrong_query_is_a_problem_that_names_the_parameter(history: Bench, query: str) -> None:
    response = history.get(f"/events?{query}")
    assert (response.status_code, response.json()["type"]) == (422, "urn:beamtouch:problem:invalid-request")
    assert response.json()["errors"][0]["pointer"].startswith("#/query/" + query.split("=", maxsplit=1)[0])


@pytest.mark.promise("docs/reference/events.md", "`GET /events/ID` and `path=true` add `path`, at most 25 points")
def test_a_list_has_paths_only_on_request_and_a_single_event_always(history: Bench) -> None:
    (plain, *_), (full, *_) = (history.get(f"/events{query}").json()["events"] for query in ("", "?path=true&limit=50"))
    assert history.get("/events/7").json() == full
    assert [point["position_mm"] for point in full.pop("path")] == [150.0]
    assert full.pop("capture") == []
    assert plain == full
    missing = history.get("/events/8").json()
    assert missing["type"] == "urn:beamtouch:problem:unknown-event"
    assert missing["detail"].startswith("There is no event 8.")
    for wrong in ("0", "first", str(2**63)):
        assert history.get(f"/events/{wrong}").json()["errors"][0]["pointer"] == "#/path/id"


@pytest.mark.promise("docs/reference/events.md", "In an address, the + of a zone is written `%2B`.")
@pytest.mark.parametrize("zone", ["+02:00", "+0200"])
def test_a_zone_whose_plus_became_a_space_is_answered_with_what_to_write(bench: Bench, zone: str) -> None:
    answer = bench.get(f"/events?since=2026-11-21T00:40:46{zone}")
    assert (answer.status_code, kind(answer)) == (422, "invalid-request")
    assert f"write 2026-11-21T00:40:46%2B{zone[1:]}, or the time in UTC with Z at its end" in answer.json()["detail"]
    assert bench.get(f"/events?since=2026-11-21T00:40:46%2B{zone[1:]}").status_code == 200


@pytest.mark.promise(
    "docs/reference/events.md",
    "events that are stamped more than a day ahead of the service's clock come last.",
)
def test_events_of_a_clock_that_is_years_ahead_do_not_hide_those_after_them(bench: Bench) -> None:
    for boot_id, contacts, ahead_days in (("boot-0001", 2, -1.0), ("boot-ahead", 3, 3653.0), ("boot-0002", 2, 0.5)):
        story = Story(bench, [RESTING, TOUCHING, RESTING] * contacts, boot_id)
        story.later_us = round((time.time() + ahead_days * 86_400) * 1e6) - START_US
        story.deliver(0, len(story.rows))
    pages, following = list[int](), ""
    while following is not None:
        page = bench.get(f"/events?limit=2{following and f'&after={following}'}").json()
        pages, following = pages + [event["id"] for event in page["events"]], page["next"]
    whole = [event["id"] for event in bench.get("/events").json()["events"]]
    assert whole == pages == [7, 6, 2, 1, 5, 4, 3]
