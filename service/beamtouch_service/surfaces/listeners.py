"""Those who are told when something happens on a surface: any number of them."""

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Generic, TypeVar

_T = TypeVar("_T")


class Listeners(Generic[_T]):
    """Tells each listener, in the order in which they came."""

    def __init__(self) -> None:
        self._listeners: list[Callable[[_T], None]] = []

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
        """Tell all of them."""
        for listener in tuple(self._listeners):
            listener(value)
