"""Files: reads TOML with one-line errors, checks early that one can be written, writes atomically, tells two apart."""

import errno
import hashlib
import os
import secrets
import tomllib
from collections.abc import Mapping, Sequence
from contextlib import suppress
from pathlib import Path
from typing import Any, TypeVar

from pydantic import BaseModel, ValidationError

from beamtouch_common.complaints import complaint, parser_complaint
from beamtouch_common.encodings import decode
from beamtouch_common.errors import InputError

MAX_BYTES = 1024 * 1024
"""Largest file that people write, a thousand times a usual one; a larger file was given by mistake."""

Context = Mapping[str, Any] | None
"""The context of a file, for the validators of its model."""
Model = TypeVar("Model", bound=BaseModel)


def load_toml(kind: type[Model], path: Path, *, context: Context = None) -> Model:
    """Read a TOML file into a pydantic model; InputError as `read_text` and `parse_toml` raise it."""
    return parse_toml(kind, read_text(path), str(path), context=context)


def read_text(path: Path) -> str:
    """Read a text file in UTF-8 of at most `MAX_BYTES`; InputError with the reason in one line."""
    try:
        content = read_bounded(path)
    except OSError as error:
        raise InputError(f"{path}: {error.strerror}") from None
    try:
        return decode(content)
    except ValueError as error:
        raise InputError(f"{path}: {error}") from None


def read_bounded(path: Path) -> bytes:
    """Read a file of at most `MAX_BYTES`; InputError if it is larger, as a device is that never ends, else OSError."""
    try:
        with path.open("rb") as file:
            content = file.read(MAX_BYTES + 1)
    except ValueError:  # a null character
        raise InputError(f"{str(path)!r} cannot be the path of a file") from None
    if len(content) > MAX_BYTES:
        raise InputError(f"{path}: larger than {MAX_BYTES >> 20} MiB; is it the right file?")
    return content


def digest_of(path: Path) -> str:
    """Return the SHA-256 of a file, as `sha256sum` prints it; OSError if it cannot be read."""
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


def identity_of(path: Path) -> tuple[int, int] | None:
    """Return device and inode number of a file, which tell it from one that has replaced it; None if there is none."""
    try:
        status = path.stat()
    except OSError:
        return None
    return status.st_dev, status.st_ino


def parse_toml(kind: type[Model], text: str, origin: str, *, context: Context = None) -> Model:
    """Read TOML text into a pydantic model.

    Parameters
    ----------
    kind : The model.
    text, origin : The text, and its name for messages.
    context : Context of the validation.

    Raises
    ------
    InputError
        Not TOML, an unknown key, a missing or impossible value; the message names `origin` and the key.
    """
    try:
        content = tomllib.loads(text)
    except (ValueError, RecursionError) as error:
        # These include numbers and nesting beyond the limits of the parser.
        raise InputError(f"{origin}: not valid TOML: {parser_complaint(error)}") from None
    return validate(kind, content, origin, context=context)


def validate(kind: type[Model], content: Mapping[str, Any], origin: str, *, context: Context = None) -> Model:
    """Make a pydantic model of values; parameters and InputError as of `parse_toml`."""
    try:
        return kind.model_validate(content, context=context)
    except ValidationError as error:
        raise InputError(f"{origin}: {complaint(error, kind, content)}") from None


def file_path(path: Path) -> Path:
    """Return a path that a person states; ValueError if no file can have it."""
    if path == Path() or "\0" in str(path):
        raise ValueError("must be the path of a file")
    return path


def write_atomically(
    path: Path, content: bytes, *, mode: int | None = None, owner: tuple[int, int] | None = None
) -> None:
    """Replace a file in one step, so that no reader ever sees a part of it; OSError if that is impossible.

    When this returns, a loss of power leaves the new file; before, the old one or the new one.

    A device or a pipe, such as /dev/null, is written to and stays what it is. So does a link: the file that it leads to
    is replaced.

    Parameters
    ----------
    path, content : The file, and all of its content.
    mode : Its permissions; by default the umask decides.
    owner : Its user and group, if this user may give it to them; by default those of this user.
    """
    try:
        if path.exists() and not path.is_file() and not path.is_dir():
            path.write_bytes(content)
        else:
            _replace(path.resolve() if path.is_symlink() else path, content, mode, owner)
    except OSError as error:
        raise OSError(error.errno, error.strerror, str(path)) from error  # the file that the user named


def partial_of(path: Path) -> Path:
    """Return where to write a file until it is whole: beside it, under a name that nothing else has."""
    return path.with_name(f".{path.name}.{secrets.token_hex(4)}.partial")


def _replace(path: Path, content: bytes, mode: int | None, owner: tuple[int, int] | None) -> None:
    """Write a file beside it, and put that in its place."""
    partial = partial_of(path)
    try:
        descriptor = os.open(partial, os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o666 if mode is None else mode)
        with os.fdopen(descriptor, "wb") as file:
            if owner is not None:
                with suppress(PermissionError):
                    os.fchown(descriptor, *owner)
            if mode is not None:
                os.fchmod(descriptor, mode)  # whatever the umask
            file.write(content)
            file.flush()
            os.fsync(file.fileno())
        partial.replace(path)
        sync_folder(path.parent)
    except BaseException:
        partial.unlink(missing_ok=True)
        raise


def sync_folder(folder: Path) -> None:
    """Let the names of a folder survive a loss of power as they are now; OSError if the disk fails.

    A folder that this user may write to and not list is left to the system, and so is one on a file system that knows
    no such request, as some network shares.
    """
    try:
        descriptor = os.open(folder, os.O_RDONLY | os.O_DIRECTORY)
    except PermissionError:
        return
    try:
        os.fsync(descriptor)
    except OSError as error:
        if error.errno != errno.EINVAL:
            raise
    finally:
        os.close(descriptor)


def require_writable(outputs: Sequence[Path | None], inputs: Sequence[Path | None] = ()) -> None:
    """Raise InputError if an output cannot be written, or would replace an input or another output.

    Parameters
    ----------
    outputs : Files to write; None for one that was not asked for.
    inputs : Files that are read and must stay as they are.
    """
    read = {path.resolve() for path in inputs if path is not None}
    written: set[Path] = set()
    for path in outputs:
        if path is None:
            continue
        if problem := _problem(path):
            raise InputError(problem)
        for others, does in ((read, "reads this file as well"), (written, "would write this file twice")):
            if path.resolve() in others:
                raise InputError(f"{path}: the command {does}; name another one")
        written.add(path.resolve())


def _problem(path: Path) -> str:
    """Return why a file cannot be written; empty if it can."""
    folder = path.parent
    try:
        if not folder.is_dir():
            return f"{folder}: no such folder; create it first"
        if path.is_dir():
            return f"{path}: is a folder; name a file in it"
    except OSError as error:  # a folder above it is closed to this user
        return f"{path}: {error.strerror}"
    is_device = path.exists() and not path.is_file()
    if not is_device and not os.access(folder, os.W_OK | os.X_OK, effective_ids=True):
        return f"{folder}: this user may not write there; choose another folder"
    return ""
