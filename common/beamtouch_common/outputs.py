"""Files that a command will write, checked before it works for minutes."""

import os
from collections.abc import Sequence
from pathlib import Path

from beamtouch_common.errors import InputError


def require_writable(outputs: Sequence[Path | None], inputs: Sequence[Path | None] = ()) -> None:
    """Raise InputError if an output cannot be written, or would replace an input or another output.

    Parameters
    ----------
    outputs
        Files to write; None for one that was not asked for.
    inputs
        Files that are read and must stay as they are.
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
                message = f"{path}: the command {does}; name another one"
                raise InputError(message)
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
