"""Sets up the process: addresses, models, outputs, record and application."""

from __future__ import annotations

import json
import logging
import socket
import ssl
from dataclasses import dataclass
from functools import partial
from typing import TYPE_CHECKING

from beamtouch_common import log_lines
from beamtouch_common.commands import version
from beamtouch_common.errors import InputError
from beamtouch_models.runtime import ModelFileError
from beamtouch_service.address import Address
from beamtouch_service.api import changes
from beamtouch_service.api.app import create_app
from beamtouch_service.api.context import Streams
from beamtouch_service.callers import TrustedProxies
from beamtouch_service.config import Settings, read_access
from beamtouch_service.host import models
from beamtouch_service.host.candidates import CandidateKeeper
from beamtouch_service.host.models import Keeper, ModelKeeper
from beamtouch_service.host.serve import configure, serve
from beamtouch_service.outputs import make
from beamtouch_service.own_names import OwnNames
from beamtouch_service.record import Action, Recorder, RecordUnusableError, describe_kept_days
from beamtouch_service.sections import ServerSection, SurfaceSection, load_pair
from beamtouch_service.surfaces.surface import Surface

if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping
    from pathlib import Path

    from beamtouch_service.access import Access
    from beamtouch_service.host.serve import Tasks
    from beamtouch_service.outputs.section import Output

_log = logging.getLogger(__name__)


@dataclass(frozen=True)
class Prepared:
    """The files and addresses that settings name, loaded and checked."""

    access: Access
    address: Address
    surfaces: list[Surface]
    keepers: list[Keeper]
    """Of models and their candidates."""
    outputs: list[Output]
    warnings: list[str]
    """Warnings: settings that work, but may not be meant."""


def prepare(settings: Settings) -> Prepared:
    """Read the files that the settings name, and check that they work on this machine.

    Raises
    ------
    InputError
        They do not.
    FailedError
        A file with a token, a password or a certificate cannot be read; it may come later.
    """
    server = settings.server
    access = read_access(server)
    if server.certificate_file and server.key_file:
        _require_certificate(server.certificate_file, server.key_file)
    loaded = [_load_surface(name, section) for name, section in settings.surfaces.items()]
    address = Address("server", server.host, server.port, require=partial(_require_tokens, access))
    outputs = [make(section, [surface.name for surface, _ in loaded], access) for section in settings.outputs]
    warnings = _warnings(settings, access, address) + [words for output in outputs for words in output.warnings]
    keepers = list[Keeper]()
    for _, keeper in loaded:
        keepers += [keeper, CandidateKeeper(keeper)] if keeper else []
    return Prepared(access, address, [surface for surface, _ in loaded], keepers, outputs, warnings)


def run(settings: Settings, origin: Mapping[str, object], levels: Iterable[log_lines.Level] = ()) -> None:
    """Serve until SIGTERM or Ctrl-C, with a log from these levels on; raises what `prepare` raises.

    `origin` is where the settings are from, as the trail tells it.
    """
    prepared, server = prepare(settings), settings.server
    log_lines.set_up(levels=levels)
    for warning in prepared.warnings:
        _log.warning(warning)
    for surface in prepared.surfaces:
        if surface.model_error is not None:
            words = "surface %s: no contact until its model file can be used: %s"
            _log.error(words, surface.name, surface.model_error)
    try:
        recorder = Recorder(settings.events, replica=server.replica)
    except RecordUnusableError as error:
        raise InputError(str(error)) from None
    streams, names, proxies = Streams(server.max_streams), _names(server), TrustedProxies(server.trusted_proxies)
    app = create_app(
        prepared.surfaces, prepared.access, streams=streams, recorder=recorder, names=names, proxies=proxies
    )
    names_of_tokens = {role: sorted(tokens) for role, tokens in vars(prepared.access).items()}
    start = {"version": version(), "tokens": names_of_tokens, **origin}
    where = f"{socket.gethostname()}:{server.port}"
    recorder.trail.note(changes.make_entry(Action.START, start, subject=where))
    tasks: Tasks = {
        "models": lambda _context: models.watch(prepared.keepers),
        "trail": changes.watch_models,
        **{section.name: output.run for section, output in zip(settings.outputs, prepared.outputs, strict=True)},
    }
    serve(configure(app, server), prepared.address, app.context, tasks)


def report(settings: Settings, *, as_json: bool) -> str:
    """Return what a service would serve, with warnings; raises what `prepare` raises."""
    prepared = prepare(settings)
    models_in_use = {one.name: one.model_error or (one.model and one.model.identity) for one in prepared.surfaces}
    days, limits = describe_kept_days(settings.events)
    if as_json:
        return json.dumps({"surfaces": models_in_use, "events": days, "warnings": prepared.warnings})
    lines = [f"surface {name}: {words or 'no model'}" for name, words in models_in_use.items()] + limits
    return "\n".join([*lines, *(f"warning: {warning}" for warning in prepared.warnings)])


def _names(server: ServerSection) -> OwnNames | None:
    """Return the names by which clients may ask; None if any will do.

    With a read token a page from elsewhere reads nothing, and for HTTPS no certificate has its name.
    """
    if server.read_token_file or server.certificate_file:
        return None
    machine = socket.gethostname()
    return OwnNames([*server.names, server.host, machine, f"{machine.partition('.')[0]}.local"])


def _require_certificate(certificate: Path, key: Path) -> None:
    """Raise FailedError unless the files can be read, and InputError unless they belong together."""
    advice = "create them again, or correct server.certificate_file and server.key_file"
    load_pair(ssl.SSLContext(ssl.PROTOCOL_TLS_SERVER), certificate, key, advice)


def _require_tokens(access: Access, address: str) -> None:
    """Raise InputError unless a service that the network reaches has both tokens."""
    needed = {"--write-token-file": access.write, "--read-token-file": access.read}
    missing = [f"{option} FILE" for option, token in needed.items() if not token]
    if missing:
        message = (
            f"{address} is open to the network, which requires a write token and a read token: "
            f"add {' and '.join(missing)}, or use 127.0.0.1"
        )
        raise InputError(message)


def _load_surface(name: str, section: SurfaceSection) -> tuple[Surface, ModelKeeper | None]:
    if section.model is None:
        return Surface(name, None, section), None
    stamp = models.stamp_of(section.model)
    try:
        model = models.load(section.model)
    except ModelFileError as error:
        if not name:  # only the model knows it
            raise InputError(f"model {error}") from None
        surface = Surface(name, None, section)
        surface.model_error = str(error)
    else:
        surface = Surface(name or model.metadata.name, model, section)
    keeper = ModelKeeper(surface, section.model, stamp)
    if surface.model and (conflict := keeper.zone_conflict(surface.model)):
        raise InputError(f"surfaces.{name}.zones.{conflict}")
    return surface, keeper


def _warnings(settings: Settings, access: Access, address: Address) -> list[str]:
    """Return what works, but may not be meant."""
    server, warnings = settings.server, list[str]()
    if not access.write:
        warnings.append("no write token: every write is refused; start with --write-token-file FILE to allow writes")
    if not settings.surfaces:
        warnings.append("no surface: the service has no contact to give; start with --model MODEL or --config FILE")
    if address.is_loopback or server.proxy:
        return warnings
    if not server.certificate_file:
        warnings.append("no TLS: others on the network can read the tokens; see certificate_file and key_file")
    warnings.append(
        "no proxy: other machines can hold connections and send slow requests; put HAProxy in front, as "
        "deploy/haproxy-one.cfg does, and name it in server.proxy"
    )
    return warnings
