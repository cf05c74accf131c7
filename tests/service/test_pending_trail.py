"""Changes that wait for the trail: how many are kept, which states are told, and what is said of lost ones."""

import json
from collections.abc import Callable

import pytest

from beamtouch_service.record.trail.entry import Action, Entry
from beamtouch_service.record.trail.pending import PendingTrail


def entry(at_us: int, action: Action = Action.MODEL, subject: str = "") -> Entry:
    return Entry(at_us, action, "{}", subject=subject)


def maker(at_us: int, action: Action = Action.TARE, subject: str = "") -> Callable[[], Entry]:
    return lambda: entry(at_us, action, subject)


def times(entries: list[Entry]) -> list[int]:
    return [one.at_us for one in entries]


@pytest.fixture
def trail() -> PendingTrail:
    return PendingTrail()


@pytest.mark.promise("docs/reference/trail.md", "While the record is away, a thousand entries wait in memory")
def test_a_thousand_entries_wait_and_what_was_lost_is_told_beside_the_next_ones_at_most_once_an_hour(
    trail: PendingTrail,
) -> None:
    for number in range(1003):
        trail.note(entry(number))
    assert times(trail.take_due(50.0)) == list(range(1000))
    (loss,) = trail.take_due(51.0)
    assert (loss.at_us, loss.action, json.loads(loss.details)) == (1000, Action.LOSS, {"entries": 3, "since_us": 1000})
    assert trail.take_due(52.0) == []
    for number in range(2000, 3005):
        trail.note(entry(number))
    assert len(trail.take_due(53.0)) == 1000
    assert trail.take_due(3650.9) == []
    (loss,) = trail.take_due(3651.0)
    assert json.loads(loss.details) == {"entries": 5, "since_us": 3000}


def test_a_loss_waits_until_there_is_room(trail: PendingTrail) -> None:
    for number in range(1001):
        trail.note(entry(number))
    due = trail.take_due(50.0)
    trail.put_back(due[1:])
    found = trail.take_due(51.0)
    assert [len(found), found[-1].action] == [1000, Action.LOSS]


def test_a_state_is_told_once_per_value_and_a_change_of_a_change_after_a_minute(trail: PendingTrail) -> None:
    def note(value: object, now_s: float, at_us: int) -> None:
        trail.note_state(Action.TARE, "press-7", "", value, now_s, maker(at_us))

    plan = [("a", 100.0), ("a", 101.0), ("b", 102.0), ("c", 161.9), ("c", 162.0), ("b", 163.0), ("c", 300.0)]
    for at_us, (value, now_s) in enumerate(plan):
        note(value, now_s, at_us)
    assert times(trail.take_due(300.0)) == [0, 2, 4]


def test_each_subject_surface_and_action_has_a_state_of_its_own(trail: PendingTrail) -> None:
    keys = [
        (action, surface, subject) for action in (Action.TARE, Action.MODEL) for surface in "ab" for subject in "cd"
    ]
    for _ in range(2):
        for at_us, (action, surface, subject) in enumerate(keys):
            trail.note_state(action, surface, subject, "same", 1.0, maker(at_us))
    assert times(trail.take_due(2.0)) == list(range(8))


def test_of_each_action_five_thousand_states_are_watched(trail: PendingTrail) -> None:
    def note(subject: int, action: Action = Action.TOKEN) -> None:
        trail.note_state(action, "", str(subject), "used", 1.0, maker(subject, action, str(subject)))

    told = 0
    for subject in range(5002):
        note(subject)
        if len(trail.due) == 1000:
            told += len(trail.take_due(0.0))
    assert told == 5000
    note(4999)
    note(7, Action.MODEL)
    # Two of them lost, and since when: of those that are watched, none was told again.
    first, loss = trail.take_due(1.0)
    assert (first.action, json.loads(loss.details)) == (Action.MODEL, {"entries": 2, "since_us": 5000})


def test_a_state_that_finds_no_room_is_told_once_there_is(trail: PendingTrail) -> None:
    for number in range(1000):
        trail.note(entry(number))
    for _ in range(2):
        trail.note_state(Action.TARE, "", "", "a", 1.0, maker(7777))
    trail.take_due(1.0)
    for _ in range(2):
        trail.note_state(Action.TARE, "", "", "a", 2.0, maker(8888))
    assert times(trail.take_due(2.0)) == [8888]


def test_what_could_not_be_committed_comes_before_what_came_meanwhile(trail: PendingTrail) -> None:
    trail.note(entry(1))
    due = trail.take_due(0.0)
    trail.note(entry(2))
    trail.put_back(due)
    assert times(trail.take_due(0.0)) == [1, 2]
