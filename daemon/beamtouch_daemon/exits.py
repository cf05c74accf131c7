"""Exit codes of the command line, the error behind exit code 2, and the one line that explains a failure."""

import sys

DONE, FAILED, WRONG_INPUT = 0, 1, 2
INTERRUPTED = 130
"""After Ctrl-C, as shells report it: 128 plus the number of the signal."""


class ConfigError(Exception):
    """The configuration cannot be used; the text is one line for the user."""


def complain(text: str, code: int) -> int:
    """Print one line to standard error and return `code`."""
    print(f"beamtouch-daemon: {' '.join(text.split())}", file=sys.stderr)
    return code
