"""Sequence numbers of frames tell what was lost."""

import pytest
from hypothesis import given
from hypothesis import strategies as st

from beamtouch_protocol.sequence import DeviceClock, missing_between

WRAP = 2**32


@pytest.mark.parametrize(
    ("previous", "current", "missing"),
    [
        (0, 1, 0),
        (41, 42, 0),
        (41, 45, 3),
        (65534, 65535, 0),
        (65535, 0, 0),
        (65535, 1, 1),
        (65530, 4, 9),
        (1, 0, 65534),
        (5, 5, 65535),
    ],
)
def test_readings_lost_between_two_that_arrived(previous: int, current: int, missing: int) -> None:
    assert missing_between(previous, current) == missing


@given(st.integers(0, 65535), st.integers(0, 65535))
def test_as_many_are_missing_as_were_lost(first: int, lost: int) -> None:
    assert missing_between(first, (first + lost + 1) % 65536) == lost


def test_a_clock_begins_with_the_first_value_and_counts_on_over_the_wrap() -> None:
    clock = DeviceClock()
    values = [WRAP - 1000, WRAP - 1, 0, 999, 999]
    assert [clock.extend(value) for value in values] == [WRAP - 1000, WRAP - 1, WRAP, WRAP + 999, WRAP + 999]


def test_a_clock_counts_every_wrap() -> None:
    clock = DeviceClock()
    step = 3_000_000_000  # 50 minutes, so that most steps wrap
    assert [clock.extend(n * step % WRAP) for n in range(10)] == [n * step for n in range(10)]


@given(st.integers(0, WRAP - 1), st.lists(st.integers(0, WRAP - 1), max_size=50))
def test_a_clock_keeps_every_step_shorter_than_a_wrap(start: int, steps: list[int]) -> None:
    clock = DeviceClock()
    elapsed = start
    assert clock.extend(start) == start
    for step in steps:
        elapsed += step
        assert clock.extend(elapsed % WRAP) == elapsed
