"""When listeners are told about surfaces: the caller gives the time."""

from __future__ import annotations

import pytest

from beamtouch_service.surfaces.pace import ALIVE_S, Pace
from service.bench import Row, parsed, surface_of, surface_with
from service.event_story import RESTING, TOUCHING


class Press:
    """A surface whose samples come at times of the test."""

    def __init__(self, name: str = "press-7") -> None:
        self.surface = surface_of(name)
        self._sequence = 0

    def take(self, row: Row, now_s: float) -> None:
        self._sequence += 1
        self.surface.receive(parsed(row, sequence=self._sequence), now_s)


@pytest.fixture
def press() -> Press:
    return Press()


@pytest.mark.promise(
    "docs/how-to/mqtt.md",
    (
        "A contact is sent at once when the state changes, otherwise with new samples at most `max_rate_hz` times "
        "per second"
    ),
)
@pytest.mark.promise(
    "docs/reference/service-configuration.md",
    "Contacts per second and surface while the state does not change.",
)
def test_a_state_is_due_at_once_and_a_sample_in_it_at_its_turn(press: Press) -> None:
    pace = Pace([press.surface], turn_s=0.1)
    assert pace.due(100.0) == [press.surface]  # that there are no samples
    pace.note_told([press.surface], 100.0)
    assert pace.due(100.05) == []

    press.take(RESTING, 100.06)
    assert pace.has_news(press.surface, 100.06)
    assert pace.due(100.06) == [press.surface]
    pace.note_told([press.surface], 100.06)
    press.take(RESTING, 100.07)
    assert not pace.has_news(press.surface, 100.07)
    assert pace.due(100.07) == []
    assert 100.07 + pace.wait_s(100.07) == pytest.approx(100.1)
    assert pace.due(100.1) == [press.surface]
    pace.note_told([press.surface], 100.1)

    for at_s, row in ((100.11, TOUCHING), (100.12, RESTING), (100.13, TOUCHING)):
        press.take(row, at_s)
        assert pace.has_news(press.surface, at_s)
        assert pace.due(at_s) == [press.surface]
        pace.note_told([press.surface], at_s)
        assert pace.due(at_s) == []


@pytest.mark.promise(
    "docs/how-to/mqtt.md",
    "So a surface whose samples stop sends `urn:beamtouch:problem:stale` when its limit is over, and then each second.",
)
def test_a_surface_is_due_when_it_becomes_stale_and_then_each_second(press: Press) -> None:
    pace = Pace([press.surface], turn_s=1)
    press.take(TOUCHING, 10.0)
    pace.note_told([press.surface], 10.0)
    look_s = 10.0 + pace.wait_s(10.0)
    assert 10.5 < look_s < 10.51
    assert pace.due(10.5) == []
    assert pace.due(look_s) == [press.surface]

    pace.note_told([press.surface], look_s)
    again_s = look_s + pace.wait_s(look_s)
    assert look_s + ALIVE_S <= again_s + 1e-9
    assert again_s - look_s < 1
    assert pace.due(again_s + 1e-6) == [press.surface]


@pytest.mark.parametrize("at_once", [True, False])
def test_a_problem_that_stays_is_looked_at_again_only_when_it_is_due(*, at_once: bool) -> None:
    without_model = Press()
    without_model.surface = surface_with(None)
    pace = Pace([without_model.surface], turn_s=0.05, tells_status_at_once=at_once)
    without_model.take(TOUCHING, 10.0)
    pace.note_told([without_model.surface], 10.0)
    now_s, looks = 10.0, 0
    while not pace.due(now_s):
        now_s, looks = now_s + pace.wait_s(now_s), looks + 1
        assert looks <= 2
    assert now_s == pytest.approx(10.0 + ALIVE_S)


def test_a_surface_that_was_told_as_stale_within_the_last_millisecond_is_not_looked_at_again_and_again(
    press: Press,
) -> None:
    pace = Pace([press.surface], turn_s=0.05)
    press.take(TOUCHING, 10.0)
    pace.note_told([press.surface], 10.0)
    told_s = 10.5005
    assert pace.due(told_s) == [press.surface]
    pace.note_told([press.surface], told_s)
    assert pace.wait_s(10.502) == pytest.approx(told_s + ALIVE_S - 10.502)


