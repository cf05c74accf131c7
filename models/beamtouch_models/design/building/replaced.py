"""Files that a build replaces: what a person has edited, measured or named by mistake is not lost without a word."""

import hashlib
import json
from collections.abc import Callable
from pathlib import Path

import onnx

from beamtouch_common.encodings import decode
from beamtouch_common.errors import InputError
from beamtouch_models.runtime import loading
from beamtouch_models.runtime.metadata import METADATA_PREFIX

AS_BUILT = "# design-sensors build replaces this file without --force only as long as nobody has edited it: "
"""Begins the last line of a configuration, before a digest of all others."""
DIGEST_LENGTH = 12
PAGE = b"<!doctype html"
FORCE = "name another file, or add --force to replace it"


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
        (report, lambda path: "" if path.read_bytes().lower().startswith(PAGE) else "it is not a report of build"),
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
    if _holds_something(path) and _entries(path) is None:
        raise InputError(f"{path}: it is there, and cannot be read as a model file; name another file")


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
    entries = _entries(path)
    if entries is None:
        return "it is there, and cannot be read as a model file"
    try:
        is_calibrated = json.loads(entries.get(METADATA_PREFIX + "calibration", "null")) is not None
    except ValueError:
        return "it is there, and cannot be read as a model file"
    return "it is calibrated, and a new build is not" if is_calibrated else ""


def _entries(path: Path) -> dict[str, str] | None:
    """Return the metadata entries of a model file of any version; None if it is something else."""
    try:
        entries = {entry.key: entry.value for entry in onnx.load_from_string(loading.read(path)).metadata_props}
    except Exception:  # noqa: BLE001  # protobuf's errors have no common base but Exception
        return None
    return entries if METADATA_PREFIX + "layout" in entries else None
