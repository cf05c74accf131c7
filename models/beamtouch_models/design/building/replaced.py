"""Files that a build replaces: what a person has edited, measured or named by mistake is not lost without a word."""

import hashlib
from collections.abc import Callable
from pathlib import Path

from beamtouch_common.encodings import decode
from beamtouch_common.errors import InputError
from beamtouch_models.design.building.stored import stored_in_file
from beamtouch_models.errors import ModelFileError

AS_BUILT = "# design-sensors build replaces this file without --force only as long as nobody has edited it: "
"""Begins the last line of a configuration, before a digest of all others."""
DIGEST_LENGTH = 12
GENERATOR = b'<meta name="generator" content="design-sensors build">'
"""Text that the head of each report has, and no page of another program."""
HEAD = 1000
"""Bytes in which it stands."""
FORCE = "name another file, or add --force to replace it"
UNREADABLE = "it is there, and cannot be read as a model file"


def sealed(text: str) -> str:
    """Return the text of a configuration with a last line that tells whether somebody has edited it since."""
    return f"{text}\n{AS_BUILT}{_digest(text)}\n"


def require_replaceable(
    model: Path | None = None, config: Path | None = None, report: Path | None = None, *, instead: str = FORCE
) -> None:
    """Raise InputError if writing one of these files would lose what no build can make again.

    A file that is not there, is empty, or is a device has nothing to lose.

    Parameters
    ----------
    model, config, report : The files to write.
    instead : What to do instead, for the message.
    """
    judges: tuple[tuple[Path | None, Callable[[Path], str]], ...] = (
        (model, _loss_of_model),
        (config, lambda path: "" if _is_sealed(path) else "it is not as build wrote it"),
        (report, lambda path: "" if GENERATOR in path.read_bytes()[:HEAD] else "it is not a report of build"),
    )
    for path, loss_of in judges:
        if path is None or not _holds_something(path):
            continue
        try:
            loss = loss_of(path)
        except OSError as error:
            raise InputError(f"{path}: {error.strerror}") from None
        if loss:
            raise InputError(f"{path}: {loss}; {instead}")


def require_model(path: Path) -> None:
    """Raise InputError if there is a file that is no model, where one is to be written."""
    if not _holds_something(path):
        return
    try:
        stored_in_file(path)
    except ModelFileError:
        raise InputError(f"{path}: {UNREADABLE}; name another file") from None


def _holds_something(path: Path) -> bool:
    return path.is_file() and path.stat().st_size > 0


def _is_sealed(path: Path) -> bool:
    """Return whether a file is as `sealed` gave it, but for marks and ends of lines, which editors change."""
    try:
        text, _, digest = decode(path.read_bytes()).replace("\r\n", "\n").rpartition(f"\n{AS_BUILT}")
    except ValueError:
        return False
    return digest.rstrip() == _digest(text)


def _digest(text: str) -> str:
    return hashlib.sha256(text.encode()).hexdigest()[:DIGEST_LENGTH]


def _loss_of_model(path: Path) -> str:
    try:
        is_calibrated = stored_in_file(path).get("calibration") is not None
    except ModelFileError:
        return UNREADABLE
    return "it is calibrated, and a new build is not" if is_calibrated else ""
