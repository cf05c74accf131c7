"""What the commands `design-sensors` and `beamtouch-rig` share: arguments, exit codes and messages."""

import argparse
import sys
from collections.abc import Callable
from importlib.metadata import PackageNotFoundError, version
from typing import Any, NoReturn

from beamtouch_models.errors import InputError, NotGoodEnoughError

DONE, FAILED, WRONG_INPUT, INTERRUPTED = 0, 1, 2, 130


class Parser(argparse.ArgumentParser):
    """A parser with `--version` that reports wrong arguments in one line, without the usage."""

    def __init__(self, *arguments: Any, **options: Any) -> None:  # noqa: ANN401  # as ArgumentParser takes them
        super().__init__(*arguments, **options)
        self.add_argument("--version", action="version", version=f"{self.prog.split()[0]} {_version()}")

    def error(self, message: str) -> NoReturn:
        """Print a message and exit with code 2."""
        self.exit(WRONG_INPUT, f"{self.prog}: {message}; see {self.prog} --help\n")


def whole_number(low: int, high: int) -> Callable[[str], int]:
    """Return the type of an argument that is a whole number within a range."""

    def number(text: str) -> int:
        if not (text.isascii() and text.isdecimal() and len(text) < 20 and low <= int(text) <= high):
            message = f"{text!r} is not a whole number from {low} to {high}"
            raise argparse.ArgumentTypeError(message)
        return int(text)

    return number


def exit_code(program: str, extra: str, work: Callable[[], int]) -> int:
    """Run a command and return its exit code; an error that the user can mend is one line on standard error.

    Parameters
    ----------
    program, extra : the command, and the extra of the distribution that it needs
    work : the command; it imports what the extra installs, so that a missing extra is reported here
    """
    try:
        return work()
    except ModuleNotFoundError as error:
        reason, code = f"{error.name} is not installed: pip install 'beamtouch[{extra}]'", WRONG_INPUT
    except InputError as error:
        reason, code = str(error), WRONG_INPUT
    except NotGoodEnoughError as error:
        reason, code = str(error), FAILED
    except OSError as error:
        reason, code = f"{error.filename}: {error.strerror}" if error.filename else str(error), WRONG_INPUT
    except KeyboardInterrupt as stop:
        reason, code = stop.args[0] if stop.args else "interrupted", INTERRUPTED
    print(f"{program}: {reason}", file=sys.stderr)
    return code


def _version() -> str:
    """Return the installed version, or `0+source` in a source tree that is not installed."""
    try:
        return version("beamtouch")
    except PackageNotFoundError:
        return "0+source"
