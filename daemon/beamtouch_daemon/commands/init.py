"""`init`: writes a configuration from the one that belongs to a model, for the sensors and the service of this machine.

The daemon reads no models: a gateway needs no onnxruntime. `design-sensors build --daemon-config` writes what it needs
to know of one: channels, characteristics, rate, noise and filter. The service does not know the characteristics.
"""

import argparse
import os
from pathlib import Path

from beamtouch_common.commands import DONE
from beamtouch_common.errors import FailedError, InputError
from beamtouch_common.files import parse_toml, read_text, write_atomically
from beamtouch_daemon.commands.init_dialogue import Stated, complete
from beamtouch_daemon.commands.init_text import NoTableError, with_publish, with_source
from beamtouch_daemon.config.file import RENAMED, load_config
from beamtouch_daemon.config.settings import Config

MODE = 0o644
"""Permissions: a configuration holds no secret, and the user of the service reads what root wrote."""


def run(arguments: argparse.Namespace) -> int:
    """Run the command; InputError for wrong or missing answers, FailedError if the file cannot be written."""
    path: Path = arguments.config
    _require_free(path, force=arguments.force)
    stated = complete(Stated.of(arguments))
    text, config = configuration(stated, path)
    _require_free(path, force=arguments.force)
    try:
        write_atomically(path, text.encode(), mode=MODE)
    except OSError as error:
        message = f"{path}: not written: {error.strerror}"
        raise FailedError(message) from None
    ((name, surface),) = config.surfaces.items()
    channels = ", ".join(surface.channel_names)
    print(f"{path}: {name}, channels {channels}, {surface.rate_hz:g} readings per second from {stated.source}")
    token = path.resolve().parent / config.publish.token_file
    if not token.exists():
        print(f"next: copy the service's token to {token}")
    print(f"next: beamtouch-daemon check {path} --wait 30\n      beamtouch-daemon tare {path}")
    return DONE


def configuration(stated: Stated, path: Path) -> tuple[str, Config]:
    """Return the text of the configuration, and the configuration; InputError if the answers do not give one.

    Parameters
    ----------
    stated
        The answers.
    path
        Where it will be written. Relative paths in it start there.
    """
    template = stated.model_config
    if template.suffix == ".onnx":
        message = f"{template}: the daemon reads no models; give what design-sensors build --daemon-config FILE wrote"
        raise InputError(message)
    known = load_config(template)
    if len(known.surfaces) > 1 or known.include:
        message = f"{template}: has several surfaces; give a configuration with the surface of one model"
        raise InputError(message)
    (name,) = known.surfaces
    given = stated.token_file or path.parent / known.publish.token_file
    token = os.path.relpath(given.absolute(), path.absolute().parent)
    token = str(given.absolute()) if token.startswith("..") else token
    try:
        text = with_source(read_text(template), name, stated.settings())
        text = with_publish(text, stated.url or known.publish.url, token)
    except NoTableError as error:
        message = f"{template}: {error}; give what design-sensors build --daemon-config wrote"
        raise InputError(message) from None
    context = {"directory": path.absolute().parent}
    return text, parse_toml(Config, text, str(path), renamed=RENAMED, context=context)


def _require_free(path: Path, *, force: bool) -> None:
    """Raise InputError if the file cannot be written, or exists and may not be replaced."""
    if not path.parent.is_dir():
        message = f"{path.parent} is not a directory"
        raise InputError(message)
    if path.exists() and not force:
        message = f"{path}: already exists; add --force to replace it, or name another file"
        raise InputError(message)
