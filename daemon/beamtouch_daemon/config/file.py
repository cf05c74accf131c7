"""Reads the configuration and the files that it includes; any error becomes one line that names the key.

Surfaces may stand in files of their own, which the configuration includes: `include = ["surfaces/*.toml"]`.
"""

import os
from collections.abc import Iterator, Mapping, Sequence
from glob import glob
from pathlib import Path
from types import MappingProxyType
from typing import Annotated, Any

from pydantic import AfterValidator, BaseModel, Field, RootModel

from beamtouch_common.errors import InputError
from beamtouch_common.files import file_path, load_toml, validate
from beamtouch_daemon.config.settings import Config, Surface
from beamtouch_daemon.config.sources import Strict
from beamtouch_service.samples import SurfaceName

_NONE: Mapping[str, Path | None] = MappingProxyType({})


class _Table(RootModel[dict[str, Any]]):
    """Any TOML file."""


def _pattern(text: str) -> str:
    file_path(Path(text))
    return text


class _Includes(BaseModel):
    include: Annotated[tuple[Annotated[str, AfterValidator(_pattern)], ...], Field(strict=False)] = ()


class _Included(Strict):
    surfaces: Annotated[dict[SurfaceName, Surface], Field(min_length=1)]


def load_config(path: Path, overrides: Mapping[str, Path | None] = _NONE) -> Config:
    """Read and check a configuration file; InputError if it cannot be used.

    `overrides` are files that win over those of [publish], unless they are None; relative to the working directory.
    """
    content = load_toml(_Table, path).root
    files: dict[str, Path] = {}
    if isinstance(content.get("surfaces", {}), dict):
        files = _add_included(content, path)
    config = validate(Config, content, str(path), context={"directory": path.resolve().parent, "files": files})
    given = {key: file.absolute() for key, file in overrides.items() if file is not None}
    return config.model_copy(update={"publish": config.publish.model_copy(update=given)})


def _add_included(content: dict[str, Any], path: Path) -> dict[str, Path]:
    """Add the surfaces of the included files to a configuration that is not checked yet; return the file of each.

    Relative paths in an included file start from it; here they become absolute.

    Raises
    ------
    InputError
        A pattern that no file matches, an included file that cannot be used, or a surface that is in two files.
    """
    patterns = validate(_Includes, {"include": content.get("include", ())}, str(path)).include
    files = dict.fromkeys(content.get("surfaces", {}), path)
    for file in _matching(patterns, path):
        surfaces: dict[str, Any] = content.setdefault("surfaces", {})
        for name, surface in _surfaces_in(file, path).items():
            if name in surfaces:
                raise InputError(f"{file}: surfaces.{name} is also in {files[name]}; remove one of the two")
            surfaces[name], files[name] = surface, file
    return files


def _matching(patterns: Sequence[str], path: Path) -> Iterator[Path]:
    """Yield the files that the patterns match, each once, in alphabetical order for each pattern."""
    included = {os.path.realpath(path)}
    for pattern in patterns:
        # pathlib takes hidden files too, which editors make, and raises an error for a folder that is closed.
        matches = sorted(glob(pattern, root_dir=path.parent, recursive=True))  # noqa: PTH207
        files = [path.parent / match for match in matches if not os.path.isdir(path.parent / match)]  # noqa: PTH112
        if not files:
            message = (
                f"{path}: include: no file matches {pattern!r}; correct it, for example to surfaces/*.toml, "
                "and let this user read the folder"
            )
            raise InputError(message)
        for file in files:
            if (real := os.path.realpath(file)) not in included:
                included.add(real)
                yield file


def _surfaces_in(file: Path, path: Path) -> dict[str, dict[str, Any]]:
    """Return the checked surfaces in an included file."""
    content = load_toml(_Table, file).root
    for key in content:
        if key != "surfaces":
            message = f"{file}: {key} belongs in {path}; a file that is included has only [surfaces.NAME] tables"
            raise InputError(message)
    checked = validate(_Included, content, str(file))
    surfaces: dict[str, dict[str, Any]] = content["surfaces"]
    for name, surface in checked.surfaces.items():
        if surface.tare_file is not None:
            surfaces[name]["tare_file"] = str(file.resolve().parent / surface.tare_file)
    return surfaces
