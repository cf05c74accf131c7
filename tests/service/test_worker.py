"""The worker thread and its two queues."""

from __future__ import annotations

from concurrent.futures import Future
from functools import partial
from threading import Event

import pytest

from beamtouch_service.events.worker import Worker


def test_prompt_tasks_overtake_late_ones_and_both_keep_their_order() -> None:
    worker, gate, done = Worker("test"), Event(), list[str]()
    worker.prompt(lambda: gate.wait(60))
    for name in "abc":
        worker.late(partial(done.append, name))
    for name in "123":
        worker.prompt(partial(done.append, name))
    gate.set()
    worker.close()

    assert "".join(done) == "123abc"


def test_a_late_task_is_done_although_prompt_ones_keep_coming() -> None:
    worker, gate, done = Worker("test"), Event(), list[str]()
    worker.prompt(lambda: gate.wait(60))
    worker.late(lambda: done.append("late"))
    for _ in range(50):
        worker.prompt(lambda: done.append("prompt"))
    gate.set()
    worker.close()

    assert len(done) == 51
    assert done.index("late") < 20


def test_an_error_reaches_the_caller_and_a_cancelled_task_is_not_done() -> None:
    worker, gate, done = Worker("test"), Event(), list[str]()
    worker.prompt(lambda: gate.wait(60))
    failing: Future[float] = worker.prompt(lambda: 1 / 0)
    given_up = worker.prompt(lambda: done.append("given up"))
    assert given_up.cancel()
    last = worker.prompt(lambda: "last")
    gate.set()

    assert last.result(60) == "last"
    with pytest.raises(ZeroDivisionError):
        failing.result(60)
    assert done == []
    worker.close()


def test_a_task_that_comes_after_the_end_is_cancelled() -> None:
    worker = Worker("test")
    worker.close()
    assert worker.late(lambda: 1).cancelled()
    assert worker.prompt(lambda: 1).cancelled()
