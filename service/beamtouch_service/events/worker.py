"""A single worker thread with a prompt and a late queue."""

from collections import deque
from collections.abc import Callable
from concurrent.futures import Future, ThreadPoolExecutor
from threading import Lock
from typing import TypeVar

_LATE_SHARE = 20
"""One task in this many is taken from the late queue first, so that late tasks always progress."""

_T = TypeVar("_T")


class Worker:
    """Runs tasks one at a time. The queues are unbounded: callers limit what they add."""

    def __init__(self, name: str) -> None:
        self._thread = ThreadPoolExecutor(1, name)
        # A task is queued before its run is submitted, and only the thread takes tasks: each run finds one.
        self._prompt: deque[Callable[[], None]] = deque()
        self._late: deque[Callable[[], None]] = deque()
        self._count = 0
        self._lock = Lock()
        self._is_closed = False

    def prompt(self, task: Callable[[], _T]) -> "Future[_T]":
        """Run this after the prompt tasks so far, and before late ones."""
        return self._add(self._prompt, task)

    def late(self, task: Callable[[], _T]) -> "Future[_T]":
        """Run this after the late tasks so far, when no prompt task waits or a late one is due."""
        return self._add(self._late, task)

    def close(self) -> None:
        """Run the tasks so far, then end the thread. Later tasks are cancelled."""
        with self._lock:
            self._is_closed = True
        self._thread.shutdown()

    def _add(self, queue: deque[Callable[[], None]], task: Callable[[], _T]) -> "Future[_T]":
        answer: Future[_T] = Future()

        def run() -> None:
            # The caller may have cancelled it.
            if answer.set_running_or_notify_cancel():
                try:
                    answer.set_result(task())
                except BaseException as error:  # noqa: BLE001  # the caller gets it
                    answer.set_exception(error)

        with self._lock:
            if self._is_closed:
                answer.cancel()
            else:
                queue.append(run)
                self._thread.submit(self._next)
        return answer

    def _next(self) -> None:
        self._count += 1
        queues = (self._prompt, self._late) if self._count % _LATE_SHARE else (self._late, self._prompt)
        (queues[0] or queues[1]).popleft()()
