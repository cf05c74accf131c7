"""Presses in the samples of a commissioning: what counts as one, and what does not."""

from collections.abc import Sequence

import numpy as np
import pytest

from beamtouch_models.runtime import State
from beamtouch_service.commissioning.pressing import HOLD_US, PressFinder, Stage
from service.bench import Row
from service.event_story import RESTING

STEP_US = 10_000
SECOND = 105
"""Samples that last a little longer than a press must be held."""


class Samples:
    """A finder, and the clock of its sender."""

    def __init__(self) -> None:
        self.finder = PressFinder(reading_mm=0.01, pause_us=1e6)
        self.at_us = 0
        self.found: list[list[float]] = []

    def add(self, *rows: Row, count: int = SECOND, state: State | None = State.CLEAR) -> Stage:
        """Take these deflections in turn, so often."""
        for number in range(count):
            self.at_us += STEP_US
            values = np.array(rows[number % len(rows)], np.float64)
            movement = self.finder.add(self.at_us, values, state)
            if movement:
                self.found.append(movement.moved_mm.round(6).tolist())
        return self.finder.stage


@pytest.mark.promise(
    "docs/how-to/commission-on-the-page.md",
    "It waits until the beam lies still again. A press counts once the beam is back where it rested before",
)
def test_a_press_is_from_rest_once_it_has_been_held_and_the_next_one_needs_a_lift() -> None:
    samples = Samples()
    assert samples.add([0.1, 2.0, -0.3], count=SECOND - 20) is Stage.REST
    assert samples.add([0.1, 2.0, -0.3], count=20) is Stage.PRESS
    assert samples.add([0.4, 1.5, -0.3], count=SECOND - 20) is Stage.HOLD
    assert 0.7 < samples.finder.held < 1
    assert samples.add([0.4, 1.5, -0.3], count=20) is Stage.LIFT
    assert samples.add([0.6, 1.2, -0.3]) is Stage.LIFT
    assert samples.found == []
    assert samples.add([0.11, 2.0, -0.3]) is Stage.PRESS
    assert samples.found == [[0.3, -0.5, 0.0]]
    samples.add([0.61, 2.0, -0.3])
    samples.add([0.11, 2.0, -0.3])
    assert samples.found[1:] == [[0.5, 0.0, 0.0]]


