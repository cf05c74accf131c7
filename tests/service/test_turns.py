"""One thread for what is prompt and for what may wait."""

from __future__ import annotations

from concurrent.futures import Future
from functools import partial
from threading import Event

import pytest

from beamtouch_service.events.worker import Turns


def test_what_is_prompt_passes_what_may_wait_and_both_keep_their_order() -> None:
    turns, gate, done = Turns("test"), Event(), list[str]()
    turns.prompt(lambda: gate.wait(60))
    for name in "abc":
        turns.late(partial(done.append, name))
    for name in "123":
        turns.prompt(partial(done.append, name))
    gate.set()
    turns.close()

    assert "".join(done) == "123abc"


def test_what_may_wait_does_not_wait_for_ever() -> None:
    turns, gate, done = Turns("test"), Event(), list[str]()
    turns.prompt(lambda: gate.wait(60))
    turns.late(lambda: done.append("late"))
    for _ in range(50):
        turns.prompt(lambda: done.append("prompt"))
    gate.set()
    turns.close()

    assert len(done) == 51
    assert done.index("late") < 20


def test_an_error_reaches_who_asked_and_what_nobody_wants_any_more_is_not_done() -> None:
    turns, gate, done = Turns("test"), Event(), list[str]()
    turns.prompt(lambda: gate.wait(60))
    failing: Future[float] = turns.prompt(lambda: 1 / 0)
    given_up = turns.prompt(lambda: done.append("given up"))
    assert given_up.cancel()
    last = turns.prompt(lambda: "last")
    gate.set()

    assert last.result(60) == "last"
    with pytest.raises(ZeroDivisionError):
        failing.result(60)
    assert done == []
    turns.close()
