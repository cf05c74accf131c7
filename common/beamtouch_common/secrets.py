"""Reads tokens and passwords from files."""

import re
from pathlib import Path

from beamtouch_common.encodings import SAVE, other_encoding
from beamtouch_common.errors import FailedError, InputError

MIN_TOKEN_CHARACTERS = 16
_NAME = re.compile(r"[A-Za-z0-9][A-Za-z0-9._-]{0,39}")
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
    token = _read_text(path, remedy)
    if problem := _find_flaw(token):
        raise InputError(f"token file {path}: {problem}; {remedy}")
    return token


def read_tokens(path: Path, name: str) -> dict[str, str]:
    """Return the tokens in a file by their names, one a line: `NAME TOKEN`, or a token alone.

    Parameters
    ----------
    path : the file
    name : the name of the only token without one; of several lines, `name-2` is that of the second line

    Raises
    ------
    InputError
        The file holds no usable token, or two lines have the same name or the same token.
    FailedError
        The file cannot be read; it may come later.
    """
    lines = _read_text(path, NEW_TOKEN).splitlines() or [""]
    tokens: dict[str, str] = {}
    for number, line in enumerate(lines, 1):
        where = f"token file {path}: line {number}: " if len(lines) > 1 else f"token file {path}: "
        *named, token = line.split() or [""]
        if len(lines) > 1 and not token:
            continue
        own = named[0] if named else f"{name}-{number}" if len(lines) > 1 else name
        if len(named) > 1 or not _NAME.fullmatch(own):
            advice = "write a token, or its name, a space and the token; a name has up to 40 letters, digits, . _ and -"
            raise InputError(f"{where}neither TOKEN nor NAME TOKEN; {advice}")
        if problem := _find_flaw(token):
            raise InputError(f"{where}{problem}; {NEW_TOKEN}")
        if own in tokens or token in tokens.values():
            what = f"the name {own}" if own in tokens else "the token"
            raise InputError(f"{where}{what} stands in a line before; each needs its own")
        tokens[own] = token
    return tokens


def _read_text(path: Path, remedy: str) -> str:
    """Return the text of a token file, without white space around it; raises what `read_token` raises."""
    content = _read(path, "token", remedy)
    if len(content) > MAX_BYTES:
        raise InputError(f"token file {path}: longer than {MAX_BYTES} bytes; {remedy}")
    if name := other_encoding(content):
        raise InputError(f"token file {path}: in {name}; {SAVE}; {remedy}")
    return content.decode("utf-8-sig", "replace").strip()


def _find_flaw(token: str) -> str:
    """Return why a token cannot be used; empty if it can."""
    if not token:
        return "empty"
    if not all("!" <= character <= "~" for character in token):
        return "more than one word of printable ASCII"
    if len(token) < MIN_TOKEN_CHARACTERS:
        return f"only {len(token)} character{'s' if len(token) > 1 else ''}"
    return ""


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
