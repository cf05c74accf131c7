"""Events from samples, and the routes that give them: single ones, pages, CSV, and their best samples."""

import csv
import io
import time
from typing import Any
from urllib.parse import urljoin

import pytest

from service.bench import START_US, Bench, Row, batch_of, kind, surface_of
from service.event_story import BETWEEN, HARDER, ODD, RESTING, TOUCHING, Story
from support.surfaces.small_model import model_of


def test_one_contact_is_one_event(bench: Bench) -> None:
    Story(bench, [RESTING, TOUCHING, HARDER, TOUCHING, RESTING]).deliver(0, 5)
    (event,) = bench.get("/events?path=true").json()["events"]
    assert bench.get(f"/events/{event['id']}").json() == event
    assert event.pop("model").startswith("press-7@")
    assert [point["position_mm"] for point in event.pop("path")] == [150.0, 200.0, 150.0]
    assert event.pop("capture") == []
    assert event == {
        "id": 1,
        "surface": "press-7",
        "kind": "contact",
        "touched_at": "2026-11-20T23:40:46.128Z",
        "lifted_at": "2026-11-20T23:40:46.143Z",
        "begin": "touch",
        "end": "lift",
        "dwell_ms": 15.0,
        "unexplained_ms": 0.0,
        "mean_position_mm": pytest.approx(166.6667),
        "mean_position_low_mm": pytest.approx(165.6667),
        "mean_position_high_mm": pytest.approx(167.6667),
        "min_position_mm": 150.0,
        "max_position_mm": 200.0,
        "mean_force_n": 10.0,
        "mean_force_low_n": 9.0,
        "mean_force_high_n": 11.0,
        "peak_force_n": 12.5,
        "peak_force_low_n": 11.5,
        "peak_force_high_n": 13.5,
        "peak_position_mm": 200.0,
        "samples": 3,
        "unsteady_samples": 0,
        "unsteady": False,
        "quality": "good",
        "boot_id": "boot-0001",
    }


def test_a_contact_that_goes_on_is_an_open_event_and_its_path_says_what_changed(bench: Bench) -> None:
    story = Story(bench, [RESTING, *[TOUCHING] * 600, *[HARDER] * 400, RESTING])
    story.deliver(0, 300)
    (event,) = story.events
    assert (event["begin"], event["end"], event["lifted_at"], event["samples"]) == ("touch", "open", None, 299)
    assert [point["lasts_ms"] for point in event["path"]] == [1490.0]
    story.deliver(300, 1002)
    (event,) = story.events
    assert (event["end"], event["samples"], event["dwell_ms"]) == ("lift", 1000, 5000.0)
    first, second = event["path"]
    assert first == {
        "at": "2026-11-20T23:40:46.128Z",
        "lasts_ms": 3000.0,
        "position_mm": 150.0,
        "position_low_mm": 149.0,
        "position_high_mm": 151.0,
        "force_n": 8.75,
        "force_low_n": 7.75,
        "force_high_n": 9.75,
        "unsteady": False,
    }
    assert (second["at"], second["lasts_ms"]) == ("2026-11-20T23:40:49.128Z", 2000.0)
    assert (second["position_mm"], second["force_n"]) == (200.0, 12.5)
    assert (event["mean_position_mm"], event["mean_force_n"]) == (pytest.approx(170.0), pytest.approx(10.25))


@pytest.mark.promise("docs/reference/events.md", "Beyond 25 stays, the two neighbours that lasted least become one")
def test_a_path_of_many_changes_stays_short_and_keeps_the_mean(bench: Bench) -> None:
    story = Story(bench, [RESTING, HARDER, *[TOUCHING, HARDER] * 200, RESTING])
    story.deliver(0, 403)
    (event,) = story.events
    assert len(event["path"]) <= 25  # points of a path, `docs/reference/events.md`
    assert sum(point["lasts_ms"] for point in event["path"]) == event["dwell_ms"] == 2005.0
    assert event["mean_force_n"] == pytest.approx((201 * 12.5 + 200 * 8.75) / 401, abs=1e-4)
    assert event["mean_position_mm"] == pytest.approx((201 * 200.0 + 200 * 150.0) / 401, abs=1e-4)


