"""Times of readings of a board never go back, whatever becomes of the line: filters count on their order."""

import math

import numpy as np
import pytest

from beamtouch_daemon.sources.clock import HostClock

RATE_HZ = 50
MINUTES = 3
START_S = 5000.0


@pytest.mark.parametrize("rate", [0.993, 1.0, 1.007])
def test_pings_that_become_slow_make_no_reading_older_than_the_one_before(rate: float) -> None:
    """The fast ones are forgotten after a while, and less is known of the offset then."""
    chance, clock, last_s, steps = np.random.default_rng(6), HostClock(), -math.inf, 0
    for number in range(MINUTES * 60 * RATE_HZ):
        true_s = number / RATE_HZ
        device_s = 77.0 + rate * true_s
        if number % RATE_HZ == 0:
            way_s = 0.0002 if true_s < 60 else 0.4 + 0.1 * chance.random()
            clock.round_trip(START_S + true_s - way_s, device_s, START_S + true_s + way_s)
        # The line delivers half a second late, or more.
        arrival_s = START_S + true_s + 0.5 + 0.2 * chance.random()
        mapped_s = clock.to_host(device_s, arrival_s)
        assert last_s <= mapped_s <= START_S + true_s + 0.001, true_s
        steps += mapped_s == last_s
        last_s = mapped_s
    assert steps > RATE_HZ / 10, "the bounds have never moved back, so that this shows nothing"
