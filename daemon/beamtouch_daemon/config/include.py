"""Surfaces in files of their own, which a configuration includes: `include = ["surfaces/*.toml"]`."""

from collections.abc import Iterator, Mapping
from itertools import chain
from pathlib import Path, PurePath
from typing import Annotated, Any

from pydantic import BaseModel, Field, RootModel

from beamtouch_common.errors import InputError
from beamtouch_common.files import load_toml, validate
from beamtouch_daemon.config.settings import Surface
from beamtouch_daemon.config.sources import Strict
from beamtouch_service.samples import SurfaceName


class Table(RootModel[dict[str, Any]]):
    """Any TOML file."""


class _Patterns(BaseModel):
    include: Annotated[tuple[str, ...], Field(strict=False)] = ()


class _Included(Strict):
    surfaces: Annotated[dict[SurfaceName, Surface], Field(min_length=1)]


def with_included(content: Mapping[str, Any], path: Path) -> tuple[dict[str, Any], dict[str, Path]]:
    """Return a configuration with the surfaces of the files that it includes, and the file of each surface.

    Relative paths in an included file start from it; in the returned content they are absolute.

    Parameters
    ----------
    content, path
        The configuration, not checked yet, and its file.

    Raises
    ------
    InputError
        A pattern that no file matches, an included file that cannot be used, or a surface that is in two files.
    """
    patterns = validate(_Patterns, {key: content[key] for key in ("include",) if key in content}, str(path)).include
    surfaces = content.get("surfaces", {})
    if not isinstance(surfaces, Mapping):
        return dict(content), {}  # it is refused later
    merged, files = dict(surfaces), dict.fromkeys(surfaces, path)
    for file in _matching(patterns, path):
        for name, surface in _surfaces_in(file, path).items():
            if name in merged:
                message = f"{file}: surfaces.{name} is also in {files[name]}; remove one of the two"
                raise InputError(message)
            merged[name], files[name] = surface, file
    return {**content, "surfaces": merged} if patterns else dict(content), files


def _matching(patterns: tuple[str, ...], path: Path) -> Iterator[Path]:
    """Return the files that the patterns match, each once, in alphabetical order for each pattern."""
    seen: set[Path] = {path.resolve()}
    for pattern in patterns:
        for file in _found(pattern, path):
            try:
                whole = file.resolve(strict=True)
            except (OSError, RuntimeError) as error:  # before Python 3.13, a link to itself is a RuntimeError
                message = f"{file}: {error.strerror if isinstance(error, OSError) else 'a link to itself'}"
                raise InputError(message) from None
            if whole not in seen:
                seen.add(whole)
                yield file


def _found(pattern: str, path: Path) -> list[Path]:
    """Return the files that a pattern matches; InputError if there are none."""
    _require_relative(pattern, path)
    try:
        matching = sorted(path.parent.glob(pattern))
    except (ValueError, OSError) as error:  # a NUL, which Python 3.13 refuses, or a name that is too long
        message = f"{path}: include: {pattern!r}: {error.strerror if isinstance(error, OSError) else error}"
        raise InputError(message) from None
    _require_readable(pattern, path)
    folders = [one for one in matching if _is_folder(one)]
    # Editors hide their unfinished files.
    found = [one for one in matching if one not in folders and not one.name.startswith(".")]
    if not found:
        advice = f"correct it, for example to {pattern.rstrip('/')}/*.toml" if folders else "correct it"
        message = f"{path}: include: no file matches {pattern!r}; {advice}, or write a file with [surfaces.NAME]"
        raise InputError(message)
    return found


def _require_relative(pattern: str, path: Path) -> None:
    """Raise InputError for a pattern that `Path.glob` refuses in one version of Python and takes in another."""
    parts = PurePath(pattern).parts  # none of an empty pattern and of a dot
    if not parts or PurePath(pattern).is_absolute() or any("**" in part and part != "**" for part in parts):
        message = f"{path}: include: {pattern!r} is not a pattern relative to this file, such as surfaces/*.toml"
        raise InputError(message)


def _require_readable(pattern: str, path: Path) -> None:
    """Raise InputError if this user may not read a folder that a pattern means: nothing in it would match."""
    parts = PurePath(pattern).parts[:-1]
    beginnings = (str(PurePath(*parts[:length])) for length in range(1, len(parts) + 1))
    for folder in chain.from_iterable(path.parent.glob(beginning) for beginning in beginnings):
        try:
            if folder.is_dir():
                next(folder.iterdir(), None)
        except PermissionError as error:
            message = f"{path}: include: {folder}: {error.strerror}"
            raise InputError(message) from None


def _is_folder(path: Path) -> bool:
    try:
        return path.is_dir()
    except PermissionError:  # of a link; the complaint comes when the file is read
        return False


def _surfaces_in(file: Path, path: Path) -> dict[str, dict[str, Any]]:
    """Return the checked surfaces in an included file."""
    content = load_toml(Table, file).root
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