def test_samples_without_all_channels_or_an_estimate_degrade_the_event(bench: Bench) -> None:
    unusable: Row = [1.0, 0.5, 0.5]
    story = Story(bench, [RESTING, TOUCHING, unusable, TOUCHING, RESTING, RESTING, TOUCHING, RESTING])
    story.deliver(0, 8)
    assert [(event["quality"], event["samples"]) for event in story.events] == [("degraded", 2), ("good", 1)]


def story_of(bench: Bench, rows: list[Row]) -> Story:
    story = Story(bench, rows)
    story.deliver(0, len(rows))
    return story


def told(story: Story) -> list[tuple[str, str, str, float, float]]:
    """Kind, begin, end, dwell and unexplained part of each event."""
    return [
        (event["kind"], event["begin"], event["end"], event["dwell_ms"], event["unexplained_ms"])
        for event in story.events
    ]


@pytest.mark.promise(
    "docs/reference/events.md",
    "The stretch counts in `unexplained_ms`, and in no force, position or path.",
    "a contact after a stretch, so its touch was not seen",
    "An unexplained event has no force, no position and an empty path.",
    "A contact outlasts an unexplained stretch.",
)
@pytest.mark.parametrize(
    ("rows", "events"),
    [
        # Two odd samples come before the state, and two that are explained end it.
        ([*[TOUCHING] * 3, *[ODD] * 4, *[TOUCHING] * 4, RESTING], [("contact", "touch", "lift", 55.0, 20.0)]),
        ([*[ODD] * 5, *[RESTING] * 4], [("unexplained", "clear", "clear", 25.0, 25.0)]),
        # A contact that begins in a stretch has an unseen touch, and one that ends in a stretch an unseen lift.
        (
            [*[ODD] * 5, *[TOUCHING] * 4, RESTING],
            [("unexplained", "clear", "contact", 20.0, 20.0), ("contact", "unexplained", "lift", 10.0, 0.0)],
        ),
        ([*[TOUCHING] * 2, *[ODD] * 5, *[RESTING] * 3], [("contact", "touch", "unexplained", 45.0, 25.0)]),
    ],
    ids=["during", "alone", "before", "after"],
)
def test_an_unexplained_stretch_counts_in_a_contact_or_is_an_event_of_its_own(
    bench: Bench, rows: list[Row], events: list[tuple[str, str, str, float, float]]
) -> None:
    story = story_of(bench, [RESTING, *rows])
    assert told(story) == events
    for event in story.events:
        is_contact = event["kind"] == "contact"
        figures = [event[name] for name in ("mean_position_mm", "peak_position_mm", "peak_force_n")]
        assert figures == ([150.0, 150.0, 8.75] if is_contact else [None] * 3)
        assert (event["samples"] > 0) is is_contact


@pytest.mark.promise(
    "docs/reference/events.md",
    "Samples that contradict the contact, but are too few for a stretch, count in no figure.",
)
def test_samples_that_contradict_a_contact_and_are_no_stretch_count_in_no_figure(bench: Bench) -> None:
    rows: list[Row] = [*[TOUCHING] * 3, *[ODD] * 2, *[TOUCHING] * 3]
    story = story_of(bench, [RESTING, *rows, RESTING])
    assert told(story) == [("contact", "touch", "lift", 40.0, 0.0)]
    (event,) = story.events
    assert (event["samples"], event["unsteady_samples"]) == (6, 0)
    assert [event[f"{name}_position_mm"] for name in ("min", "mean", "max", "peak")] == [150.0] * 4


def test_undecided_samples_go_on_in_a_stretch(bench: Bench) -> None:
    story = Story(bench, [RESTING, *[ODD] * 7, *[RESTING] * 3])
    story.deliver(0, 5)
    missing: Row = [None] * 3
    bench.send(missing, sequence=6, quality=["missing"] * 3, begin_us=START_US + 25_000, members={"oldest": 1})
    story.deliver(6, 11)
    assert told(story) == [("unexplained", "clear", "clear", 35.0, 35.0)]
    assert story.events[0]["quality"] == "degraded"


