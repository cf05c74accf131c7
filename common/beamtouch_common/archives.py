"""Archives of the files that make a service or a gateway: written in one piece, and restored whole or not at all.

An archive is a compressed tar file. It begins with a list of its files, each with its size and its digest, and of empty
folders. A file from the folder of the configuration has its path from there, any other one its whole path.
"""

import hashlib
import io
import os
import tarfile
import zlib
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path, PurePosixPath
from typing import IO, Annotated, Literal

from pydantic import BaseModel, ConfigDict, Field, ValidationError

from beamtouch_common.commands import version
from beamtouch_common.errors import FailedError, InputError
from beamtouch_common.files import partial_of, sync_folder

_LIST = "list.json"
_MAX_LIST_BYTES = 1024 * 1024
_FOLDER, _ROOT = "folder", "root"
"""First parts of the names in an archive: from the folder of the configuration, and from the root of the machine."""
_AT_ONCE = 1024 * 1024
_UNREADABLE = (tarfile.TarError, EOFError, zlib.error, OSError, ValueError)
"""Errors of a file that is no whole archive."""
_BESIDE_RECORD = ("-wal", "-shm", "-journal")
"""Ends of the files that SQLite keeps beside a record. It would write those of another record into a restored one."""


@dataclass(frozen=True)
class Part:
    """A file for an archive, or an empty folder."""

    path: Path
    """Where the program has it."""
    content: Path | None = None
    """The file to read in its place, such as a snapshot."""
    is_secret: bool = False


class _File(BaseModel):
    model_config = ConfigDict(extra="forbid", strict=True)

    name: str
    sha256: Annotated[str, Field(pattern="^[0-9a-f]{64}$")]
    bytes: Annotated[int, Field(ge=0)]
    mode: Annotated[int, Field(ge=0, le=0o777)]


class _List(BaseModel):
    model_config = ConfigDict(extra="forbid", strict=True)

    format: Literal[1] = 1
    program: str
    version: str
    made_at: str
    files: list[_File]
    folders: list[str] = []
    """Names of folders in which there is nothing."""


def write_archive(target: Path, program: str, config: Path, parts: Sequence[Part]) -> list[str]:
    """Write an archive that only its owner may read; return the names in it.

    Parameters
    ----------
    target : the archive; nothing may be there
    program : which made it
    config : the configuration, whose folder relative names are from
    parts : all files and empty folders; one that is given again, by whatever path, is written once

    Raises
    ------
    InputError
        There is something at the target.
    FailedError
        A file cannot be read, or changes meanwhile, or the archive cannot be written.
    """
    if os.path.lexists(target):
        raise InputError(f"{target}: is there already; name another one, or move it away")
    partial = partial_of(target)
    try:
        named: dict[str, Part] = {}
        for part in parts:
            name = _name_of(part.path, config.parent)
            if name not in named or part.is_secret:
                named[name] = part
        folders = [name for name, part in named.items() if part.path.is_dir()]
        named = {name: part for name, part in named.items() if name not in folders}
        files = [_describe(name, part) for name, part in named.items()]
        made_at = datetime.now(UTC).isoformat(timespec="seconds")
        head = _List(program=program, version=version(), made_at=made_at, files=files, folders=folders)
        with os.fdopen(os.open(partial, os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o600), "wb") as file:
            with tarfile.open(fileobj=file, mode="w:gz") as archive:
                listed = head.model_dump_json(indent=2).encode()
                _add(archive, _LIST, len(listed), 0o600, io.BytesIO(listed))
                for part, one in zip(named.values(), files, strict=True):
                    with (part.content or part.path).open("rb") as content:
                        _add(archive, one.name, one.bytes, one.mode, content)
            file.flush()
            os.fsync(file.fileno())
        _check(partial)  # a file that was written meanwhile does not have its digest
        partial.rename(target)
        sync_folder(target.parent)
    except InputError:
        raise FailedError(f"{target}: a file changed while it was read; there is no backup: try again") from None
    except OSError as error:
        raise FailedError(f"{error.filename or target}: {error.strerror or error}; there is no backup") from None
    finally:
        with suppress(OSError):
            partial.unlink()
    return [*(one.name for one in files), *(f"{name}/" for name in folders)]


def restore_archive(archive: Path, folder: Path, root: Path | None) -> list[Path]:
    """Restore all files and folders of an archive, or none; return where they are.

    Parameters
    ----------
    archive : as `write_archive` makes it
    folder : for the files from the folder of the configuration
    root : for files from elsewhere, which are put below it; None: there may be none

    Raises
    ------
    InputError
        It is no archive, damaged, or has files that are there already or would leave `folder` and `root`.
    FailedError
        A file cannot be written.
    """
    head = _check(archive)
    files = head.files
    targets = [_target_of(archive, one.name, folder, root) for one in files]
    empty = [_target_of(archive, name, folder, root) for name in head.folders]
    present = [path for target in targets for path in _find_present(target)]
    if present := present + [str(target) for target in empty if os.path.lexists(target) and not target.is_dir()]:
        raise InputError(f"{', '.join(present[:3])}: there already; a restore overwrites nothing: move it away")
    made: list[Path] = []
    try:
        with _opened(archive) as contents:
            next(contents)
            partials = [
                _unpack(content, target, one, made)
                for (_, content), target, one in zip(contents, targets, files, strict=True)
            ]
        for partial, target in zip(partials, targets, strict=True):
            if os.path.lexists(target):
                raise InputError(f"{target}: came meanwhile; nothing was restored")
            partial.rename(target)
            made.append(target)
        for target in empty:
            _make_folders(target, made)
        for parent in {one.parent for one in made}:
            sync_folder(parent)
    except OSError as error:
        _remove(made)
        raise FailedError(f"{error.filename or folder}: {error.strerror or error}; nothing was restored") from None
    except BaseException:
        _remove(made)
        raise
    return targets + empty


