"""uvicorn, with the bounds and the background work of this service."""

import asyncio
import gc
import logging
import signal
import socket
import sys
from collections.abc import Callable, Coroutine, Sequence
from functools import partial
from types import FrameType
from typing import Any, cast

import uvicorn
from starlette.types import ASGIApp, Scope

from beamtouch_service.api.stream import Streams
from beamtouch_service.config import TlsFiles
from beamtouch_service.defaults import MAX_CLIENTS_PER_ADDRESS
from beamtouch_service.host.connection import HEAD_S, BoundedProtocol
from beamtouch_service.host.places import Places
from beamtouch_service.host.systemd import ServiceManager
from beamtouch_service.limits import SeldomFilter

SHUTDOWN_S = 2
"""For answers under way to finish; a sender repeats what was not acknowledged."""

IDLE_S = 75
"""A connection on which nothing is asked for is closed: longer than anyone waits between two questions."""

_ACCEPTED_AT_ONCE = 16
"""Newcomers before the connections that are there are served again: a flood of newcomers holds up nobody."""
_QUEUE = 1024
"""Newcomers that the system keeps until they are accepted; to those beyond it, it does not answer."""

_log = logging.getLogger("beamtouch.service")

Work = Callable[[], Coroutine[Any, Any, None]]


def configure(
    app: ASGIApp,
    max_clients: int,
    tls: TlsFiles | None = None,
    *,
    max_clients_per_address: int = MAX_CLIENTS_PER_ADDRESS,
) -> uvicorn.Config:
    """Return how uvicorn is to serve `app`."""
    places = Places(max_clients, max_clients_per_address, BoundedProtocol.has_unread)
    return uvicorn.Config(
        app,
        # uvicorn only calls it, once for each connection.
        http=cast("type[asyncio.Protocol]", partial(BoundedProtocol, places=places)),
        ws="none",
        loop=f"{__name__}:Loop",
        lifespan="off",
        log_config=None,
        log_level=logging.WARNING,
        access_log=False,
        server_header=False,
        # A client is who is connected, whatever a header says.
        proxy_headers=False,
        timeout_graceful_shutdown=SHUTDOWN_S,
        timeout_keep_alive=IDLE_S,
        backlog=_ACCEPTED_AT_ONCE,
        ssl_certfile=tls.certificate if tls else None,
        ssl_keyfile=tls.key if tls else None,
        ssl_keyfile_password="" if tls else None,
    )


class Loop(asyncio.SelectorEventLoop):
    """The usual event loop, with a bound on clients that connect and do not get on with TLS."""

    async def create_server(self, *arguments: Any, **options: Any) -> asyncio.Server:  # noqa: ANN401  # as every loop's
        """Return a server as every loop does."""
        if options.get("ssl"):
            options["ssl_handshake_timeout"] = HEAD_S
        server: asyncio.Server = await super().create_server(*arguments, **options)
        return server


class Host(uvicorn.Server):
    """Says where it listens once a stop signal would be heeded and a request answered; works in the background."""

    def __init__(
        self, config: uvicorn.Config, manager: ServiceManager, streams: Streams, work: Sequence[Work] = ()
    ) -> None:
        super().__init__(config)
        self._manager = manager
        self._streams = streams
        streams.drop = self._drop
        self._work = work
        self._tasks: list[asyncio.Task[None]] = []

    async def startup(self, sockets: list[socket.socket] | None = None) -> None:
        """Listen, and tell."""
        await super().startup(sockets)
        for listener in sockets or []:
            # asyncio has made the queue as short as what it accepts at once.
            listener.listen(_QUEUE)
        self._tasks = [asyncio.create_task(work()) for work in self._work]
        for task in self._tasks:
            task.add_done_callback(_log_failure)
        scheme = "https" if self.config.is_ssl else "http"
        for listener in sockets or []:
            host, port = listener.getsockname()[:2]
            shown = f"[{host}]" if listener.family is socket.AF_INET6 else host
            print(f"listening on {scheme}://{shown}:{port}", flush=True)
            self._manager.ready(f"listening on {scheme}://{shown}:{port}")

    async def shutdown(self, sockets: list[socket.socket] | None = None) -> None:
        """Tell, and end."""
        self._manager.stopping()
        # Before the server waits for answers under way: a stream would never end by itself.
        self._streams.stop.set()
        # Nor would one that nobody reads; what is under way gets half of the time.
        asyncio.get_running_loop().call_later(SHUTDOWN_S / 2, self._abort_unread)
        for task in self._tasks:
            task.cancel()
        await asyncio.gather(*self._tasks, return_exceptions=True)
        await super().shutdown(sockets)

    def _abort_unread(self) -> None:
        for connection in list(self.server_state.connections):
            if isinstance(connection, BoundedProtocol) and connection.flow.write_paused:
                connection.transport.abort()

    def _drop(self, scope: Scope) -> None:
        # Closing would wait until the client has read what was sent to it, and it does not read.
        for connection in self.server_state.connections:
            peer = connection.transport.get_extra_info("peername")
            if peer and tuple(peer[:2]) == tuple(scope.get("client") or ()):
                connection.transport.abort()


def serve(host: Host, listener: socket.socket) -> None:
    """Serve on a listening socket until SIGTERM (then SystemExit 0) or Ctrl-C (then KeyboardInterrupt)."""
    # uvicorn shuts down on a signal and then raises it again for whoever is around it.
    signal.signal(signal.SIGTERM, _exit_quietly)
    # Until the loop heeds it, it must not end the process.
    signal.signal(signal.SIGHUP, signal.SIG_IGN)
    logging.getLogger("uvicorn.error").addFilter(SeldomFilter())
    # What is there now stays; looking through it again and again for garbage would hold up answers.
    gc.collect()
    gc.freeze()
    host.run(sockets=[listener])


def _log_failure(task: asyncio.Task[None]) -> None:
    if not task.cancelled() and task.exception() is not None:
        _log.critical("a part of the service failed", exc_info=task.exception())


def _exit_quietly(_signal: int, _frame: FrameType | None) -> None:
    sys.exit(0)
