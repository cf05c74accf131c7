"""The answers of zones to consecutive samples, as pure functions."""

import json
from typing import Literal

import pytest

from beamtouch_common.outline import BEAM_AXIS, Outline
from beamtouch_common.zones import Zone, ZoneState
from beamtouch_service.surfaces.zones import ZoneEvidence, ZoneFollower, ZoneReport
from support.surfaces.zone_cases import GATE, I, O, U, at

SLOW = Zone(from_mm=120, to_mm=200, dwell_ms=20)
LENGTH_MM, HOLD_US, STEP_US = 400.0, 100_000, 5000

What = float | Literal["clear"] | None
Step = tuple[What, int, int]


def steps(*whats: What) -> list[Step]:
    return [(what, STEP_US, 1) for what in whats]


STORIES: dict[str, tuple[Zone, list[Step], list[ZoneState | None], int]] = {
    "an answer is harder to begin than to keep": (
        GATE,
        steps(121.7, 121.4, 121.2, 121.4, 121.7, 118.6, 118.3, 118.6, 118.8, 118.6),
        [I, I, U, U, I, U, O, O, U, U],
        1,
    ),
    "an entry follows on outside, not on unsure": (GATE, steps(150, 120, 150, 100, 150), [I, U, I, O, I], 2),
    "a lift ends the stay": (GATE, steps(150, "clear", 150), [I, O, I], 2),
    "a touch beside the edge of a clear beam is not sure to be outside": (GATE, steps("clear", 118.6), [O, U], 0),
    "without a contact to judge there is no answer": (GATE, steps(150, None, 150), [I, None, I], 2),
    "inside comes after the dwell": (SLOW, steps(*[150] * 6), [U, U, U, U, I, I], 1),
    "what interrupts the contact begins the dwell anew": (
        SLOW,
        steps(150, 150, 150, 150, 121, *[150] * 5),
        [U, U, U, U, U, U, U, U, U, I],
        1,
    ),
    "where samples are missing, the dwell begins anew": (
        SLOW,
        [*steps(*[150] * 4), (150, 90_000, 18), *steps(*[150] * 4)],
        [*[U] * 8, I],
        1,
    ),
    "where a sample is missing, an answer begins anew, but a contact does not enter again": (
        GATE,
        [*steps(121.7, 121.4), (121.4, 2 * STEP_US, 2), *steps(121.7), (150, 2 * STEP_US, 2)],
        [I, I, U, I, I],
        1,
    ),
    "samples at rest count in full": (SLOW, [*steps(150), (150, 90_000, 1)], [U, I], 1),
    "after a pause longer than a contact is held nothing is known": (
        SLOW,
        [*steps(*[150] * 5), (150, 100_001, 1), *steps(*[150] * 4)],
        [U, U, U, U, I, U, U, U, U, I],
        2,
    ),
    "a clock that is set back takes no time away": (
        SLOW,
        [*steps(150, 150, 150), (150, -1, 1), *steps(150, 150), (150, -90_000, 1)],
        [U, U, U, U, U, I, I],
        1,
    ),
}


def follower_of(zone: Zone, former: ZoneFollower | None = None) -> ZoneFollower:
    """Return the follower of a zone, which goes on from the memory of a former one."""
    memory = json.loads(json.dumps(former.memory)) if former else None
    return ZoneFollower({"gate": zone}, Outline.of_beam(LENGTH_MM), HOLD_US, memory)


def reports_of(zone: Zone, story: list[Step], *, restarts: bool = False) -> list[ZoneReport]:
    """Return what each sample shows, to a service that is started anew after each of them if it `restarts`."""
    follower, at_us, found = follower_of(zone), 1_000_000, []
    for what, passed_us, more in story:
        at_us += passed_us
        if more > 1:
            follower.miss()
        place = {BEAM_AXIS: at(what)} if isinstance(what, float | int) else None
        found.append(follower.step(ZoneEvidence(at_us, what == "clear", place)))
        follower = follower_of(zone, follower) if restarts else follower
    return found


@pytest.mark.promise(
    "docs/how-to/zones.md",
    (
        "it holds 99.9 % to begin an answer and 99 % to keep it, so that the answer for a contact at an edge does "
        "not flicker"
    ),
    "A contact that was `unsure` in between has not left.",
)
@pytest.mark.promise(
    "docs/reference/service-configuration.md",
    "A contact must have been in it for this long, without a break, before the answer is `inside`.",
)
@pytest.mark.parametrize("name", STORIES)
def test_answers_of_consecutive_samples_also_through_any_restart(name: str) -> None:
    zone, story, expected, entries = STORIES[name]
    reports = reports_of(zone, story)
    assert [report.answers["gate"] for report in reports] == expected
    assert sum(len(report.entered) for report in reports) == entries
    assert reports_of(zone, story, restarts=True) == reports


@pytest.mark.promise("docs/how-to/zones.md", "for how many ms the contact was inside each zone")
def test_the_dwell_is_part_of_the_time_inside() -> None:
    each = [report.stays_us.get("gate") for report in reports_of(SLOW, steps(*[150] * 6, 100))]
    assert each == [None, None, None, None, 20_000, 5000, None]


def test_a_zone_that_is_defined_anew_begins_anew() -> None:
    follower = follower_of(SLOW)
    for at_us in range(0, 25_000, STEP_US):
        report = follower.step(ZoneEvidence(at_us, place={BEAM_AXIS: at(150)}))
    assert report.answers == {"gate": I}
    seen = ZoneEvidence(25_000, place={BEAM_AXIS: at(150)})
    assert follower_of(SLOW.model_copy(update={"from_mm": 110.0}), follower).step(seen).answers == {"gate": U}
    assert follower_of(SLOW, follower).step(seen).answers == {"gate": I}