def _find_present(target: Path) -> list[str]:
    """Return what is at a target, or would damage what is restored there."""
    return [path for end in ("", *_BESIDE_RECORD) if os.path.lexists(path := f"{target}{end}")]


def _name_of(path: Path, folder: Path) -> str:
    """Return the name of a file in the archive of a configuration in this folder."""
    path, base = Path(os.path.abspath(path)), Path(os.path.abspath(folder))  # noqa: PTH100  # links stay
    return f"{_FOLDER}/{path.relative_to(base)}" if path.is_relative_to(base) else f"{_ROOT}{path}"


def _describe(name: str, part: Part) -> _File:
    """Return what the list says of a file. A snapshot has the mode of the file that it is of."""
    content = part.content or part.path
    with content.open("rb") as file:
        digest = hashlib.file_digest(file, "sha256").hexdigest()
    mode = 0o600 if part.is_secret else part.path.stat().st_mode & 0o755
    return _File(name=name, sha256=digest, bytes=content.stat().st_size, mode=mode)


def _add(archive: tarfile.TarFile, name: str, size: int, mode: int, content: IO[bytes]) -> None:
    member = tarfile.TarInfo(name)
    member.size, member.mode = size, mode
    archive.addfile(member, content)


@contextmanager
def _opened(path: Path) -> Iterator[Iterator[tuple[str, IO[bytes]]]]:
    """Give the names and contents of an archive, one after another; raises InputError."""
    try:
        with tarfile.open(path, "r:gz") as archive:
            yield _contents(archive, path)
    except (tarfile.TarError, EOFError, zlib.error) as error:
        raise InputError(f"{path}: not a whole archive of `backup`: {error}") from None


def _contents(archive: tarfile.TarFile, path: Path) -> Iterator[tuple[str, IO[bytes]]]:
    for member in archive:
        content = archive.extractfile(member) if member.isreg() else None
        if content is None:
            raise InputError(f"{path}: {member.name} is not a file; no archive of `backup` has that")
        yield member.name, content


def _check(path: Path) -> _List:
    """Return the list of an archive all of whose files are whole, and are there; raises InputError."""
    damaged = f"{path}: not a whole archive of `backup`"
    try:
        with _opened(path) as contents:
            name, content = next(contents, ("", io.BytesIO()))
            if name != _LIST:
                raise InputError(f"{damaged}: it has no list")
            head = _List.model_validate_json(content.read(_MAX_LIST_BYTES))
            for one in head.files:
                name, content = next(contents, ("nothing", io.BytesIO()))
                if name != one.name or _digest(content, one.bytes) != one.sha256:
                    raise InputError(f"{damaged}: {one.name} is not as its list says")
            if next(contents, None):
                raise InputError(f"{damaged}: it has files that its list does not have")
    except InputError:
        raise
    except ValidationError as error:
        raise InputError(f"{damaged}: its list: {error.errors()[0]['msg']}") from None
    except _UNREADABLE as error:
        raise InputError(f"{damaged}: {getattr(error, 'strerror', None) or error}") from None
    return head


def _digest(content: IO[bytes], size: int, copy: IO[bytes] | None = None) -> str:
    """Return the digest of as many bytes as are expected, and of one more if there are; copy them."""
    digest, left = hashlib.sha256(), size + 1
    while left and (part := content.read(min(left, _AT_ONCE))):
        digest.update(part)
        left -= len(part)
        if copy:
            copy.write(part)
    return digest.hexdigest()


def _target_of(archive: Path, name: str, folder: Path, root: Path | None) -> Path:
    """Return where to put a file; raises InputError if that is outside of the folder and the root."""
    first, *parts = PurePosixPath(name).parts or ("",)
    if first not in (_FOLDER, _ROOT) or not parts or ".." in parts or "\0" in name:
        raise InputError(f"{archive}: {name} would leave the folder; nothing was restored")
    if first == _ROOT and root is None:
        where = f"/{'/'.join(parts)}"
        raise InputError(
            f"{archive}: {where} is not from the folder of the configuration; add --root / to put it there"
        )
    base = folder if first == _FOLDER or root is None else root
    target = base.joinpath(*parts)
    if not target.parent.resolve().is_relative_to(base.resolve()):
        raise InputError(f"{target}: a link leads out of {base}; nothing was restored")
    return target


def _unpack(content: IO[bytes], target: Path, one: _File, made: list[Path]) -> Path:
    """Write a file beside its target; return it. What was made is added to `made`."""
    _make_folders(target.parent, made)
    partial = partial_of(target)
    made.append(partial)  # before it is there: a signal may come between
    descriptor = os.open(partial, os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o600)
    with os.fdopen(descriptor, "wb") as file:
        if _digest(content, one.bytes, file) != one.sha256:
            raise InputError(f"{target}: the archive changed meanwhile; nothing was restored")
        os.fchmod(descriptor, one.mode & 0o755)
        file.flush()
        os.fsync(descriptor)
    return partial


def _make_folders(target: Path, made: list[Path]) -> None:
    """Make a folder and those above it, as far as they are missing. What was made is added to `made`."""
    missing = [folder for folder in (target, *target.parents) if not folder.exists()]
    for folder in reversed(missing):
        folder.mkdir()
        made.append(folder)


def _remove(made: Sequence[Path]) -> None:
    """Remove files and folders that were made, the last one first."""
    for path in reversed(made):
        with suppress(OSError):
            path.rmdir() if path.is_dir() and not path.is_symlink() else path.unlink()
