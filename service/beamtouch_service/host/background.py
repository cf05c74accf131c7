"""Background tasks: progress for the watchdog, ticks that show a pause, new model files, outputs."""

import asyncio
import logging
from collections.abc import AsyncIterator, Callable, Coroutine, Iterable, Sequence
from contextlib import AbstractAsyncContextManager, AsyncExitStack, asynccontextmanager
from typing import Any

from beamtouch_common.systemd import ServiceManager
from beamtouch_service.api.context import Context
from beamtouch_service.host.model_watch import ModelKeeper
from beamtouch_service.surfaces import freshness

TICK_S = 1.0
"""Longest time between two looks at the model files, and between two reports of progress."""

Output = Callable[[Context], AbstractAsyncContextManager[None]]
"""Carries the contacts of an application elsewhere, during a block."""

_log = logging.getLogger("beamtouch.service")


def in_background(run: Callable[[Context], Coroutine[Any, Any, None]]) -> Output:
    """Return an output that runs as a task, until it is cancelled."""
    return lambda context: _running([run(context)])


@asynccontextmanager
async def _running(work: Iterable[Coroutine[Any, Any, None]]) -> AsyncIterator[None]:
    """Run coroutines during a block."""
    tasks = [asyncio.create_task(one) for one in work]
    for task in tasks:
        task.add_done_callback(_log_failure)
    try:
        yield
    finally:
        for task in tasks:
            task.cancel()
        await asyncio.gather(*tasks, return_exceptions=True)


class Background:
    """The tasks that run beside the routes."""

    def __init__(
        self,
        keepers: list[ModelKeeper],
        manager: ServiceManager,
        outputs: Sequence[Output] = (),
    ) -> None:
        self._keepers = keepers
        self._manager = manager
        self._outputs = outputs

    @asynccontextmanager
    async def running(self, context: Context) -> AsyncIterator[None]:
        """Run all tasks during a block."""
        work = self._report_progress(context), self._watch_models(), _tick(context)
        async with AsyncExitStack() as stack:
            await stack.enter_async_context(_running(work))
            for output in self._outputs:
                await stack.enter_async_context(output(context))
            yield

    async def _report_progress(self, context: Context) -> None:
        """Report progress to the manager while the loop turns and every surface can be asked.

        The same look lets the record become durable.
        """
        pause_s = min(TICK_S, (self._manager.watchdog_s or TICK_S) / 4)
        while True:
            for surface in context.registry:
                surface.summary(context.clock())
            context.recorder.maintain()
            self._manager.alive()
            await asyncio.sleep(pause_s)

    async def _watch_models(self) -> None:
        while True:
            await asyncio.sleep(TICK_S)
            await asyncio.gather(*(keeper.poll() for keeper in self._keepers))


async def _tick(context: Context) -> None:
    while True:
        context.ticks.tick(context.clock())
        await asyncio.sleep(freshness.TICK_S)


def _log_failure(task: asyncio.Task[None]) -> None:
    if not task.cancelled() and task.exception() is not None:
        _log.critical("a background task failed", exc_info=task.exception())
