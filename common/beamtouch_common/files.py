"""Reads TOML files, with one-line errors, and writes files atomically."""

import os
import secrets
import tomllib
from collections.abc import Mapping
from pathlib import Path
from types import MappingProxyType
from typing import Any, TypeVar

from pydantic import BaseModel, ValidationError

from beamtouch_common.complaints import complaint
from beamtouch_common.errors import InputError
from beamtouch_common.file_kinds import mistaken_kind
from beamtouch_common.plain_toml import parser_complaint

MAX_BYTES = 1024 * 1024
"""Largest text file, a thousand times a usual one; a larger file was given by mistake."""
_NONE: Mapping[str, Any] = MappingProxyType({})

Model = TypeVar("Model", bound=BaseModel)
_PathT = TypeVar("_PathT", str, Path)


def load_toml(
    kind: type[Model], path: Path, *, renamed: Mapping[str, str] = _NONE, context: Mapping[str, Any] = _NONE
) -> Model:
    """Read a TOML file into a pydantic model; InputError as `read_text` and `parse_toml` raise it."""
    return parse_toml(kind, read_text(path), str(path), renamed=renamed, context=context)


def read_text(path: Path) -> str:
    """Read a text file in UTF-8 of at most `MAX_BYTES`; InputError with the reason in one line."""
    try:
        with path.open("rb") as file:
            content = file.read(MAX_BYTES + 1)
    except OSError as error:
        message = f"{path}: {error.strerror}"
        raise InputError(message) from None
    except ValueError:  # a null character
        message = f"{str(path)!r} cannot be the path of a file"
        raise InputError(message) from None
    if len(content) > MAX_BYTES:
        message = f"{path}: larger than {MAX_BYTES >> 20} MiB; is it the right file?"
        raise InputError(message)
    try:
        return content.decode("utf-8-sig")  # some editors begin a file with a byte order mark
    except UnicodeDecodeError:
        is_model = path.suffix == ".onnx"
        message = f"{path}: {'this is a model file; give a text file' if is_model else 'not a text file in UTF-8'}"
        raise InputError(message) from None


def parse_toml(
    kind: type[Model],
    text: str,
    origin: str,
    *,
    renamed: Mapping[str, str] = _NONE,
    context: Mapping[str, Any] = _NONE,
) -> Model:
    """Read TOML text into a pydantic model.

    Parameters
    ----------
    kind
        The model.
    text, origin
        The text, and its name for messages.
    renamed
        Keys of older versions, with their present names.
    context
        Context of the validation.

    Raises
    ------
    InputError
        Not TOML, an unknown key, a missing or impossible value; the message names `origin` and the key.
    """
    try:
        content = tomllib.loads(text)
    except (ValueError, RecursionError) as error:
        # These include numbers and nesting beyond the limits of the parser.
        message = f"{origin}: not valid TOML: {parser_complaint(error, text)}"
        raise InputError(message) from None
    return validate(kind, content, origin, renamed=renamed, context=context)


def validate(
    kind: type[Model],
    content: Mapping[str, Any],
    origin: str,
    *,
    renamed: Mapping[str, str] = _NONE,
    context: Mapping[str, Any] = _NONE,
) -> Model:
    """Make a pydantic model of values; parameters and InputError as of `parse_toml`."""
    try:
        return kind.model_validate(content, context=dict(context))
    except ValidationError as error:
        message = f"{origin}: {mistaken_kind(kind, content) or complaint(error, kind, content, renamed)}"
        raise InputError(message) from None


def file_path(path: _PathT) -> _PathT:
    """Return a path that a person states; ValueError if no file can have it."""
    if "\0" in str(path):
        message = "must be the path of a file"
        raise ValueError(message)
    return path


def write_atomically(path: Path, content: bytes, *, mode: int | None = None) -> None:
    """Replace a file in one step, so that no reader ever sees a part of it; OSError if that is impossible.

    Parameters
    ----------
    path, content
        The file, and all of its content.
    mode
        Its permissions; by default the umask decides.
    """
    partial = path.with_name(f".{path.name}.{secrets.token_hex(4)}.partial")
    try:
        descriptor = os.open(partial, os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o666 if mode is None else mode)
        with os.fdopen(descriptor, "wb") as file:
            if mode is not None:
                os.fchmod(descriptor, mode)  # whatever the umask
            file.write(content)
            file.flush()
            os.fsync(file.fileno())
        partial.replace(path)
    except BaseException as error:
        partial.unlink(missing_ok=True)
        if isinstance(error, OSError):
            error.filename, error.filename2 = str(path), None  # the file that the user named
        raise
