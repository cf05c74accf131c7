"""Name of the command, and the one line that explains a failure."""

from beamtouch_common import commands

PROGRAM = "beamtouch-daemon"


def complain(text: str) -> int:
    """Print one line to standard error and return the exit code of a failure."""
    return commands.complain(PROGRAM, text, commands.FAILED)
