"""Model files in stages: the candidate beside the model is taken, and the previous model is taken back.

At each moment, the name of the model stands for a whole, checked model: whatever ends a command, the old one or the new
one is there, and the command can be typed again.
"""

import errno
import hashlib
import json
import re
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

from beamtouch_common.errors import FailedError, InputError
from beamtouch_common.files import sync_folder, write_atomically
from beamtouch_common.table import aligned
from beamtouch_models import runtime
from beamtouch_models.runtime import ModelFile, ModelFileError
from beamtouch_service.config import Settings
from beamtouch_service.host.models import Stamp, find_zone_conflict, parse, stamp_of
from beamtouch_service.sections import SurfaceSection

_DIGITS = 12
"""First digits of a digest that are printed: enough to tell any two models apart."""
_DIGEST = re.compile("[0-9a-f]{6,64}")


def candidate_of(model: Path) -> Path:
    """Return where the candidate of a model file is, if there is one."""
    return model.with_name(f"{model.stem}.candidate{model.suffix}")


def previous_of(model: Path) -> Path:
    """Return where the model is that was there before the last `take`, if there was one."""
    return model.with_name(f"{model.stem}.previous{model.suffix}")


def staged_beside(model: Path | None) -> list[Path]:
    """Return the candidate and the previous model of a file, as far as they are there."""
    return [path for path in (candidate_of(model), previous_of(model)) if path.is_file()] if model else []


@dataclass(frozen=True)
class _Staged:
    """One file, read once: what is checked is what is taken."""

    path: Path
    content: bytes
    model: ModelFile | None
    """None if a service would refuse it."""
    stamp: Stamp | None
    """Of the file, before it was read."""
    error: str = ""
    """Why it would."""

    @property
    def digest(self) -> str:
        return hashlib.sha256(self.content).hexdigest()

    @property
    def described(self) -> str:
        """Name and digest."""
        name = self.model.identity if self.model else "a damaged file"
        return f"{name} (sha256 {self.digest[:_DIGITS]})"


def _read(path: Path) -> _Staged | None:
    """Read a file; None if there is none. Raises InputError if it cannot be read."""
    try:
        if not path.exists():
            return None
        stamp, content = stamp_of(path), runtime.read(path)
    except OSError as error:  # a folder above it is closed to this user
        raise InputError(f"{path}: {error.strerror}") from None
    except ModelFileError as error:
        raise InputError(f"model {error}") from None
    try:
        return _Staged(path, content, parse(content, str(path)), stamp)
    except ModelFileError as error:
        return _Staged(path, content, None, stamp, str(error))


def report(settings: Settings, *, as_json: bool) -> str:
    """Return which models, candidates and previous models there are."""
    listed: dict[str, dict[str, dict[str, str | None] | None]] = {}
    for name, section in settings.surfaces.items():
        paths = _paths(section.model) if section.model else {}
        listed[name] = {kind: _describe(path) for kind, path in paths.items()}
    if as_json:
        return json.dumps({"surfaces": listed})
    rows = [
        [name, kind, (file["sha256"] or "")[:_DIGITS], file["error"] or file["identity"] or ""]
        for name, files in listed.items()
        for kind, file in files.items()
        if file
    ]
    return "\n".join(aligned(["surface", "file", "sha256", "model"], rows)) if rows else "no model files"


def _paths(model: Path) -> dict[str, Path]:
    return {"model": model, "candidate": candidate_of(model), "previous": previous_of(model)}


def _describe(path: Path) -> dict[str, str | None] | None:
    try:
        staged = _read(path)
    except InputError as error:
        return {"path": str(path), "sha256": None, "identity": None, "error": str(error)}
    if staged is None:
        return None
    identity = staged.model.identity if staged.model else None
    return {"path": str(path), "sha256": staged.digest, "identity": identity, "error": staged.error or None}


def take(settings: Settings, surface: str, digest: str | None = None) -> str:
    """Put the candidate of a surface in the place of its model; return what to say.

    Raises
    ------
    InputError
        There is no candidate, or another one than that of the digest, or a service would not use it.
    FailedError
        A file cannot be written. The model is the old one or the new one.
    """
    path = _find(settings, surface)
    candidate, model = _read(candidate_of(path)), _read(path)
    if candidate is None:
        raise InputError(f"surface {surface}: nothing to take: there is no {candidate_of(path)}")
    _require_digest(candidate, digest)
    _require_fit(settings, surface, candidate, model)
    with _writing(path.parent):
        if model and model.model:
            _write(previous_of(path), model.content, like=path)
        _write(path, candidate.content, like=path if model else candidate.path)
        if stamp_of(candidate.path) == candidate.stamp:  # else a newer one came meanwhile
            candidate.path.unlink(missing_ok=True)
    return _say(surface, candidate, model)


