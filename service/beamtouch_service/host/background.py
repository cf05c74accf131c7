"""Background tasks: progress for the watchdog, new model files, SIGHUP."""

import asyncio
import logging
import signal
import ssl
from collections.abc import AsyncIterator, Callable, Coroutine, Iterable, Sequence
from contextlib import AbstractAsyncContextManager, AsyncExitStack, asynccontextmanager
from typing import Any

from beamtouch_common.systemd import ServiceManager
from beamtouch_service.api.app import Application
from beamtouch_service.api.context import Context
from beamtouch_service.host import tls
from beamtouch_service.host.model_watch import ModelKeeper
from beamtouch_service.settings import TlsFiles

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
    """The tasks that run in the lifespan of the application."""

    def __init__(
        self,
        keepers: list[ModelKeeper],
        manager: ServiceManager,
        files: TlsFiles | None,
        outputs: Sequence[Output] = (),
    ) -> None:
        self._keepers = keepers
        self._manager = manager
        self._files = files
        self._outputs = outputs
        self.ssl: ssl.SSLContext | None = None
        """Context of the connections. The server makes it after the application."""

    @asynccontextmanager
    async def lifespan(self, app: Application) -> AsyncIterator[None]:
        """Run all tasks until the application ends."""
        told, loop = asyncio.Event(), asyncio.get_running_loop()
        work = self._report_progress(app.context), self._watch_models(), self._reload_when_told(told)
        async with AsyncExitStack() as stack:
            await stack.enter_async_context(_running(work))
            loop.add_signal_handler(signal.SIGHUP, told.set)
            # The handler must not be called in a closed loop.
            stack.callback(loop.remove_signal_handler, signal.SIGHUP)
            for output in self._outputs:
                await stack.enter_async_context(output(app.context))
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

    async def _reload_when_told(self, told: asyncio.Event) -> None:
        """Read every model file and the certificate again at SIGHUP. A wrong file changes nothing."""
        while True:
            await told.wait()
            told.clear()
            self._manager.reloading()
            self._reload_certificate()
            await asyncio.gather(*(keeper.reload() for keeper in self._keepers))
            self._manager.ready("models read again")

    def _reload_certificate(self) -> None:
        if self._files is None or self.ssl is None:
            return
        try:
            tls.load(self.ssl, self._files)
        except (ssl.SSLError, OSError) as error:
            _log.error("the new certificate cannot be used; the old one stays in use: %s", error)


def _log_failure(task: asyncio.Task[None]) -> None:
    if not task.cancelled() and task.exception() is not None:
        _log.critical("a background task failed", exc_info=task.exception())
