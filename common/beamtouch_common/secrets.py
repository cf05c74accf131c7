"""Reads tokens and passwords from files."""

from pathlib import Path

from beamtouch_common.encodings import SAVE, other_encoding
from beamtouch_common.errors import FailedError, InputError

MIN_TOKEN_CHARACTERS = 16
MAX_BYTES = 4096
"""Largest file of a secret; a larger file was given by mistake."""
NEW_TOKEN = f"write at least {MIN_TOKEN_CHARACTERS} random characters to it, as `openssl rand -hex 32` prints them"


def read_token(path: Path, remedy: str = NEW_TOKEN) -> str:
    """Return the token in a file, without white space around it.

    Parameters
    ----------
    path : the file
    remedy : end of the messages, what to do

    Raises
    ------
    InputError
        The file holds no usable token.
    FailedError
        The file cannot be read; it may come later.
    """
    content = _read(path, "token", remedy)
    token = content.decode("utf-8-sig", "replace").strip()
    if len(content) > MAX_BYTES:
        problem = f"longer than {MAX_BYTES} bytes"
    elif name := other_encoding(content):
        problem = f"in {name}; {SAVE}"
    elif not token:
        problem = "empty"
    elif not all("!" <= character <= "~" for character in token):
        problem = "more than one word of printable ASCII"
    elif len(token) < MIN_TOKEN_CHARACTERS:
        problem = f"only {len(token)} character{'s' if len(token) > 1 else ''}"
    else:
        return token
    raise InputError(f"token file {path}: {problem}; {remedy}")


def read_password(path: Path) -> str:
    """Return the password in a file, without the end of its line; raises what `read_token` raises."""
    remedy = "write the password to it, in one line"
    content = _read(path, "password", remedy)
    if name := other_encoding(content):
        raise InputError(f"password file {path}: in {name}; {SAVE}")
    password = content.decode("utf-8-sig", "replace").removesuffix("\n").removesuffix("\r")
    if not password.isprintable() or not password or "\ufffd" in password or len(content) > MAX_BYTES:
        raise InputError(f"password file {path}: not one line of text; {remedy}")
    return password


def _read(path: Path, kind: str, remedy: str) -> bytes:
    """Return the content of a file, and at most one byte more than allowed."""
    try:
        with path.open("rb") as file:
            return file.read(MAX_BYTES + 1)
    except OSError as error:
        raise FailedError(f"{kind} file {path}: {error.strerror}; {remedy}") from None
