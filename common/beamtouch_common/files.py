"""Reads TOML files, with one-line errors, and writes files atomically."""

import os
import re
import secrets
import tomllib
from collections.abc import Mapping, Sequence
from pathlib import Path
from types import MappingProxyType
from typing import Any, TypeVar

from pydantic import BaseModel, ValidationError

from beamtouch_common.errors import InputError

MAX_BYTES = 1024 * 1024
"""Largest text file, a thousand times a usual one; a larger file was given by mistake."""
_MAX_SHOWN = 80
"""Longest value in a message, in characters."""
_NONE: Mapping[str, Any] = MappingProxyType({})
_OWN = "Value error, "
"""Beginning of the messages of our own checks."""
_PLAIN = {
    "greater than or equal to": "at least",
    "less than or equal to": "at most",
    "greater than": "more than",
}
"""Words of pydantic's messages -> plainer ones."""

Model = TypeVar("Model", bound=BaseModel)


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
    if len(content) > MAX_BYTES:
        message = f"{path}: larger than {MAX_BYTES >> 20} MiB; is it the right file?"
        raise InputError(message)
    try:
        return content.decode("utf-8-sig")  # some editors begin a file with a byte order mark
    except UnicodeDecodeError:
        message = f"{path}: not a text file in UTF-8"
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
        message = f"{origin}: not valid TOML: {error}"
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
        message = f"{origin}: {_complaint(error, content, renamed)}"
        raise InputError(message) from None


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
    except BaseException:
        partial.unlink(missing_ok=True)
        raise


def _complaint(error: ValidationError, content: Mapping[str, Any], renamed: Mapping[str, str]) -> str:
    """Return the first complaint in one line: key, what is wrong, and the number of further complaints."""
    # A misspelt key is also a missing one. The user can see the spelling, so it comes first.
    first, *others = sorted(error.errors(include_url=False), key=lambda found: found["type"] != "extra_forbidden")
    key = _key_path(first["loc"], content, is_missing=first["type"] == "missing")
    last = str(first["loc"][-1]) if first["loc"] else ""
    match first["type"]:
        case "extra_forbidden" if last in renamed:
            text = f"unknown key {key}; {last} is now {renamed[last]}"
        case "extra_forbidden":
            text = f"unknown key {key}; remove it or correct its spelling"
        case "missing":
            text = f"{key} is missing; add it"
        case "union_tag_not_found":
            text = f"{_tag(key, first['ctx'])} is missing; add it"
        case "union_tag_invalid":
            context = first["ctx"]
            text = f"{_tag(key, context)}: must be one of {context['expected_tags']}" + _given(context["tag"])
        case _:
            reason = _reason(first["msg"])
            text = (f"{key}: {reason}" if key else reason) + _given(first["input"])
    return text + (f" (and {len(others)} more)" if others else "")


def _tag(key: str, context: Mapping[str, Any]) -> str:
    """Return the key in a table that names the kind of the table."""
    name = context["discriminator"].strip("'")
    return f"{key}.{name}" if key else name


def _reason(message: str) -> str:
    """Return the message of a check, which says what the value must be."""
    if message.startswith(_OWN):
        return message.removeprefix(_OWN)
    for theirs, plain in _PLAIN.items():
        message = message.replace(theirs, plain)
    return re.sub(r"^\w+ should ", "must ", message)


def _given(value: object) -> str:
    """Return a value in brackets; nothing for a whole table."""
    if isinstance(value, Mapping | BaseModel):
        return ""
    try:
        text = repr(value)
    except (ValueError, RecursionError):
        return ""  # too long or too deep to show
    return f" (given: {text if len(text) <= _MAX_SHOWN else text[: _MAX_SHOWN - 3] + '...'})"


def _key_path(location: Sequence[int | str], content: object, *, is_missing: bool) -> str:
    """Return a key as in the file, without what pydantic adds: the kinds of which a value may be."""
    path, here = "", content
    for place, part in enumerate(location, start=1):
        if isinstance(part, int):
            path += f"[{part}]"
            here = here[part] if isinstance(here, Sequence) and part < len(here) else None
        elif isinstance(here, Mapping) and (part in here or (is_missing and place == len(location))):
            path += f".{part}"
            here = here.get(part)
    return path.removeprefix(".")
