"""uvicorn as it comes, behind an address that may come later."""

import asyncio
import gc
import logging
import signal
import socket
import sys
from collections.abc import Callable
from types import FrameType

import uvicorn
from starlette.types import ASGIApp

from beamtouch_common.commands import announce
from beamtouch_common.systemd import ServiceManager
from beamtouch_service.api.context import Context
from beamtouch_service.host.background import Background
from beamtouch_service.host.listener import Address
from beamtouch_service.limits import SeldomFilter
from beamtouch_service.settings import TlsFiles

SHUTDOWN_S = 2
"""Time for running answers to finish. A sender repeats what was not acknowledged."""
IDLE_S = 75
"""A connection is closed this long after its last answer. Clients that poll do so more often."""


class Server(uvicorn.Server):
    """Says when it listens, and when it begins to stop."""

    def __init__(self, config: uvicorn.Config, on_start: Callable[[], None], on_stop: Callable[[], None]) -> None:
        super().__init__(config)
        self._on_start, self._on_stop = on_start, on_stop

    async def startup(self, sockets: list[socket.socket] | None = None) -> None:
        """Start to take connections."""
        await super().startup(sockets)
        self._on_start()

    async def shutdown(self, sockets: list[socket.socket] | None = None) -> None:
        """Stop, after the running answers. A stream does not end by itself."""
        self._on_stop()
        await super().shutdown(sockets)


def configure(app: ASGIApp, tls: TlsFiles | None = None) -> uvicorn.Config:
    """Return the configuration of uvicorn."""
    return uvicorn.Config(
        app,
        http="httptools",
        ws="none",
        lifespan="off",
        log_config=None,
        log_level=logging.WARNING,
        access_log=False,
        server_header=False,
        # The client is the peer of the connection, whatever a header says.
        proxy_headers=False,
        timeout_graceful_shutdown=SHUTDOWN_S,
        timeout_keep_alive=IDLE_S,
        ssl_certfile=tls.certificate if tls else None,
        ssl_keyfile=tls.key if tls else None,
        # Not at the terminal.
        ssl_keyfile_password="" if tls else None,
    )


def serve(
    config: uvicorn.Config, address: Address, context: Context, background: Background, manager: ServiceManager
) -> None:
    """Serve until SIGTERM (then SystemExit 0) or Ctrl-C (then KeyboardInterrupt)."""
    # uvicorn shuts down on a signal and then raises it again.
    signal.signal(signal.SIGTERM, _exit_quietly)
    # Clients can provoke any number of its messages.
    logging.getLogger("uvicorn.error").addFilter(SeldomFilter())
    # Objects that exist now stay for good. Searching them for garbage again and again would delay answers.
    gc.collect()
    gc.freeze()
    asyncio.run(_serve(config, address, context, background, manager))


async def _serve(
    config: uvicorn.Config, address: Address, context: Context, background: Background, manager: ServiceManager
) -> None:
    """Run the background tasks, and take connections once the address is there."""

    def note(reason: str) -> None:
        context.missing[address.section] = reason
        if reason:
            manager.ready(f"waiting: {reason}")

    def stop() -> None:
        manager.stopping()
        context.streams.stop.set()

    async with background.running(context):
        listener = await address.listener(note)
        host, port = listener.getsockname()[:2]
        shown = f"[{host}]" if listener.family is socket.AF_INET6 else host
        words = f"listening on {'https' if config.is_ssl else 'http'}://{shown}:{port}"

        def start() -> None:
            announce(words)
            manager.ready(words)

        await Server(config, start, stop).serve([listener])


def _exit_quietly(_signal: int, _frame: FrameType | None) -> None:
    sys.exit(0)
