"""The waits between attempts."""

import pytest

from beamtouch_common.waits import Backoff


def test_waiting_times_double_up_to_the_greatest_and_begin_again() -> None:
    backoff = Backoff()
    assert [backoff.next() for _ in range(7)] == pytest.approx([0.1, 0.2, 0.4, 0.8, 1.6, 2.0, 2.0])
    backoff.reset()
    assert backoff.next() == 0.1


@pytest.mark.promise(
    "docs/reference/metrics.md",
    "and counts as missing until it has run for 10 s, or for as long as the pause before.",
)
def test_what_has_run_for_ten_seconds_and_as_long_as_the_last_wait_has_recovered() -> None:
    backoff = Backoff(1.0, 30.0)
    steady = [backoff.steady_s]
    for _ in range(6):
        backoff.next()
        steady.append(backoff.steady_s)
    assert steady == [10.0, 10.0, 10.0, 10.0, 10.0, 16.0, 30.0]
