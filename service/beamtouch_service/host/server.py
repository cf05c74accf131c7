"""Sets up the process: models, socket, application, background tasks."""

import logging
from ipaddress import ip_address

from beamtouch_common.systemd import ServiceManager
from beamtouch_models.modelfile import ModelFileError
from beamtouch_service.api.app import create_app
from beamtouch_service.api.context import Streams
from beamtouch_service.config import ConfigError
from beamtouch_service.events.file import EventStoreError
from beamtouch_service.events.recorder import Recorder
from beamtouch_service.host import model_watch, tls
from beamtouch_service.host.background import Background
from beamtouch_service.host.handshakes import Handshakes, TlsListener
from beamtouch_service.host.listener import bind, resolve
from beamtouch_service.host.model_watch import ModelKeeper
from beamtouch_service.host.systemd import activated
from beamtouch_service.host.uvicorn_host import Host, configure, serve
from beamtouch_service.settings import Settings, SurfaceSettings
from beamtouch_service.surfaces.surface import Surface

_log = logging.getLogger("beamtouch.service")


def run(settings: Settings) -> None:
    """Serve until SIGTERM or Ctrl-C; raises ConfigError when the settings turn out not to work on this machine."""
    passed = activated()
    family, address = resolve(settings.host) if passed is None else (passed.family, str(passed.getsockname()[0]))
    _require_tokens(settings, address)
    if settings.tls is not None:
        tls.require(settings.tls)
    kept = [_surface(entry) for entry in settings.surfaces]
    with passed or bind(family, address, settings.port) as listener:
        logging.basicConfig(level=logging.INFO, format="%(asctime)s %(levelname)s %(name)s: %(message)s")
        _log_limits(settings, address)
        manager = ServiceManager()
        keepers = {surface.name: keeper for surface, keeper in kept if keeper is not None}
        background = Background(list(keepers.values()), manager, settings.tls)
        streams, recorder = Streams(settings.max_streams), _recorder(settings)
        app = create_app(
            [surface for surface, _ in kept],
            settings.access,
            keepers=keepers,
            max_batches_per_s=settings.max_batches_per_s,
            streams=streams,
            recorder=recorder,
            lifespan=background.lifespan,
        )
        handshakes = Handshakes()
        config = configure(
            app, settings.max_clients, settings.max_clients_per_address, settings.tls, handshakes=handshakes
        )
        config.load()
        background.ssl = config.ssl
        try:
            host = Host(config, manager, streams)
            serve(host, TlsListener(listener, handshakes) if settings.tls else listener)
        finally:
            recorder.close()


def _recorder(settings: Settings) -> Recorder:
    events = settings.events
    try:
        return Recorder(events.url or events.file, events.keep_days, events.max_mb, replica=settings.replica)
    except EventStoreError as error:
        raise ConfigError(str(error)) from None


def _require_tokens(settings: Settings, address: str) -> None:
    if _is_loopback(address):
        return
    needed = {"--write-token-file": settings.access.write, "--read-token-file": settings.access.read}
    missing = [f"{option} FILE" for option, token in needed.items() if token is None]
    if missing:
        message = (
            f"{address} is open to the network, which requires a write token and a read token: "
            f"add {' and '.join(missing)}, or use 127.0.0.1"
        )
        raise ConfigError(message)


def _is_loopback(address: str) -> bool:
    # Without the scope that follows a link-local address.
    return ip_address(address.partition("%")[0]).is_loopback


def _surface(entry: SurfaceSettings) -> tuple[Surface, ModelKeeper | None]:
    if entry.model is None:
        return Surface(entry.name, None, entry.stale_ms, entry.unexplained_after_s), None
    try:
        model, digest = model_watch.load(entry.model)
    except ModelFileError as error:
        message = f"model {error}"
        raise ConfigError(message) from None
    name = entry.name or model.metadata.name
    surface = Surface(name, model, entry.stale_ms, entry.unexplained_after_s)
    return surface, ModelKeeper(surface, entry.model, digest)


def _log_limits(settings: Settings, address: str) -> None:
    if settings.access.write is None:
        _log.warning("no write token: every write is refused; start with --write-token-file FILE to allow writes")
    if not settings.surfaces:
        _log.warning("no surface: the service has no contact to give; start with --model MODEL or --config FILE")
    if settings.tls is None and not _is_loopback(address):
        _log.warning("no TLS: others on the network can read the tokens; see certificate_file and key_file")