@pytest.mark.promise("docs/how-to/commission-on-the-page.md", "How hard does not matter, and your hand may tremble.")
@pytest.mark.parametrize(
    ("rows", "count", "is_found"),
    [
        ([[0.5, 0.2, 0.0]], SECOND, True),
        ([[0.5, 0.2, 0.0], [0.3, 0.12, 0.0]], SECOND, True),
        ([[0.5, 0.2, 0.0], [0.2, 0.08, 0.0]], 2 * SECOND, False),
        ([[0.5, 0.2, 0.0], [0.0, 0.0, 0.0]], 2 * SECOND, False),
        ([[0.5, 0.2, 0.0]], SECOND // 2, False),
        ([[0.09, 0.0, 0.0]], SECOND, False),
        ([[0.5, None, 0.0]], SECOND, True),
    ],
    ids=["held", "a hand that wavers", "one that lets go", "taps", "too short", "too weak", "a channel is missing"],
)
def test_only_what_is_held_is_a_press(rows: Sequence[Row], count: int, is_found: bool) -> None:
    samples = Samples()
    samples.add(RESTING)
    samples.add(*rows, count=count)
    samples.add(RESTING)
    assert bool(samples.found) is is_found
    if is_found:
        middle_mm = np.mean(np.array([row[1] for row in rows], np.float64))
        assert samples.found[0][1:] == [pytest.approx(middle_mm, abs=0.005, nan_ok=True), 0.0]


@pytest.mark.promise(
    "docs/how-to/commission-on-the-page.md",
    "a press that was not held for long enough counts for nothing.",
)
def test_a_pause_ends_a_press_that_was_not_held_for_long_enough() -> None:
    samples = Samples()
    samples.add(RESTING)
    samples.add([0.5, 0.2, 0.0], count=SECOND - 20)
    samples.at_us += 2 * HOLD_US
    assert samples.add([0.5, 0.2, 0.0], count=20) is Stage.HOLD
    assert samples.found == []
    assert samples.add([0.5, 0.2, 0.0], count=SECOND) is Stage.LIFT


def test_what_the_surface_calls_a_contact_is_no_rest_and_a_broken_cable_does_not_hinder_it() -> None:
    samples = Samples()
    assert samples.add([0.5, 0.2, 0.0], state=State.CONTACT) is Stage.REST
    assert samples.add([0.0, 0.0, 3.0], [0.0, 0.0, -2.0]) is Stage.PRESS
    samples.add([0.5, 0.2, 3.0], [0.5, 0.2, -2.0])
    samples.add([0.0, 0.0, 3.0], [0.0, 0.0, -2.0])
    assert samples.found[0][:2] == [0.5, 0.2]


def test_a_missing_value_leaves_its_channel_to_the_others_and_a_channel_without_most_is_not_known() -> None:
    samples = Samples()
    samples.add([None, 0.0, 0.0], count=1)
    samples.add(RESTING)
    samples.add([0.5, 0.2, 0.1], count=40)
    samples.add([0.5, None, 0.1], count=1)
    samples.add([0.5, 0.2, None], count=60)
    samples.add(RESTING)
    assert samples.found == [[0.5, 0.2, pytest.approx(np.nan, nan_ok=True)]]


@pytest.mark.parametrize("state", [State.UNEXPLAINED, None])
def test_a_load_that_lies_on_at_the_beginning_is_no_rest(state: State | None) -> None:
    samples = Samples()
    assert samples.add([0.5, 0.2, 0.1], count=5 * SECOND, state=state) is Stage.REST
    samples.add(RESTING)
    for _ in range(2):
        samples.add([0.5, 0.2, 0.1], state=state)
        samples.add(RESTING)
    assert samples.found == [[0.5, 0.2, 0.1]] * 2


@pytest.mark.parametrize("state", [State.UNEXPLAINED, State.CLEAR, None])
def test_a_load_that_is_taken_off_is_no_press(state: State | None) -> None:
    samples = Samples()
    assert samples.add([0.5, 0.2, 0.1], count=10 * SECOND, state=state) is Stage.PRESS
    assert samples.add(RESTING, state=state) is Stage.LIFT
    assert samples.add(RESTING, count=10 * SECOND, state=state) is Stage.PRESS
    assert samples.found == []
    samples.add([0.5, 0.2, 0.1], state=state)
    samples.add(RESTING, state=state)
    assert samples.found == [[0.5, 0.2, 0.1]]


@pytest.mark.parametrize("state", [State.CONTACT, State.UNEXPLAINED, State.CLEAR, None])
def test_a_press_that_begins_gently_does_not_become_the_rest(state: State | None) -> None:
    samples = Samples()
    samples.add(RESTING)
    for step in range(10 * SECOND):
        force = min(step / (5 * SECOND), 1.0)
        samples.add([0.5 * force, 0.2 * force, 0.0], count=1, state=state)
    samples.add(RESTING, count=12 * SECOND)
    assert all(first_mm > 0.0 < second_mm for first_mm, second_mm, _ in samples.found)
    assert bool(samples.found) is (state in {State.CONTACT, State.UNEXPLAINED})
    samples.add([0.5, 0.2, 0.0], state=state)
    samples.add(RESTING, state=state)
    assert samples.found[-1] == [0.5, 0.2, 0.0]


def test_a_press_that_grows_for_ten_seconds_does_not_become_the_rest_step_by_step() -> None:
    samples = Samples()
    samples.add(RESTING)
    for step in range(1000):
        samples.add([0.0005 * step, 0.0002 * step, 0.0], count=1)
    assert samples.finder.stage is Stage.LIFT


def test_zeros_may_drift_before_a_press_while_the_surface_is_clear() -> None:
    samples = Samples()
    samples.add(RESTING)
    samples.add([0.08, 0.0, 0.0], count=2 * SECOND, state=State.CLEAR)
    samples.add([0.58, 0.2, 0.0])
    samples.add([0.08, 0.0, 0.0])
    assert samples.found == [[0.5, 0.2, 0.0]]


@pytest.mark.promise(
    "docs/how-to/commission-on-the-page.md",
    "A faulty sensor does not stop it: go on to the end, and you know all faults at once.",
    "if it settles elsewhere for ten seconds, the page asks for the press again.",
)
def test_a_channel_that_jumps_and_stays_does_not_stop_the_run() -> None:
    samples = Samples()
    samples.add(RESTING)
    samples.add([0.5, 0.2, 0.1])
    assert samples.add([0.0, 0.0, 0.4], count=5 * SECOND) is Stage.LIFT
    assert samples.add([0.0, 0.0, 0.4], count=6 * SECOND) is Stage.PRESS
    assert samples.found == []