@pytest.mark.promise("docs/how-to/mqtt.md", "and at least each second.")
def test_the_same_sample_is_due_within_a_second(press: Press) -> None:
    press.surface.stale_ms = 60_000
    pace = Pace([press.surface], turn_s=0.05)
    press.take(TOUCHING, 10.0)
    pace.note_told([press.surface], 10.0)
    assert pace.due(10.5) == []
    assert 10.5 + pace.wait_s(10.5) == pytest.approx(10.0 + ALIVE_S)
    assert pace.due(10.0 + ALIVE_S) == [press.surface]


def test_turns_are_common_to_all_surfaces(press: Press) -> None:
    other = Press("press-8")
    pace = Pace([press.surface, other.surface], turn_s=0.1)
    press.take(RESTING, 1.0)
    other.take(RESTING, 1.0)
    pace.note_told(pace.due(1.0), 1.0)
    press.take(RESTING, 1.02)
    other.take(TOUCHING, 1.04)
    assert pace.due(1.04) == [other.surface]
    pace.note_told([other.surface], 1.04)
    other.take(TOUCHING, 1.05)
    assert pace.due(1.1) == [press.surface, other.surface]


def test_turns_stay_in_step_unless_one_was_missed(press: Press) -> None:
    pace = Pace([press.surface], turn_s=0.25)
    found = []
    for told_s in (1.0, 1.375, 1.75, 2.625):  # due from 1.25, 1.5 and 2.0 on: the third is a whole turn late
        press.take(RESTING, told_s)
        assert pace.due(told_s) == [press.surface]
        pace.note_told([press.surface], told_s)
        press.take(RESTING, told_s)
        found.append(told_s + pace.wait_s(told_s))
    assert found == [1.25, 1.5, 2.0, 2.875]


def test_a_listener_of_no_surface_looks_again_within_a_second_and_uses_no_turn(press: Press) -> None:
    assert Pace([], turn_s=0.1).wait_s(50.0) == pytest.approx(ALIVE_S)
    assert ALIVE_S == 0.9
    pace = Pace([press.surface], turn_s=100.0)
    pace.note_told([], 1.0)
    assert pace.has_news(press.surface, 1.0)
    assert pace.wait_s(1.0) == 0.0


def test_between_two_turns_a_listener_that_is_not_told_at_once_has_no_news(press: Press) -> None:
    pace = Pace([press.surface], turn_s=0.5, tells_status_at_once=False)
    press.take(RESTING, 10.0)
    assert pace.has_news(press.surface, 10.0)
    pace.note_told([press.surface], 10.0)
    press.take(TOUCHING, 10.125)
    for at_s, is_due in ((10.125, False), (10.499, False), (10.5, True)):
        assert pace.has_news(press.surface, at_s) is is_due
        assert pace.due(at_s) == [press.surface] * is_due
    assert pace.wait_s(10.125) == pytest.approx(0.375)


def test_a_listener_looks_at_the_next_turn_only_for_a_sample_that_it_has_not_seen(press: Press) -> None:
    press.surface.stale_ms = 60_000
    pace = Pace([press.surface], turn_s=0.25)
    press.take(TOUCHING, 10.0)
    pace.note_told([press.surface], 10.0)
    assert pace.wait_s(10.125) == pytest.approx(0.775)
    press.take(TOUCHING, 10.125)
    assert pace.wait_s(10.125) == pytest.approx(0.125)
    # The turn is over: whoever asks then was late, and looks again when it is due anyway.
    assert pace.due(10.25) == [press.surface]
    assert pace.wait_s(10.25) == pytest.approx(0.65)


def test_a_listener_looks_a_millisecond_after_the_limit_of_age(press: Press) -> None:
    press.surface.stale_ms = 800
    pace = Pace([press.surface], turn_s=1)
    press.take(TOUCHING, 10.0)
    pace.note_told([press.surface], 10.0)
    assert pace.wait_s(10.0) == pytest.approx(0.801, abs=1e-4)