@pytest.mark.promise("docs/reference/events.md", "holds the first five unexplained samples of an event")
def test_a_stretch_keeps_what_each_channel_of_its_first_samples_contradicts() -> None:
    wedged: Row = [0.5, 0.25, 0.75, 0.125]
    resting: Row = [0.0] * 4
    (event,) = story_of(Bench(surface_of(channels=4)), [resting, *[wedged] * 20, *[resting] * 4]).events
    assert [sample["sequence"] for sample in event["capture"]] == [4, 5, 6, 7, 8]
    first = event["capture"][0]
    assert first["misfit"] == 500.0
    assert [channel["deflection_mm"] for channel in first["channels"]] == wedged
    assert [channel["name"] for channel in first["channels"] if channel["explained_without"]] == ["s3"]
    assert first["channels"][2]["misfit_without"] == 0.0


@pytest.mark.promise(
    "docs/reference/events.md", "the misfit of the best contact without this channel; null if too few channels are left"
)
def test_of_three_channels_a_stretch_does_not_say_which_one_is_wrong(bench: Bench) -> None:
    (event,) = story_of(bench, [RESTING, *[ODD] * 20, *[RESTING] * 4]).events
    for sample in event["capture"]:
        each = [(one["misfit_without"], one["explained_without"]) for one in sample["channels"]]
        assert each == [(None, False)] * 3


@pytest.mark.parametrize(
    ("before", "after"),
    [(ODD, [RESTING] * 2), (TOUCHING, [ODD] * 2), (TOUCHING, [BETWEEN]), (TOUCHING, [BETWEEN, ODD, BETWEEN])],
    ids=["rest after a stretch", "odd after a contact", "weak after a contact", "changing after a contact"],
)
def test_the_first_samples_after_a_gap_make_no_event_by_themselves(bench: Bench, before: Row, after: list[Row]) -> None:
    """None of them shows by itself what came before the gap."""
    story = Story(bench, [RESTING, *[before] * 5, RESTING, *after])
    story.deliver(0, 6)
    story.oldest = 8  # the one before is lost
    story.deliver(7, 7 + len(after))
    kind, begin = ("contact", "touch") if before is TOUCHING else ("unexplained", "clear")
    assert [one[:3] for one in told(story)] == [(kind, begin, "unseen")]


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


STILL: dict[str, Any] = {"readings": 4}
MOVING: dict[str, Any] = {"readings": 50, "covariance_mm2": [1e-3, 0.0, 1e-3, 0.0, 0.0, 1e-3]}


def send(bench: Bench, *samples: tuple[Row, dict[str, Any]], sequence: int = 1) -> None:
    """Send these samples, 100 ms apart, each with its further members."""
    begin_us = 1_795_218_000_000_000 + sequence * 100_000
    members = batch_of(*(row for row, _ in samples), sequence=sequence, begin_us=begin_us, every_us=100_000)
    for sample, (_, more) in zip(members["samples"], samples, strict=True):
        sample.update(more)
    noise_mm = [0.01] * len(members["channels"])
    bench.send(members=members | {"noise_mm": noise_mm, "characteristic": "as-taken"})


def best_samples(bench: Bench, query: str = "") -> list[dict[str, str]]:
    answer = bench.get(f"/surfaces/press-7/calibration-data{query}")
    assert answer.status_code == 200, answer.text
    assert answer.headers["content-type"].startswith("text/csv")
    return list(csv.DictReader(io.StringIO(answer.text)))


PRESSING: Row = [1.0, 0.5, 0.25]
SWINGING: Row = [1.6, 0.8, 0.4]


def figures(event: dict[str, Any]) -> tuple[float, ...]:
    names = ("mean_force_n", "peak_force_n", "mean_position_mm", "samples", "unsteady_samples", "unsteady")
    return tuple(event[name] for name in names)


