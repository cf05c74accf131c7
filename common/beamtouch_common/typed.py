"""Standard input that a person or a script types answers into."""

import io
import sys


def is_terminal() -> bool:
    """Return whether a person can answer. Standard input may be closed."""
    return sys.stdin is not None and sys.stdin.isatty()


def typed_line() -> str:
    """Return the next line with its line end; empty at the end, or if standard input cannot be read.

    Bytes that are no text become lone surrogates, as in names of files: a wrong answer, or the name of a file.
    """
    if sys.stdin is None:
        return ""
    if isinstance(sys.stdin, io.TextIOWrapper) and sys.stdin.errors != "surrogateescape":
        sys.stdin.reconfigure(errors="surrogateescape")
    try:
        return sys.stdin.readline()
    except OSError:  # the terminal is gone
        return ""
