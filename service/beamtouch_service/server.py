"""From settings to a process that listens: models, socket, uvicorn, signals."""

import logging
import signal
import socket
import sys
from errno import EACCES, EADDRINUSE, EADDRNOTAVAIL
from ipaddress import ip_address
from types import FrameType

import uvicorn
from fastapi import FastAPI
from starlette.types import Scope

from beamtouch_models import modelfile
from beamtouch_service.app import create_app
from beamtouch_service.config import ConfigError, Settings, SurfaceSettings
from beamtouch_service.contact import LOG_ODDS
from beamtouch_service.event_store import EventStoreError
from beamtouch_service.recorder import Recorder
from beamtouch_service.streams import Streams
from beamtouch_service.surface import Surface

_SHUTDOWN_S = 2
"""For answers under way to finish; a sender repeats what was not acknowledged."""
_SEND_BUFFER_BYTES = 128 * 1024

_log = logging.getLogger("beamtouch.service")


def run(settings: Settings) -> None:
    """Serve until SIGTERM or Ctrl-C; raises ConfigError when the settings turn out not to work on this machine."""
    family, address = resolve(settings.host)
    if settings.token is None and not ip_address(address).is_loopback:
        message = f"{settings.host} is open to the network; that needs a token: add --token-file FILE, or use 127.0.0.1"
        raise ConfigError(message)
    surfaces = [_surface(entry) for entry in settings.surfaces]
    with bind(family, address, settings.port) as listener:
        logging.basicConfig(level=logging.INFO, format="%(asctime)s %(levelname)s %(name)s: %(message)s")
        _log_limits(settings)
        streams, recorder = Streams(settings.max_streams), _recorder(settings)
        try:
            serve(create_app(surfaces, settings.token, streams=streams, recorder=recorder), listener, streams)
        finally:
            recorder.close()


def _recorder(settings: Settings) -> Recorder:
    events = settings.events
    try:
        return Recorder(events.file, events.keep_days, events.most_mb)
    except EventStoreError as error:
        message = f"events file {error}; set events.file to one that the service can write"
        raise ConfigError(message) from None


def _surface(entry: SurfaceSettings) -> Surface:
    if entry.model is None:
        return Surface(entry.name, None, entry.stale_ms)
    try:
        model = modelfile.load(entry.model)
    except modelfile.ModelFileError as error:
        message = f"model {error}"
        raise ConfigError(message) from None
    if LOG_ODDS not in model.outputs:
        # Without it a position would be stated of a beam that nothing touches.
        message = (
            f"model {entry.model}: it has no output {LOG_ODDS}, so it cannot tell contact from clear; build another"
        )
        raise ConfigError(message)
    return Surface(entry.name or model.metadata.name, model, entry.stale_ms)


def _log_limits(settings: Settings) -> None:
    if settings.token is None:
        _log.warning("no token: every write is refused; start with --token-file FILE to allow writes")
    if not settings.surfaces:
        _log.warning("no surface: there is no contact to ask for; start with --model MODEL or --config FILE")


def resolve(host: str) -> tuple[socket.AddressFamily, str]:
    """Return family and numeric address of a host, IPv4 where it has both; raises ConfigError if it has none."""
    try:
        found = socket.getaddrinfo(host, None, type=socket.SOCK_STREAM)
    except (OSError, UnicodeError):
        message = f"host {host!r} is no address of this machine; use 127.0.0.1, or an address that `ip address` shows"
        raise ConfigError(message) from None
    family, _, _, _, address = min(found, key=lambda entry: entry[0] is not socket.AF_INET)
    return family, str(address[0])


def bind(family: socket.AddressFamily, address: str, port: int) -> socket.socket:
    """Return a socket bound to the address; raises ConfigError if it is taken, forbidden or elsewhere."""
    # The protocol is spelled out because asyncio turns Nagle's algorithm off only where it sees TCP: 40 ms an answer.
    listener = socket.socket(family, socket.SOCK_STREAM, socket.IPPROTO_TCP)
    # A service that was just stopped must be able to start again.
    listener.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
    # Inherited by connections: what a client leaves unread occupies no more than this, and is soon noticed.
    listener.setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, _SEND_BUFFER_BYTES)
    try:
        listener.bind((address, port))
        listener.listen()
    except OSError as error:
        listener.close()
        remedies = {
            EADDRINUSE: "in use; stop what listens there, or choose another with --port",
            EACCES: "not allowed for this user; choose one above 1023 with --port",
            EADDRNOTAVAIL: "not on this machine; use 127.0.0.1, or an address that `ip address` shows",
        }
        message = f"port {port} on {address}: {remedies.get(error.errno or 0, error.strerror)}"
        raise ConfigError(message) from None
    return listener


class _Announcing(uvicorn.Server):
    """Says where it listens once a stop signal would be heeded and a request answered, and ends streams with itself."""

    def __init__(self, config: uvicorn.Config, streams: Streams) -> None:
        super().__init__(config)
        self._streams = streams
        streams.drop = self._drop

    async def shutdown(self, sockets: list[socket.socket] | None = None) -> None:
        # Before the server waits for answers under way: a stream would never end by itself.
        self._streams.stop.set()
        await super().shutdown(sockets)

    def _drop(self, scope: Scope) -> None:
        # Closing would wait until the client has read what was sent to it, and it does not read.
        for connection in self.server_state.connections:
            peer = connection.transport.get_extra_info("peername")
            if peer and tuple(peer[:2]) == tuple(scope.get("client") or ()):
                connection.transport.abort()

    async def startup(self, sockets: list[socket.socket] | None = None) -> None:
        await super().startup(sockets)
        for listener in sockets or []:
            host, port = listener.getsockname()[:2]
            shown = f"[{host}]" if listener.family is socket.AF_INET6 else host
            print(f"listening on http://{shown}:{port}", flush=True)


def serve(app: FastAPI, listener: socket.socket, streams: Streams) -> None:
    """Serve `app` on a listening socket until SIGTERM (then SystemExit 0) or Ctrl-C (then KeyboardInterrupt)."""
    # uvicorn shuts down on a signal and then raises it again for whoever is around it.
    signal.signal(signal.SIGTERM, _exit_quietly)
    config = uvicorn.Config(
        app,
        http="h11",
        ws="none",
        loop="asyncio",
        lifespan="off",
        log_config=None,
        log_level=logging.WARNING,
        access_log=False,
        server_header=False,
        # A client is who is connected, whatever a header says.
        proxy_headers=False,
        timeout_graceful_shutdown=_SHUTDOWN_S,
    )
    _Announcing(config, streams).run(sockets=[listener])


def _exit_quietly(_signal: int, _frame: FrameType | None) -> None:
    sys.exit(0)