@pytest.mark.promise(
    "docs/reference/events.md",
    (
        "A sample that alone does not show a contact, as while the beam swings far or after the lift, counts in no "
        "figure if others do."
    ),
)
@pytest.mark.parametrize("parts", [[10], [4, 6], [9, 1]])
def test_a_settled_sample_after_the_lift_is_no_part_of_the_load(bench: Bench, parts: list[int]) -> None:
    """All samples of the load are unsteady, as the beam rings."""
    swung: Row = [0.15, 0.0, 0.0]
    rows = [(RESTING, STILL), *[(PRESSING, MOVING)] * 7, (swung, STILL), (RESTING, STILL)]
    first = 0
    for count in parts:
        send(bench, *rows[first : first + count], sequence=first + 1)
        bench.get("/events")  # It writes what there is so far.
        first += count
    (event,) = bench.get("/events").json()["events"]
    assert figures(event) == (17.5, 17.5, 200.0, 8, 7, True)
    assert (event["peak_force_low_n"], event["peak_force_high_n"]) == (16.5, 18.5)


@pytest.mark.promise(
    "docs/reference/events.md",
    "A load that lies still makes one stay, with the figures of the sample that knows most.",
    "Swings of the beam make no stay, so they are no largest force.",
)
def test_the_sample_that_knows_most_counts_and_an_overshoot_within_its_interval_does_not(bench: Bench) -> None:
    knows: dict[str, Any] = {"readings": 50}
    above: Row = [0.53, 0.25, 0.125]
    send(bench, (RESTING, STILL), (above, STILL), (TOUCHING, knows), (above, STILL), (RESTING, STILL))
    (event,) = bench.get("/events").json()["events"]
    assert figures(event) == (8.75, 8.75, 150.0, 3, 0, False)
    assert (event["mean_position_low_mm"], event["mean_position_high_mm"]) == (149.0, 151.0)
    assert (event["min_position_mm"], event["max_position_mm"]) == (150.0, 150.0)


@pytest.mark.promise(
    "docs/reference/events.md",
    "Stays that are weaker than the next one inwards are ramps and no part of the load",
)
def test_the_ramps_of_touch_and_lift_are_not_the_load(bench: Bench) -> None:
    ramp = [[0.5 * part, 0.25 * part, 0.125 * part] for part in (0.4, 0.7)]
    send(bench, *((row, STILL) for row in [*[RESTING] * 6, *ramp, *[TOUCHING] * 20, *reversed(ramp), RESTING]))
    (event,) = bench.get("/events?path=true").json()["events"]
    assert figures(event) == (8.75, 8.75, 150.0, 24, 0, False)
    assert len(event["path"]) == 5


@pytest.mark.promise(
    "docs/reference/events.md", "if they last for less than a fifth of the contact at its begin, or at its end."
)
@pytest.mark.parametrize("is_lift", [False, True])
@pytest.mark.parametrize(("weak", "mean_n"), [(3, 8.75), (8, 7.0)])
def test_a_weak_begin_or_end_that_lasts_is_a_part_of_the_load(
    bench: Bench, is_lift: bool, weak: int, mean_n: float
) -> None:
    """Of 20 samples."""
    ramp: Row = [0.25, 0.125, 0.0625]
    rows = [*[ramp] * weak, *[TOUCHING] * (20 - weak)]
    send(bench, *((row, {"readings": 1}) for row in [RESTING, *(rows[::-1] if is_lift else rows), RESTING]))
    (event,) = bench.get("/events").json()["events"]
    assert event["mean_force_n"] == pytest.approx(mean_n, abs=0.15)
    assert event["peak_force_n"] == 8.75


@pytest.mark.promise("docs/reference/events.md", "from where to where it moved; twice its position if it lay still")
def test_the_mean_of_a_load_that_moves_is_that_of_its_path(bench: Bench) -> None:
    places = [[0.5 - 0.005 * step, 0.25 + 0.005 * step, 0.125] for step in range(21)]
    send(bench, (RESTING, STILL), *((row, STILL) for row in places), (RESTING, STILL))
    (event,) = bench.get("/events").json()["events"]
    assert event["mean_position_low_mm"] <= 155.0 <= event["mean_position_high_mm"]
    assert event["mean_position_mm"] == pytest.approx(155.0, abs=0.6)
    assert (event["min_position_mm"], event["max_position_mm"]) == pytest.approx((150.5, 159.5), abs=1.0)
    assert event["mean_force_n"] == 8.75


