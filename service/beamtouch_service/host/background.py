"""What goes on besides answering: progress for the watchdog, new models, reloading when told."""

import asyncio
import contextlib
import logging
import signal
import ssl

import uvicorn

from beamtouch_service.api.context import Context
from beamtouch_service.config import TlsFiles
from beamtouch_service.host import tls
from beamtouch_service.host.systemd import ServiceManager
from beamtouch_service.host.uvicorn_host import Work

TICK_S = 1.0
"""Model files are looked at, and progress is reported, this often at least."""

_log = logging.getLogger("beamtouch.service")


class Background:
    """The work beside the answers of one service."""

    def __init__(
        self, context: Context, manager: ServiceManager, config: uvicorn.Config, files: TlsFiles | None
    ) -> None:
        self._context = context
        self._manager = manager
        self._config = config
        self._files = files
        self.work: tuple[Work, ...] = (self._report_progress, self._watch_models, self._reload_when_told)

    async def _report_progress(self) -> None:
        """Tell the manager of progress: the loop turns, and every surface can be asked. If that raises, it ends.

        The same look ends the events of surfaces that became stale.
        """
        pause_s = min(TICK_S, (self._manager.watchdog_s or TICK_S) / 4)
        while True:
            for surface in self._context.registry:
                surface.summary(self._context.clock())
                surface.tell_if_stale(self._context.clock())
            if self._context.recorder:
                self._context.recorder.settle()
            self._manager.alive()
            await asyncio.sleep(pause_s)

    async def _watch_models(self) -> None:
        while True:
            await asyncio.sleep(TICK_S)
            await asyncio.gather(*(keeper.poll() for keeper in self._context.keepers.values()))

    async def _reload_when_told(self) -> None:
        """Read every model file, and the certificate, again at SIGHUP; what is wrong changes nothing."""
        told = asyncio.Event()
        loop = asyncio.get_running_loop()
        loop.add_signal_handler(signal.SIGHUP, told.set)
        with contextlib.closing(_Handler(loop)):
            while True:
                await told.wait()
                told.clear()
                self._manager.reloading()
                self._reload_certificate()
                await asyncio.gather(*(keeper.reload() for keeper in self._context.keepers.values()))
                self._manager.ready("models read again")

    def _reload_certificate(self) -> None:
        if self._files is None or self._config.ssl is None:
            return
        try:
            tls.load(self._config.ssl, self._files)
        except (ssl.SSLError, OSError) as error:
            _log.error("the new certificate is not used, the old one holds: %s", error)


class _Handler:
    """Takes the handler of SIGHUP away at the end: it must not be called in a loop that is closed."""

    def __init__(self, loop: asyncio.AbstractEventLoop) -> None:
        self._loop = loop

    def close(self) -> None:
        self._loop.remove_signal_handler(signal.SIGHUP)
