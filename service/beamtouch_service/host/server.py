"""Sets up the process: models, socket, application, background tasks."""

from __future__ import annotations

import logging
import ssl
from contextlib import ExitStack, contextmanager
from functools import partial
from ipaddress import ip_address
from typing import TYPE_CHECKING

from beamtouch_common.errors import FailedError
from beamtouch_common.systemd import ServiceManager
from beamtouch_models.modelfile import ModelFileError
from beamtouch_service.api.app import create_app
from beamtouch_service.api.context import Streams
from beamtouch_service.config import ConfigError
from beamtouch_service.events.database import EventStoreError
from beamtouch_service.events.recorder import Recorder
from beamtouch_service.host import model_watch
from beamtouch_service.host.background import Background, in_background
from beamtouch_service.host.listener import Address
from beamtouch_service.host.model_watch import ModelKeeper
from beamtouch_service.host.serve import configure, serve
from beamtouch_service.settings import MqttSettings, Settings, SurfaceSettings, TlsFiles
from beamtouch_service.surfaces.surface import Surface

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator

    from beamtouch_service.host.modbus import ModbusServer
    from beamtouch_service.outputs.mqtt.publisher import Publisher

_log = logging.getLogger("beamtouch.service")


def run(settings: Settings) -> None:
    """Serve until SIGTERM or Ctrl-C; raises ConfigError if the settings do not work on this machine."""
    if settings.tls is not None:
        _require_certificate(settings.tls)
    outputs = [in_background(_publisher(settings.mqtt).run)] if settings.mqtt else []
    kept = [_surface(entry) for entry in settings.surfaces]
    with ExitStack() as stack:
        require = partial(_require_tokens, settings)
        address = Address("server", settings.host, settings.port, require=require)
        stack.callback(address.close)
        modbus = _modbus_server(settings)
        logging.basicConfig(level=logging.INFO, format="%(asctime)s %(levelname)s %(name)s: %(message)s")
        _log_limits(settings, address.shown, [surface for surface, _ in kept])
        if modbus is not None:
            stack.callback(modbus.address.close)
            outputs.append(in_background(modbus.run))
            _log_readers(settings, modbus)
        manager = ServiceManager()
        background = Background([keeper for _, keeper in kept if keeper is not None], manager, outputs)
        streams, recorder = Streams(settings.max_streams), _recorder(settings)
        app = create_app([surface for surface, _ in kept], settings.access, streams=streams, recorder=recorder)
        try:
            serve(configure(app, settings.tls), address, app.context, background, manager)
        finally:
            recorder.close()


def _require_certificate(files: TlsFiles) -> None:
    """Raise FailedError unless the files can be read, and ConfigError unless they belong together."""
    for path in (files.certificate, files.key):
        try:
            path.open("rb").close()
        except OSError as error:
            message = f"{path}: {error.strerror}"
            raise FailedError(message) from None
    try:
        # An empty passphrase: otherwise OpenSSL would ask for one at the terminal and wait.
        ssl.SSLContext(ssl.PROTOCOL_TLS_SERVER).load_cert_chain(files.certificate, files.key, password="")
    except (ssl.SSLError, OSError):
        message = (
            f"{files.certificate} and {files.key} are not a PEM certificate and its key without a "
            "passphrase; create them again, or correct server.certificate_file and server.key_file"
        )
        raise ConfigError(message) from None


def _modbus_server(settings: Settings) -> ModbusServer | None:
    if settings.modbus_server is None:
        return None
    with _extra("modbus_server", "modbus-server", "pymodbus"):
        from beamtouch_service.host.modbus import ModbusServer  # noqa: PLC0415  # needs an extra of its own
    return ModbusServer(settings.modbus_server, len(settings.surfaces))


def _log_readers(settings: Settings, modbus: ModbusServer) -> None:
    if settings.access.read is not None or not _is_loopback(modbus.address.shown):
        _log.warning("no token protects the Modbus TCP server: everyone who reaches it can read the contacts")


def _publisher(settings: MqttSettings) -> Publisher:
    with _extra("mqtt", "mqtt", "aiomqtt", "paho"):
        from beamtouch_service.outputs.mqtt.publisher import Publisher  # noqa: PLC0415  # needs an extra of its own
    return Publisher(settings)


@contextmanager
def _extra(section: str, extra: str, *modules: str) -> Iterator[None]:
    """Import what a section of the configuration needs; raises ConfigError with the extra that brings `modules`."""
    try:
        yield
    except ModuleNotFoundError as error:
        if error.name not in modules:
            raise
        message = f"[{section}] needs {error.name}; run: pip install 'beamtouch[service,{extra}]'"
        raise ConfigError(message) from None


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
    try:
        # Without the scope that follows a link-local address.
        return ip_address(address.partition("%")[0]).is_loopback
    except ValueError:  # a name that does not resolve yet
        return False


def _surface(entry: SurfaceSettings) -> tuple[Surface, ModelKeeper | None]:
    limits = entry.stale_ms, entry.unexplained_after_s, entry.degraded_after_s
    if entry.model is None:
        return Surface(entry.name, None, *limits), None
    try:
        model, digest = model_watch.load(entry.model)
    except ModelFileError as error:
        if not entry.name:  # only the model knows it
            message = f"model {error}"
            raise ConfigError(message) from None
        surface = Surface(entry.name, None, *limits)
        surface.model_error = str(error)
        return surface, ModelKeeper(surface, entry.model, "")
    name = entry.name or model.metadata.name
    surface = Surface(name, model, *limits)
    return surface, ModelKeeper(surface, entry.model, digest)


def _log_limits(settings: Settings, address: str, surfaces: Iterable[Surface]) -> None:
    if settings.access.write is None:
        _log.warning("no write token: every write is refused; start with --write-token-file FILE to allow writes")
    for surface in surfaces:
        if surface.model_error is not None:
            words = "surface %s: no contact until its model file can be used: %s"
            _log.error(words, surface.name, surface.model_error)
    if not settings.surfaces:
        _log.warning("no surface: the service has no contact to give; start with --model MODEL or --config FILE")
    if settings.tls is None and not _is_loopback(address):
        _log.warning("no TLS: others on the network can read the tokens; see certificate_file and key_file")
    if settings.mqtt and settings.mqtt.password and settings.mqtt.tls is None:
        _log.warning("no TLS to the MQTT broker: others on the network can read the password; see mqtt.tls")
