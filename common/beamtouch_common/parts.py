"""The parts of a program that run until it stops. One that fails is begun again, and named until it has recovered."""

from __future__ import annotations

import asyncio
from contextlib import contextmanager
from typing import TYPE_CHECKING

from beamtouch_common.log_lines import Repeated
from beamtouch_common.waits import Backoff

if TYPE_CHECKING:
    import logging
    from collections.abc import Awaitable, Callable, Iterator

FIRST_PAUSE_S, LONGEST_PAUSE_S = 1.0, 30.0
"""Pause before a part is begun again: doubled with each failure, so that a part that fails always disturbs no other."""


class Parts:
    """Keeps parts running. Each is named while it fails."""

    def __init__(self, logger: logging.Logger) -> None:
        self.failing: dict[str, str] = {}
        """Part -> the error that ended it; empty once it has recovered."""
        self.failures: dict[str, int] = {}
        """Part -> how often an error ended it."""
        self._logger = logger
        self._attempts = Repeated(logger)
        self._attempted: dict[str, dict[str, str]] = {}
        """Part -> for whom its last attempt failed, and with what error."""

    async def keep(
        self, name: str, work: Callable[[], Awaitable[None]], expected: type[Exception] | tuple[()] = ()
    ) -> None:
        """Run a part to its end, and begin it again after each error that is not an expected one.

        `work` must be able to begin again in the same process.
        """
        self.failures.setdefault(name, 0)
        backoff, repeated = Backoff(FIRST_PAUSE_S, LONGEST_PAUSE_S), Repeated(self._logger)
        while True:
            steady = asyncio.get_running_loop().call_later(backoff.steady_s, self._recover, name, backoff)
            try:
                await work()
                self._recover(name, backoff)
                return
            except expected:
                raise
            except Exception as error:  # noqa: BLE001  # a fault of one part must not stop the others
                pause_s = backoff.next()
                self._note(name, error, pause_s, repeated)
            finally:
                steady.cancel()
            await asyncio.sleep(pause_s)

    @contextmanager
    def attempt(self, name: str, whose: str = "") -> Iterator[None]:
        """Go on after an error of a part that works in this block, and is called again and again.

        It is named until it succeeds for everybody (`whose`, such as a surface) for whom it failed.
        """
        failed = self._attempted.setdefault(name, {})
        of_whom = f"{name} of {whose}" if whose else name
        try:
            yield
        except Exception as error:  # a fault of one part must not stop the others
            self.failures[name] = self.failures.get(name, 0) + 1
            failed[whose] = f"unexpected error ({error!r})"
            words = f"{of_whom}: unexpected error; all else goes on"
            if line := self._attempts.line_if_due(words, f"{of_whom} {error!r}"):
                self._logger.critical("%s", line, exc_info=error)
        else:
            if failed.pop(whose, "") and (line := self._attempts.line_if_due(f"{of_whom}: runs again")):
                self._logger.info("%s", line)
        if failed or name in self.failing:
            self.failing[name] = next(iter(failed.values()), "")

    def _note(self, name: str, error: Exception, pause_s: float, repeated: Repeated) -> None:
        self.failures[name] += 1
        first = _first(error)
        self.failing[name] = f"unexpected error ({first!r}); restarting"
        if line := repeated.line_if_due(f"{name}: unexpected error; restarting in {pause_s:g} s", repr(first)):
            self._logger.critical("%s", line, exc_info=error)

    def _recover(self, name: str, backoff: Backoff) -> None:
        backoff.reset()
        if self.failing.get(name):
            self._note_recovery(name)

    def _note_recovery(self, name: str) -> None:
        self._logger.info("%s: runs again", name)
        self.failing[name] = ""


def _first(error: Exception) -> Exception:
    """Return the first of several errors that came together."""
    while isinstance(error, ExceptionGroup):
        error = error.exceptions[0]
    return error
