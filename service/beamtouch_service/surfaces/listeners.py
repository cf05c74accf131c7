"""Listeners to what happens on a surface: any number of them, none of which can hinder it or another one."""

import logging
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Generic, TypeVar

from beamtouch_common.log_lines import Repeated

_T = TypeVar("_T")
_log = logging.getLogger(__name__)


class Listeners(Generic[_T]):
    """Tells each listener, in the order in which they came."""

    def __init__(self) -> None:
        self._listeners: list[Callable[[_T], None]] = []
        self._failures = Repeated(_log)

    def add(self, listener: Callable[[_T], None]) -> None:
        """Tell this one from now on."""
        self._listeners.append(listener)

    @contextmanager
    def told(self, listener: Callable[[_T], None]) -> Iterator[None]:
        """Tell this one while the block runs."""
        self._listeners.append(listener)
        try:
            yield
        finally:
            self._listeners.remove(listener)

    def tell(self, value: _T) -> None:
        """Tell all of them. An error of one is logged: the others, and the answer, do not depend on it."""
        for listener in tuple(self._listeners):
            try:
                listener(value)
            except Exception as error:  # noqa: BLE001  # a fault of one listener must not stop the others
                if line := self._failures.line_if_due("a listener to a surface: unexpected error", repr(error)):
                    _log.critical("%s", line, exc_info=error)
