"""The waits between attempts."""

import pytest

from beamtouch_common.waits import Backoff


def test_waiting_times_double_up_to_the_greatest_and_begin_again() -> None:
    backoff = Backoff()
    assert [backoff.next() for _ in range(7)] == pytest.approx([0.1, 0.2, 0.4, 0.8, 1.6, 2.0, 2.0])
    backoff.reset()
    assert backoff.next() == 0.1
