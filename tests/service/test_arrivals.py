"""When requests that a loop reads may have arrived. The times are those of a clock that the test sets."""

from __future__ import annotations

import selectors
import socket

from beamtouch_service.host.arrivals import LOOK_S, PAUSE_S, Arrivals, Selector


class Clock:
    """A clock that stands still unless told."""

    def __init__(self) -> None:
        self.now_s = 1000.0

    def __call__(self) -> float:
        return self.now_s

    def go(self, seconds: float) -> None:
        self.now_s += seconds


def caught_up() -> tuple[Clock, Arrivals]:
    clock = Clock()
    arrivals = Arrivals(clock)
    arrivals.caught_up()
    return clock, arrivals


def test_what_a_loop_reads_that_looks_often_has_just_arrived() -> None:
    clock, arrivals = caught_up()
    for _ in range(10):
        clock.go(LOOK_S)
        arrivals.looked()
        clock.go(0.02)
        assert arrivals.now() == clock.now_s


def test_what_is_read_after_a_pause_may_have_arrived_since_the_last_look() -> None:
    clock, arrivals = caught_up()
    arrivals.looked()
    last_look_s = clock.now_s
    # The pause is noticed at once, whether it happens while the loop waits or while it works.
    clock.go(4.0)
    assert arrivals.now() == last_look_s
    arrivals.looked()
    clock.go(0.01)
    assert arrivals.now() == last_look_s
    # A second pause, before all that waited during the first one is read.
    clock.go(3.0)
    arrivals.looked()
    assert arrivals.now() == last_look_s
    arrivals.caught_up()
    assert arrivals.now() == clock.now_s


def test_a_loop_that_never_rests_ends_a_pause_after_some_looks() -> None:
    clock, arrivals = caught_up()
    clock.go(2 * PAUSE_S)
    arrivals.looked()
    looks = 0
    while not arrivals.has_caught_up:
        clock.go(0.001)
        arrivals.looked()
        looks += 1
        assert looks < 1000
    # The system keeps 1024 connections until they are accepted, and a loop accepts 16 at once.
    assert looks >= 1024 / 16 + 8
    assert arrivals.now() == clock.now_s


def test_before_the_first_look_connections_may_have_waited_since_a_given_time() -> None:
    clock = Clock()
    assert Arrivals(clock).now() == clock.now_s
    arrivals = Arrivals(clock, since_s=0.0)
    clock.go(1.0)
    arrivals.looked()
    assert arrivals.now() == 0.0


def test_a_pause_is_over_once_there_is_nothing_to_read() -> None:
    clock = Clock()
    arrivals = Arrivals(clock)
    one, other = socket.socketpair()
    with Selector(arrivals) as selector, one, other:
        selector.register(other, selectors.EVENT_READ)
        one.send(b"x")
        # Something is there to be read, and then something is left to be done.
        assert [key.fileobj for key, _ in selector.select(1.0)] == [other]
        other.recv(1)
        assert selector.select(0) == []
        assert not arrivals.has_caught_up
        assert selector.select(1.0) == []
        assert arrivals.has_caught_up
