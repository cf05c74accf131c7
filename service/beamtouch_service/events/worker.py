"""One thread that does one thing after another: what is prompt in its order, and between that what may wait."""

from collections import deque
from collections.abc import Callable
from concurrent.futures import Future, ThreadPoolExecutor
from typing import TypeVar

_LATE_TURN = 20
"""One turn in so many is for what may wait, whatever else there is: nothing waits for ever."""

_T = TypeVar("_T")


class Turns:
    """Work for one thread. Whoever hands it over sees to it that there is not too much of it."""

    def __init__(self, name: str) -> None:
        self._thread = ThreadPoolExecutor(1, name)
        # Appended to before a turn is asked for, and taken from by the thread only: each turn finds something.
        self._prompt: deque[Callable[[], None]] = deque()
        self._late: deque[Callable[[], None]] = deque()
        self._count = 0

    def prompt(self, work: Callable[[], _T]) -> "Future[_T]":
        """Do this after all other prompt work, and before what may wait."""
        return self._add(self._prompt, work)

    def late(self, work: Callable[[], _T]) -> "Future[_T]":
        """Do this when there is nothing else to do, or it is its turn."""
        return self._add(self._late, work)

    def close(self) -> None:
        """Wait for all of it."""
        self._thread.shutdown()

    def _add(self, line: deque[Callable[[], None]], work: Callable[[], _T]) -> "Future[_T]":
        answer: Future[_T] = Future()

        def turn() -> None:
            # Nobody may want it any more.
            if answer.set_running_or_notify_cancel():
                try:
                    answer.set_result(work())
                except BaseException as error:  # noqa: BLE001  # for whoever waits for the answer
                    answer.set_exception(error)

        line.append(turn)
        self._thread.submit(self._next)
        return answer

    def _next(self) -> None:
        self._count += 1
        lines = (self._prompt, self._late) if self._count % _LATE_TURN else (self._late, self._prompt)
        (lines[0] or lines[1]).popleft()()
