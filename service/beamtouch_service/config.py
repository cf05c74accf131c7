"""Settings of the service: a TOML file, the command line (which wins), and the token files."""

import re
from collections.abc import Mapping
from pathlib import Path

from beamtouch_common.errors import FailedError, InputError
from beamtouch_common.files import load_toml, validate
from beamtouch_service.access import Access
from beamtouch_service.config_sections import ConfigFile, MqttSection, Overrides, SurfaceSection
from beamtouch_service.settings import (
    EventSettings,
    ModbusSettings,
    MqttSettings,
    MqttTls,
    Settings,
    SurfaceSettings,
    TlsFiles,
)

MIN_TOKEN_CHARACTERS = 16
_MAX_TOKEN_BYTES = 4096
_TOKEN_FILES = {"write": "write_token_file", "read": "read_token_file"}
_DATABASE = re.compile(r"postgresql://[^/?#\s]*/[^/?#\s]+(\?\S*)?")
_FILES = (*_TOKEN_FILES.values(), "certificate_file", "key_file")


class ConfigError(InputError):
    """Settings that cannot be used together, or not on this machine."""


def load_settings(config: Path | None, options: Mapping[str, object]) -> Settings:
    """Merge a config file and the command line, which wins, and read the tokens.

    Parameters
    ----------
    config : the file; None without one
    options : fields of `Overrides`

    Raises
    ------
    InputError
        Something is wrong; the message names the place.
    FailedError
        The file of a token or of the password cannot be read; it may come later.
    """
    typed = {f"--{name.replace('_', '-')}": value for name, value in options.items()}
    overrides = validate(Overrides, typed, "command line")
    file = load_toml(ConfigFile, config) if config else ConfigFile()
    folder = config.parent if config else Path()
    server = file.server
    files = {name: _path(getattr(overrides, name), Path()) or _path(getattr(server, name), folder) for name in _FILES}
    return Settings(
        host=server.host if overrides.host is None else overrides.host,
        port=server.port if overrides.port is None else overrides.port,
        access=_access(files),
        tls=_tls(files["certificate_file"], files["key_file"], "server", "HTTPS"),
        replica=server.replica,
        surfaces=_merge_surfaces(file, folder, overrides),
        max_streams=server.max_streams,
        events=_events(file, folder),
        modbus_server=ModbusSettings(**dict(file.modbus_server)) if file.modbus_server else None,
        mqtt=_mqtt(file.mqtt, folder) if file.mqtt else None,
    )


def _events(file: ConfigFile, folder: Path) -> EventSettings:
    section, url = file.events, file.events.url
    # None of them quotes the URL: it may hold a password.
    wrong = {
        "server.replica: all replicas need one record of events; set events.url": file.server.replica and not url,
        "events.file and events.url are both given; events are in a file or in a database": url and section.file,
        "events.url must look like postgresql://beamtouch@127.0.0.1/beamtouch": url and not _DATABASE.fullmatch(url),
        "[mqtt] does not work with events.url, as each service would send the events of all; set events.file": url
        and file.mqtt,
    }
    for message, applies in wrong.items():
        if applies:
            raise ConfigError(message)
    return EventSettings(_path(section.file, folder), section.keep_days, section.max_mb, url)


def _access(files: Mapping[str, Path | None]) -> Access:
    found: dict[str, Path] = {}
    tokens: dict[str, str] = {}
    for purpose, name in _TOKEN_FILES.items():
        path = files[name]
        if path is None:
            continue
        tokens[purpose] = token = load_token(path)
        if token in found:
            message = f"token files {found[token]} and {path} hold the same token; each purpose needs its own token"
            raise ConfigError(message)
        found[token] = path
    return Access(**tokens)


def _tls(certificate: Path | None, key: Path | None, section: str, purpose: str) -> TlsFiles | None:
    if certificate is None and key is None:
        return None
    if certificate is None or key is None:
        missing = "certificate_file" if certificate is None else "key_file"
        message = f"{section}.{missing} is missing; {purpose} needs a certificate and its key"
        raise ConfigError(message)
    return TlsFiles(certificate, key)


