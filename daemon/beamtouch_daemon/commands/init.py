"""`init`: writes a configuration from the one that belongs to a model, for the sensors and the service of this machine.

The daemon reads no models: a gateway needs no onnxruntime. `design-sensors build --daemon-config` writes what it needs
to know of one: channels, characteristics, rate, noise and filter. The service does not know the characteristics.
"""

import argparse
import os
import shlex
from pathlib import Path

from beamtouch_common.commands import DONE
from beamtouch_common.errors import FailedError, InputError
from beamtouch_common.files import parse_toml, read_text, require_writable, write_atomically
from beamtouch_daemon.commands.init_dialogue import Stated, complete
from beamtouch_daemon.commands.init_template import load_template
from beamtouch_daemon.commands.init_text import NoTableError, with_publish, with_source
from beamtouch_daemon.config.settings import Config

MODE = 0o644
"""Permissions: a configuration holds no secret, and the user of the service reads what root wrote."""


def run(arguments: argparse.Namespace) -> int:
    """Run the command; InputError for wrong or missing answers, FailedError if the file cannot be written."""
    path: Path = arguments.config
    _require_free(path, force=arguments.force)
    stated = complete(Stated.of(arguments), path.parent)
    content, config = configuration(stated, path)
    _require_free(path, force=arguments.force)
    try:
        write_atomically(path, content, mode=MODE)
    except OSError as error:
        message = f"{path}: not written: {error.strerror}"
        raise FailedError(message) from None
    ((name, surface),) = config.surfaces.items()
    channels = ", ".join(surface.channel_names)
    print(f"{path}: {name}, channels {channels}, {surface.rate_hz:g} readings per second from {stated.source}")
    token = path.resolve().parent / config.publish.token_file
    if not os.access(token, os.R_OK):
        print(f"next: copy the service's token to {token}, so that this user can read it")
    typed = shlex.quote(str(path))
    print(f"next: beamtouch-daemon check {typed} --wait 30\n      beamtouch-daemon tare {typed}")
    return DONE


def configuration(stated: Stated, path: Path) -> tuple[bytes, Config]:
    """Return the content of the file, and the configuration; InputError if the answers do not give one.

    Parameters
    ----------
    stated
        The answers.
    path
        Where it will be written. Relative paths in it start there.
    """
    template = stated.model_config
    known = load_template(template)
    (name,) = known.surfaces
    token = stated.token_file or path.parent / known.publish.token_file
    service = {"url": stated.url or known.publish.url, "token_file": _seen_from(path, token)}
    if stated.certificate_file is not None:
        service["certificate_file"] = _seen_from(path, stated.certificate_file)
    try:
        text = with_publish(with_source(read_text(template), name, stated.settings()), service)
    except NoTableError as error:
        message = f"{template}: {error}; give what design-sensors build --daemon-config wrote"
        raise InputError(message) from None
    try:
        content = text.encode()
    except UnicodeEncodeError:  # names of files may be any bytes
        message = "the source and the files must have names in UTF-8"
        raise InputError(message) from None
    context = {"directory": path.absolute().parent}
    return content, parse_toml(Config, text, str(path), context=context)


def _seen_from(path: Path, file: Path) -> str:
    """Return a file as a configuration names it: relative to its folder if the file is in it or below."""
    relative = os.path.relpath(file.absolute(), path.absolute().parent)
    return str(file.absolute()) if relative.startswith("..") else relative


def _require_free(path: Path, *, force: bool) -> None:
    """Raise InputError if the file cannot be written, or exists and may not be replaced."""
    require_writable([path])
    if path.exists() and not force:
        message = f"{path}: already exists; add --force to replace it, or name another file"
        raise InputError(message)
