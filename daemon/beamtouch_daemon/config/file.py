"""Reads the configuration and the files that it includes; any error becomes one line that names the key."""

from collections.abc import Mapping
from pathlib import Path
from types import MappingProxyType

from beamtouch_common.files import load_toml, validate
from beamtouch_daemon.config.include import Table, with_included
from beamtouch_daemon.config.settings import Config

_NONE: Mapping[str, Path | None] = MappingProxyType({})


def load_config(path: Path, overrides: Mapping[str, Path | None] = _NONE) -> Config:
    """Read and check a configuration file; InputError if it cannot be used.

    `overrides` are files that win over those of [publish], unless they are None; relative to the working directory.
    """
    content, files = with_included(load_toml(Table, path).root, path)
    context = {"directory": path.resolve().parent, "files": files}
    config = validate(Config, content, str(path), context=context)
    given = {key: file.absolute() for key, file in overrides.items() if file is not None}
    return config.model_copy(update={"publish": config.publish.model_copy(update=given)})
