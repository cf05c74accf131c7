"""The configuration of the service: the TOML file, the command line, and the token files.

Its sections are the settings: those of outputs stand with each output, all others in `sections`. Paths in them are from
the folder of the file.
"""

from collections.abc import Mapping
from itertools import combinations
from pathlib import Path
from typing import Any, Self

from pydantic import ConfigDict, Field, create_model, model_validator

from beamtouch_common.errors import InputError
from beamtouch_common.files import load_toml, validate
from beamtouch_common.secrets import read_tokens
from beamtouch_service.access import Access
from beamtouch_service.callers import SERVICE
from beamtouch_service.outputs import OUTPUTS
from beamtouch_service.outputs.section import OutputSection
from beamtouch_service.samples import SurfaceName
from beamtouch_service.sections import (
    EventsSection,
    File,
    Section,
    ServerSection,
    StaleMs,
    SurfaceSection,
    require_pair,
)


class Settings(Section):
    """The whole file. Relative paths in it are relative to its folder."""

    server: ServerSection = ServerSection()
    """Address, tokens, certificate, and limits."""
    events: EventsSection = EventsSection()
    """The record of contacts."""
    surfaces: dict[SurfaceName, SurfaceSection] = Field(default_factory=dict)
    """In their order in the file, which is that of their blocks of Modbus registers."""

    @model_validator(mode="after")
    def _share_one_record(self) -> Self:
        if self.server.replica and not self.events.url:
            raise ValueError("server.replica: all replicas need one record of events; set events.url")
        for output in self.outputs:
            if output.not_shared and self.events.url:
                raise ValueError(f"[{output.name}] does not work with events.url, {output.not_shared}; set events.file")
        return self

    @property
    def outputs(self) -> tuple[OutputSection, ...]:
        """The sections of outputs that the file has."""
        return tuple(section for output in OUTPUTS if (section := getattr(self, output.name, None)) is not None)


def _field_of(output: type[OutputSection]) -> tuple[object, object]:
    """Return the key of the file for an output; its description is the docstring without the name of the section."""
    words = (output.__doc__ or "").partition(": ")[2]
    return output | None, Field(None, description=words[:1].upper() + words[1:])


_OUTPUT_FIELDS: dict[str, Any] = {output.name: _field_of(output) for output in OUTPUTS}
ConfigFile = create_model("ConfigFile", __base__=Settings, __doc__=Settings.__doc__, **_OUTPUT_FIELDS)
"""`Settings`, with a section for each output."""


class Options(ServerSection):
    """Options of the command line that override the file, as they are typed."""

    model_config = ConfigDict(alias_generator=lambda name: f"--{name.replace('_', '-')}")

    model: File | None = None
    stale_ms: StaleMs | None = None


def load_settings(config: Path | None, options: Mapping[str, object]) -> Settings:
    """Read a config file, and override what the command line states.

    Without a config file, a model has one surface. Its name is empty: the model has the name.

    Parameters
    ----------
    config : the file; None without one
    options : values for fields of `Options`; None for an option that is not given

    Raises
    ------
    InputError
        Something is wrong; the message names the place.
    """
    typed = {f"--{name.replace('_', '-')}": value for name, value in options.items() if value is not None}
    line = validate(Options, typed, "command line")
    settings = load_toml(ConfigFile, config, context={"folder": config.parent}) if config else Settings()
    stated: dict[str, object] = {name: getattr(line, name) for name in line.model_fields_set}
    of_surface: dict[str, object] = {name: stated.pop(name) for name in ("model", "stale_ms") if name in stated}
    server = settings.server.model_copy(update=stated)
    try:
        require_pair(server.certificate_file, server.key_file, "HTTPS")
    except ValueError as error:
        raise InputError(f"server.{error}") from None
    if "model" in of_surface and len(settings.surfaces) > 1:
        names = ", ".join(settings.surfaces)
        raise InputError(f"--model is for a single surface, but the config has {names}; set `model` in the config")
    sections = settings.surfaces or ({"": SurfaceSection()} if "model" in of_surface else {})
    surfaces = {name: section.model_copy(update=of_surface) for name, section in sections.items()}
    return settings.model_copy(update={"server": server, "surfaces": surfaces})


def read_access(server: ServerSection) -> Access:
    """Read the tokens. One without a name in its file is named after its role.

    Raises
    ------
    InputError
        A file holds no usable token or the name of the service, or two files hold the same token or the same name.
    FailedError
        A file cannot be read; it may come later.
    """
    files = {"write": server.write_token_file, "read": server.read_token_file, "admin": server.admin_token_file}
    tokens = {role: read_tokens(file, role) for role, file in files.items() if file}
    for role, named in tokens.items():
        if taken := [name for name in named if name.casefold() == SERVICE]:
            message = f"the name {taken[0]} is that of the service itself on the trail of changes; choose another name"
            raise InputError(f"token file {files[role]}: {message}")
    for first, second in combinations(tokens, 2):
        which = f"token files {files[first]} and {files[second]} hold the same"
        if set(tokens[first].values()) & set(tokens[second].values()):
            raise InputError(f"{which} token; each purpose needs its own token")
        if names := sorted(tokens[first].keys() & tokens[second].keys()):
            raise InputError(f"{which} name, {names[0]}; each token needs its own name")
    return Access(**tokens)
