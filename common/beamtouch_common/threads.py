"""Threads for calls that may never return, as of a database or a broker. The end of the process waits for none of them.

The end of the process waits for what `asyncio.to_thread` runs, so that is for calls that end soon by themselves. A
`ThreadPoolExecutor` is for calls that must be finished, as those of the daemon's log file.
"""

import asyncio
import threading
from collections.abc import Callable
from contextlib import suppress
from functools import partial
from queue import SimpleQueue
from typing import TypeVar

_T = TypeVar("_T")


def in_thread(call: Callable[[], _T]) -> "asyncio.Future[_T]":
    """Run a call in a thread of its own."""
    answer, work = _promise(call)
    threading.Thread(target=work, daemon=True).start()
    return answer


class Workers:
    """Threads that run calls in the order in which they come: one thread runs them one after another."""

    def __init__(self, name: str, threads: int = 1) -> None:
        self._name, self._threads = name, threads
        self._calls: SimpleQueue[Callable[[], None] | None] = SimpleQueue()
        self._is_started = False

    def run(self, call: Callable[[], _T]) -> "asyncio.Future[_T]":
        """Run a call after those that came before it. One that is cancelled before its turn does not run."""
        answer, work = _promise(call)
        self.post(work)
        return answer

    def post(self, call: Callable[[], None]) -> None:
        """Run a call after those that came before it. Nobody gets its answer."""
        self._start()
        self._calls.put(call)

    def end(self) -> None:
        """End the threads after the calls that came so far."""
        for _ in range(self._threads if self._is_started else 0):
            self._calls.put(None)
        self._is_started = False

    def _start(self) -> None:
        if not self._is_started:
            self._is_started = True
            for _ in range(self._threads):
                threading.Thread(target=self._work, name=self._name, daemon=True).start()

    def _work(self) -> None:
        while work := self._calls.get():
            work()


def _promise(call: Callable[[], _T]) -> "tuple[asyncio.Future[_T], Callable[[], None]]":
    """Return the answer to a call, and what a thread does to give it."""
    loop = asyncio.get_running_loop()
    answer: asyncio.Future[_T] = loop.create_future()

    def deliver(give: Callable[[], None]) -> None:
        if not answer.done():
            give()

    def work() -> None:
        if answer.cancelled():
            return
        try:
            give = partial(answer.set_result, call())
        except Exception as error:  # noqa: BLE001  # the caller gets it
            give = partial(answer.set_exception, error)
        with suppress(RuntimeError):  # the event loop may be closed
            loop.call_soon_threadsafe(deliver, give)

    return answer, work
