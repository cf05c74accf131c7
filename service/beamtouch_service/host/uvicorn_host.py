"""uvicorn with the bounds of this service, and its start and stop."""

import asyncio
import gc
import logging
import resource
import signal
import socket
import sys
import time
from collections.abc import Callable
from functools import partial
from types import FrameType
from typing import Any, cast

import uvicorn
from starlette.types import ASGIApp, Scope
from uvicorn.protocols.http.httptools_impl import HttpToolsProtocol

from beamtouch_common.commands import announce
from beamtouch_common.systemd import ServiceManager
from beamtouch_service.api.app import Application
from beamtouch_service.api.context import Streams, boot_clock
from beamtouch_service.host.admission import Clients, is_busy
from beamtouch_service.host.arrivals import Arrivals, Selector
from beamtouch_service.host.connection import BoundedProtocol
from beamtouch_service.host.handshakes import HANDSHAKE_S, Handshakes, TlsListener
from beamtouch_service.host.listener import Address
from beamtouch_service.host.places import Places
from beamtouch_service.limits import MAX_CLIENTS, Seldom, SeldomFilter
from beamtouch_service.settings import TlsFiles

SHUTDOWN_S = 2
"""Time for running answers to finish. A sender repeats what was not acknowledged."""
IDLE_S = 75
"""An idle connection is closed after this time. Clients that poll do so more often."""
_ACCEPTED_AT_ONCE = 16
"""New connections accepted in a row, so that a flood of them does not hold up the others."""
_QUEUE = 1024
"""New connections that the system keeps until they are accepted. Beyond this it does not answer."""
MAX_FILES = 8192
"""Open files: 4096 connections, handshakes, and what these and the service need besides."""

_log = logging.getLogger("beamtouch.service")


def configure(
    app: ASGIApp,
    max_clients: int = MAX_CLIENTS,
    max_clients_per_address: int | None = None,
    tls: TlsFiles | None = None,
    *,
    handshakes: Handshakes | None = None,
    arrivals: Arrivals | None = None,
) -> uvicorn.Config:
    """Return the configuration of uvicorn for `app`."""
    places = Places(max_clients, max_clients_per_address or max_clients, is_busy)
    arrivals = arrivals or Arrivals(boot_clock)
    clients = _clients(app, places, handshakes or Handshakes(), arrivals)
    return uvicorn.Config(
        app,
        # uvicorn only calls it, once for each connection. It calls `loop` too, unless that is a name.
        http=cast("type[asyncio.Protocol]", partial(BoundedProtocol, clients=clients)),
        ws="none",
        loop=cast("str", partial(Loop, arrivals)),
        lifespan="on",
        log_config=None,
        log_level=logging.WARNING,
        access_log=False,
        server_header=False,
        # The client is the peer of the connection, whatever a header says.
        proxy_headers=False,
        timeout_graceful_shutdown=SHUTDOWN_S,
        timeout_keep_alive=IDLE_S,
        backlog=_ACCEPTED_AT_ONCE,
        ssl_certfile=tls.certificate if tls else None,
        ssl_keyfile=tls.key if tls else None,
        ssl_keyfile_password="" if tls else None,
    )


def _clients(app: ASGIApp, places: Places[HttpToolsProtocol], handshakes: Handshakes, arrivals: Arrivals) -> Clients:
    if not isinstance(app, Application):
        return Clients(
            places, lambda _header: False, lambda _kind, _address: None, lambda _address: None, handshakes, arrivals.now
        )
    context = app.context
    return Clients(
        places, context.access.knows, context.counts.problem, context.counts.eviction, handshakes, arrivals.now
    )


class Loop(asyncio.SelectorEventLoop):
    """The usual event loop, with a deadline for TLS handshakes, and known arrivals."""

    _seldom = Seldom()

    def __init__(self, arrivals: Arrivals) -> None:
        super().__init__(Selector(arrivals))

    def call_exception_handler(self, context: dict[str, Any]) -> None:
        """Report an error as every loop does, but failures to accept a connection only once a minute."""
        if not context.get("message", "").startswith("socket.accept()"):
            super().call_exception_handler(context)
        elif self._seldom.due("accept", time.monotonic()):
            _log.error("no connection can be accepted: %s", context.get("exception"))

    async def create_server(self, *arguments: Any, **options: Any) -> asyncio.Server:  # noqa: ANN401  # as every loop's
        """Return a server as every loop does."""
        if options.get("ssl"):
            options["ssl_handshake_timeout"] = HANDSHAKE_S
        server: asyncio.Server = await super().create_server(*arguments, **options)
        return server