def _mqtt(section: MqttSection, folder: Path) -> MqttSettings:
    own = _tls(_path(section.certificate_file, folder), _path(section.key_file, folder), "mqtt", "a client certificate")
    ca = _path(section.ca_file, folder)
    if (ca or own) and not section.tls:
        message = f"mqtt.{'ca_file' if ca else 'certificate_file'} has no effect without TLS; set mqtt.tls = true"
        raise ConfigError(message)
    password_file = _path(section.password_file, folder)
    if password_file and not section.username:
        message = "mqtt.password_file has no effect without a user; set mqtt.username"
        raise ConfigError(message)
    return MqttSettings(
        host=section.host,
        port=section.port or (8883 if section.tls else 1883),
        prefix=section.prefix,
        client_id=section.client_id or section.prefix,
        max_rate_hz=section.max_rate_hz,
        username=section.username,
        password=load_password(password_file) if password_file else None,
        tls=MqttTls(ca, own) if section.tls else None,
        send_recorded_events=section.send_recorded_events,
        home_assistant_discovery=section.home_assistant_discovery,
    )


def load_password(path: Path) -> str:
    """Read a password, without the end of its line.

    Raises ConfigError if the file holds none, and FailedError if it cannot be read: it may come later.
    """
    remedy = "write the password to it, in one line"
    try:
        with path.open("rb") as file:
            content = file.read(_MAX_TOKEN_BYTES + 1)
        password = content.decode().removesuffix("\n").removesuffix("\r")
    except OSError as error:
        message = f"password file {path}: {error.strerror}; {remedy}"
        raise FailedError(message) from None
    except UnicodeDecodeError:
        password = ""
    if password.isprintable() and password and len(content) <= _MAX_TOKEN_BYTES:
        return password
    message = f"password file {path}: not one line of text; {remedy}"
    raise ConfigError(message)


def _merge_surfaces(file: ConfigFile, folder: Path, overrides: Overrides) -> tuple[SurfaceSettings, ...]:
    model = _path(overrides.model, Path())
    if model and len(file.surfaces) > 1:
        message = (
            f"--model is for a single surface, but the config has {', '.join(file.surfaces)}; set `model` in the config"
        )
        raise ConfigError(message)
    merged = [
        SurfaceSettings(
            name=name,
            model=model or _path(section.model, folder),
            stale_ms=overrides.stale_ms or section.stale_ms,
            unexplained_after_s=section.unexplained_after_s,
            degraded_after_s=section.degraded_after_s,
        )
        for name, section in file.surfaces.items()
    ]
    if model and not merged:
        default = SurfaceSection()
        stale_ms = overrides.stale_ms or default.stale_ms
        merged = [SurfaceSettings("", model, stale_ms, default.unexplained_after_s, default.degraded_after_s)]
    return tuple(merged)


def load_token(path: Path) -> str:
    """Read a token and strip white space around it.

    Raises ConfigError if the file holds no usable token, and FailedError if it cannot be read: it may come later.
    """
    remedy = f"write at least {MIN_TOKEN_CHARACTERS} random characters to it, as `openssl rand -hex 32` prints them"
    try:
        with path.open("rb") as file:
            content = file.read(_MAX_TOKEN_BYTES + 1)
    except OSError as error:
        message = f"token file {path}: {error.strerror}; {remedy}"
        raise FailedError(message) from None
    token = content.decode("ascii", "replace").strip()
    if len(content) > _MAX_TOKEN_BYTES:
        problem = f"longer than {_MAX_TOKEN_BYTES} bytes"
    elif not token:
        problem = "empty"
    elif not all("!" <= character <= "~" for character in token):
        problem = "more than one word of printable ASCII"
    elif len(token) < MIN_TOKEN_CHARACTERS:
        problem = f"only {len(token)} character{'s' if len(token) > 1 else ''}"
    else:
        return token
    message = f"token file {path}: {problem}; {remedy}"
    raise ConfigError(message)


def _path(text: str | None, folder: Path) -> Path | None:
    return folder / text if text else None
