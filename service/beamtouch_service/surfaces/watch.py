"""Waits until a listener is to be told about surfaces, at its pace."""

import asyncio
from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack, contextmanager

from beamtouch_service.surfaces.pace import Pace
from beamtouch_service.surfaces.surface import Surface


class Watch:
    """Follows surfaces for one listener. A sample of a surface that is not due yet costs a comparison."""

    def __init__(self, surfaces: Sequence[Surface], pace: Pace, clock: Callable[[], float]) -> None:
        self._surfaces, self._pace, self._clock = surfaces, pace, clock
        self._news = asyncio.Event()

    @contextmanager
    def listening(self) -> Iterator[None]:
        """Hear of new samples during a block."""
        with ExitStack() as stack:
            for surface in self._surfaces:
                stack.enter_context(surface.moves.told(self._note))
            yield

    async def wait(self) -> None:
        """Wait until a surface may be due, or `wake` was called."""
        try:
            async with asyncio.timeout(self._pace.wait_s(self._clock())):
                await self._news.wait()
        except TimeoutError:
            pass
        self._news.clear()

    def wake(self) -> None:
        """End the wait."""
        self._news.set()

    def due(self) -> list[Surface]:
        """Return the surfaces that are due now."""
        return self._pace.due(self._clock())

    def take_due(self) -> list[Surface]:
        """Return the surfaces that are due now, about which the listener is told with this."""
        now_s = self._clock()
        due = self._pace.due(now_s)
        self._pace.note_told(due, now_s)
        return due

    def _note(self, surface: Surface) -> None:
        if not self._news.is_set() and self._pace.has_news(surface, self._clock()):
            self._news.set()