@pytest.mark.promise("docs/reference/events.md", "time of its first sample, and of the first clear reading after it")
def test_a_lift_is_at_the_first_clear_reading(bench: Bench) -> None:
    send(bench, (RESTING, STILL), *[(TOUCHING, STILL)] * 5, (RESTING, {"readings": 8}))
    (event,) = bench.get("/events").json()["events"]
    assert (event["touched_at"], event["lifted_at"]) == ("2026-11-20T23:40:00.200Z", "2026-11-20T23:40:00.665Z")
    assert event["dwell_ms"] == 465.0


@pytest.mark.promise("docs/reference/loads.md", "the same of the rest before the contact")
def test_the_steady_sample_of_the_most_readings_is_kept_with_the_rest_before_it(bench: Bench) -> None:
    degraded = {"readings": 100, "quality": ["good", "good", "stuck"]}
    best: Row = [0.52, 0.26, 0.13]
    later: Row = [0.54, 0.27, 0.135]
    send(
        bench,
        *[([0.002, 0.0, 0.0], STILL), ([0.004, 0.0, 0.0], STILL), ([0.09, 0.0, 0.0], STILL), (TOUCHING, STILL)],
        *[(best, {"readings": 16}), (later, {"readings": 16}), (later, MOVING), (later, degraded), (RESTING, STILL)],
    )
    (row,) = best_samples(bench)
    assert [float(row[f"s{i}_mm"]) for i in (1, 2, 3)] == best
    assert [float(row[f"s{i}_sd_mm"]) for i in (1, 2, 3)] == pytest.approx([0.01 / 4] * 3)
    assert (row["readings"], row["characteristic"], row["time"]) == ("16", "as-taken", "2026-11-20T23:40:00.500Z")
    # Without the newest sample of the rest, which may hold the touch.
    assert [float(row[f"s{i}_rest_mm"]) for i in (1, 2, 3)] == pytest.approx([0.003, 0.0, 0.0])
    assert float(row["s1_rest_sd_mm"]) == pytest.approx(0.01 / 8**0.5, rel=1e-3)
    assert best_samples(bench, "?since=2026-11-20T23:40:01Z") == []


@pytest.mark.promise(
    "docs/reference/loads.md",
    (
        "the best sample of each contact that a single contact explains, which is the steady one with the most "
        "readings and all channels good"
    ),
)
def test_an_event_without_a_steady_sample_of_one_contact_has_no_row(bench: Bench) -> None:
    missing: dict[str, Any] = {"readings": 4, "quality": ["good", "missing", "good"]}
    odd: Row = [0.5, 0.1, 0.4]
    send(bench, (RESTING, STILL), (TOUCHING, MOVING), (TOUCHING, missing), (RESTING, STILL))
    send(bench, (RESTING, STILL), *[(odd, STILL)] * 6, *[(RESTING, STILL)] * 3, sequence=5)
    assert [event["kind"] for event in bench.get("/events").json()["events"]] == ["unexplained", "contact"]
    assert best_samples(bench) == []
    # A sender that states no readings sends settled samples.
    bench.send(RESTING, TOUCHING, RESTING, boot_id="boot-0002")
    (row,) = best_samples(bench)
    assert (row["readings"], row["characteristic"], row["s1_sd_mm"]) == ("1", "", "0.0100000000")


def test_contacts_of_another_layout_of_channels_have_no_row() -> None:
    bench = Bench(surface_of(channels=4))
    send(bench, *(([*row, 0.0], STILL) for row in (RESTING, TOUCHING, RESTING)))
    assert list(best_samples(bench)[0])[5:9] == ["s1_mm", "s2_mm", "s3_mm", "s4_mm"]
    bench.adopt(model_of("other"))
    send(bench, *((row, STILL) for row in (RESTING, TOUCHING, RESTING)), sequence=10)
    (row,) = best_samples(bench)
    assert row["model"].startswith("other@")
    assert "s4_mm" not in row


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