class Host(uvicorn.Server):
    """Listens once its address is there, and ends streams and unread answers, which would delay a stop.

    It reports start and stop to the service manager. The start is complete without the address: the outputs run.
    """

    def __init__(
        self,
        config: uvicorn.Config,
        manager: ServiceManager,
        streams: Streams,
        address: Address,
        handshakes: Handshakes | None = None,
    ) -> None:
        super().__init__(config)
        self._manager = manager
        self._streams = streams
        self._address = address
        self._handshakes = handshakes
        self._listening: asyncio.Task[None] | None = None
        streams.drop = self._drop

    async def startup(self, sockets: list[socket.socket] | None = None) -> None:
        """Start the application, and listen as soon as the address is there."""
        # Without sockets of its own, uvicorn listens nowhere.
        await super().startup(sockets or [])
        self._listening = asyncio.create_task(self._listen())

    async def _listen(self) -> None:
        """Listen, and log the address."""
        app, scheme = self.config.app, "https" if self.config.is_ssl else "http"

        def note(reason: str) -> None:
            if isinstance(app, Application):
                app.context.missing[self._address.section] = reason
            if reason:
                self._manager.ready(f"waiting: {reason}")

        listener = await self._address.listener(note)
        if self._handshakes is not None and self.config.is_ssl:
            listener = TlsListener(listener, self._handshakes)
        server = await asyncio.get_running_loop().create_server(
            self._protocol, sock=listener, ssl=self.config.ssl, backlog=self.config.backlog
        )
        self.servers.append(server)
        # asyncio made the queue as short as the number of connections it accepts at once.
        listener.listen(_QUEUE)
        host, port = listener.getsockname()[:2]
        shown = f"[{host}]" if listener.family is socket.AF_INET6 else host
        announce(f"listening on {scheme}://{shown}:{port}")
        self._manager.ready(f"listening on {scheme}://{shown}:{port}")

    def _protocol(self) -> asyncio.Protocol:
        """Return the protocol of a new connection, as uvicorn makes it."""
        make = cast("Callable[..., asyncio.Protocol]", self.config.http_protocol_class)
        return make(config=self.config, server_state=self.server_state, app_state=self.lifespan.state)

    async def shutdown(self, sockets: list[socket.socket] | None = None) -> None:
        """Stop."""
        self._manager.stopping()
        if self._listening is not None:
            self._listening.cancel()
            await asyncio.wait([self._listening])
        # Before the server waits for running answers: a stream does not end by itself.
        self._streams.stop.set()
        # Neither does an answer that nobody reads. Running answers get half of the time.
        asyncio.get_running_loop().call_later(SHUTDOWN_S / 2, self._abort_unread)
        await super().shutdown(sockets)

    def _abort_unread(self) -> None:
        for connection in list(self.server_state.connections):
            if isinstance(connection, BoundedProtocol) and connection.flow.write_paused:
                connection.transport.abort()

    def _drop(self, scope: Scope) -> None:
        # Closing would wait until the client has read everything, and it does not read.
        for connection in self.server_state.connections:
            peer = connection.transport.get_extra_info("peername")
            if peer and tuple(peer[:2]) == tuple(scope.get("client") or ()):
                connection.transport.abort()


def serve(host: Host) -> None:
    """Serve until SIGTERM (then SystemExit 0) or Ctrl-C (then KeyboardInterrupt)."""
    # uvicorn shuts down on a signal and then raises it again.
    signal.signal(signal.SIGTERM, _exit_quietly)
    # Until the loop handles it, SIGHUP must not end the process.
    signal.signal(signal.SIGHUP, signal.SIG_IGN)
    logging.getLogger("uvicorn.error").addFilter(SeldomFilter())
    # Many systems allow 1024 open files, and more on request.
    soft, hard = resource.getrlimit(resource.RLIMIT_NOFILE)
    max_files = MAX_FILES if hard == resource.RLIM_INFINITY else min(hard, MAX_FILES)
    if soft != resource.RLIM_INFINITY and soft < max_files:
        resource.setrlimit(resource.RLIMIT_NOFILE, (max_files, hard))
    # Objects that exist now stay for good. Searching them for garbage again and again would delay answers.
    gc.collect()
    gc.freeze()
    host.run()


def _exit_quietly(_signal: int, _frame: FrameType | None) -> None:
    sys.exit(0)