def take_back(settings: Settings, surface: str) -> str:
    """Put the previous model of a surface back in its place; return what to say. Raises what `take` raises."""
    path = _find(settings, surface)
    previous, model = _read(previous_of(path)), _read(path)
    if previous is None:
        raise InputError(f"surface {surface}: nothing to take back: there is no {previous_of(path)}")
    _require_fit(settings, surface, previous, model)
    candidate = candidate_of(path)
    # A candidate that came meanwhile is somebody's newer wish, unless it is a copy of the model that was taken.
    is_free = not candidate.exists() or (model is not None and _holds(candidate, model.content))
    with _writing(path.parent):
        if model and model.model and is_free:
            _write(candidate, model.content, like=path)
        _write(path, previous.content, like=path if model else previous.path)
        if model and model.model and not is_free:
            _write(previous.path, model.content, like=path)
        else:
            previous.path.unlink(missing_ok=True)
    return _say(surface, previous, model)


def _holds(path: Path, content: bytes) -> bool:
    """Return whether a file has this content; one that cannot be read has another one."""
    try:
        return runtime.read(path) == content
    except ModelFileError:
        return False


def _find(settings: Settings, surface: str) -> Path:
    section = settings.surfaces.get(surface)
    if section is None:
        names = ", ".join(settings.surfaces) or "none"
        raise InputError(f"no surface is called {surface!r}; the surfaces are {names}")
    if section.model is None:
        raise InputError(f"surface {surface} has no model; set surfaces.{surface}.model in the configuration")
    return section.model


def _sharing(settings: Settings, surface: str) -> dict[str, SurfaceSection]:
    """Return the surfaces that have the model file of this one, it among them."""
    path = _find(settings, surface).resolve()
    return {name: one for name, one in settings.surfaces.items() if one.model and one.model.resolve() == path}


def _require_digest(candidate: _Staged, digest: str | None) -> None:
    """Raise InputError if the candidate does not have this digest."""
    if digest is None:
        return
    wanted = digest.lower()
    if not _DIGEST.fullmatch(wanted):
        raise InputError(f"--digest {digest} is no SHA-256; give at least its first 6 hexadecimal digits")
    if not candidate.digest.startswith(wanted):
        raise InputError(f"{candidate.path}: its digest is {candidate.digest}, not {digest}; nothing was changed")


def _require_fit(settings: Settings, surface: str, staged: _Staged, model: _Staged | None) -> None:
    """Raise InputError unless a service that runs with a model would use another one in its place.

    That holds for each surface with the same model file.
    """
    if staged.model is None:
        raise InputError(f"model {staged.error}")
    if model and model.content == staged.content:
        raise InputError(f"surface {surface}: {staged.path} is the model in use already; remove it")
    for name, section in _sharing(settings, surface).items():
        if conflict := find_zone_conflict(section, staged.model):
            raise InputError(f"{staged.path}: surfaces.{name}.zones.{conflict}")
    old = model.model.metadata if model and model.model else None
    if old and old.beam != staged.model.metadata.beam:
        beams = f"it is of {old.outline.kind} {staged.model.metadata.beam}, the model in use of {old.beam}"
        raise InputError(f"{staged.path}: {beams}; to change the beam, replace model and daemon configuration by hand")


@contextmanager
def _writing(folder: Path) -> Iterator[None]:
    """Report in one line what the disk refuses, and let the names in the folder survive a loss of power."""
    try:
        yield
        sync_folder(folder)
    except OSError as error:
        forbidden = error.errno in {errno.EACCES, errno.EPERM, errno.EROFS}
        advice = "the command must be able to write there" if forbidden else "type the command again"
        raise FailedError(f"{error.filename or folder}: {error.strerror}; {advice}") from None


def _write(path: Path, content: bytes, like: Path) -> None:
    """Replace a file in one step, with owner and permissions of another; on the disk before anything follows."""
    status = like.stat()
    write_atomically(path, content, mode=status.st_mode & 0o777, owner=(status.st_uid, status.st_gid))


def _say(surface: str, now: _Staged, before: _Staged | None) -> str:
    instead = f" instead of {before.described}" if before else ""
    return f"surface {surface}: {now.described}{instead}; a running service uses it within a few seconds"
