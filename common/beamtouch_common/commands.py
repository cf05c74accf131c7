"""The contract of all commands: `--version`, errors in one line, and the exit codes 0, 1, 2 and 130."""

from __future__ import annotations

import argparse
import os
import re
import sys
from functools import cache
from importlib import import_module

from beamtouch_common.errors import FailedError, InputError

TYPE_CHECKING = False  # as in `typing`, whose import takes a fifth of the time of `--help`
if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Sequence
    from typing import Any, NoReturn

DONE, FAILED, WRONG_INPUT = 0, 1, 2
INTERRUPTED = 130
"""After Ctrl-C, as shells report it: 128 plus the number of the signal."""
_PLAIN = {"invalid float value": "not a number", "invalid int value": "not a whole number"}
"""Words of argparse, in plain ones."""


class _ShowVersion(argparse.Action):
    """Prints the version, which is looked up only then: that takes as long as all the rest of `--help`."""

    def __init__(self, option_strings: Sequence[str], dest: str) -> None:
        words = "show program's version number and exit"
        super().__init__(option_strings, dest, nargs=0, default=argparse.SUPPRESS, help=words)

    def __call__(self, parser: argparse.ArgumentParser, *_: object) -> None:
        """Print it and exit."""
        print(f"{parser.prog.split()[0]} {version()}")
        parser.exit()


class Parser(argparse.ArgumentParser):
    """A parser with `--version` that reports wrong arguments in one line, without the usage; so do its subcommands."""

    def __init__(self, *arguments: Any, **options: Any) -> None:  # noqa: ANN401  # as ArgumentParser takes them
        options.setdefault("allow_abbrev", False)  # an abbreviation may mean something else in the next version
        super().__init__(*arguments, **options)
        self.add_argument("--version", action=_ShowVersion)

    def parse_known_args(self, args: Iterable[str] | None = None, namespace: object = None) -> tuple[Any, list[str]]:
        """Parse arguments, and refuse unknown ones here: the parser of a subcommand names its own help."""
        known, unknown = super().parse_known_args(args, namespace)
        if unknown:
            self.error(f"unknown argument {' '.join(unknown)}")
        return known, unknown

    def error(self, message: str) -> NoReturn:
        """Print a message and exit with code 2."""
        for theirs, plain in _PLAIN.items():
            message = message.replace(theirs, plain)
        # Python 3.12 and later print the choices without quotes.
        message = re.sub(r"\(choose from .*\)", lambda choices: choices[0].replace("'", ""), message)
        self.exit(complain(self.prog, f"{message}; see {self.prog} --help", WRONG_INPUT))


def whole_number(low: int, high: int) -> Callable[[str], int]:
    """Return the type of an argument that is a whole number within a range."""

    def number(text: str) -> int:
        if not (text.isascii() and text.isdecimal() and len(text) < 20 and low <= int(text) <= high):
            raise argparse.ArgumentTypeError(f"{text!r} is not a whole number from {low} to {high}")
        return int(text)

    return number


def exit_code(
    program: str,
    extra: str,
    work: Callable[[], int],
    input_errors: tuple[type[Exception], ...] = (InputError,),
) -> int:
    """Run a command and return its exit code; an expected error is one line on standard error.

    Parameters
    ----------
    program : Name of the command.
    extra : The extra of the distribution that the command needs.
    work : The command. It imports what the extra installs, so that a missing extra is reported here.
    input_errors : Errors that mean wrong input.
    """
    try:
        code = work()
        if sys.stdout is not None:  # None if it was closed before the start
            sys.stdout.flush()
    except KeyboardInterrupt as stop:
        return complain(program, str(stop) or "interrupted", INTERRUPTED)
    except ModuleNotFoundError as error:
        name = (error.name or "").partition(".")[0]
        if not name or name in sys.stdlib_module_names or name.startswith("beamtouch_"):
            raise
        return complain(program, f"{name} is not installed; run: pip install 'beamtouch[{extra}]'", WRONG_INPUT)
    except Exception as error:
        expected = _complain_of(error, program, input_errors)
        if expected is None:
            raise
        return expected
    return code


def _complain_of(error: Exception, program: str, input_errors: tuple[type[Exception], ...]) -> int | None:
    """Report an expected error in one line and return its exit code; None for any other."""
    if _is_interrupted(error):
        return complain(program, "interrupted", INTERRUPTED)
    names_no_file = isinstance(error, OSError) and error.filename is None
    is_output_lost = _is_output_lost(tries=names_no_file)
    if isinstance(error, OSError) and (is_output_lost or (names_no_file and isinstance(error, BrokenPipeError))):
        return complain(program, f"not all was printed to standard output: {error.strerror}", FAILED)
    if isinstance(error, FailedError):
        for line in error.args:
            complain(program, line, FAILED)
        return FAILED
    if isinstance(error, input_errors):
        return complain(program, _text(error), WRONG_INPUT)
    return None


def complain(program: str, text: str, code: int) -> int:
    """Print one line to standard error, with control characters escaped, and return `code`."""
    line = " ".join(text.split())
    shown = "".join(sign if sign.isprintable() else sign.encode("unicode_escape").decode() for sign in line)
    print(f"{program}: {shown}", file=sys.stderr)
    return code


def announce(line: str) -> None:
    """Print a line at once. A command runs on even if its output is closed."""
    try:
        print(line, flush=True)
    except OSError:
        _is_output_lost()


def _is_interrupted(error: BaseException | None) -> bool:
    """Return whether Ctrl-C caused an error: an interrupted import of compiled code fails with an ImportError."""
    while error is not None and not isinstance(error, KeyboardInterrupt):
        error = error.__cause__ or error.__context__
    return error is not None


def _is_output_lost(*, tries: bool = False) -> bool:
    """Return whether standard output is closed or full. If so, drop its buffer: Python would fail at its end.

    A write that fails may leave nothing to write, so that only another one fails again: `tries` writes a line end.
    """
    try:
        if sys.stdout is not None:
            sys.stdout.write("\n" * tries)
            sys.stdout.flush()
    except OSError:
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return True
    return False


@cache
def version() -> str:
    """Return the installed version."""
    return str(import_module("importlib.metadata").version("beamtouch"))


def _text(error: Exception) -> str:
    if isinstance(error, OSError) and error.filename:
        return f"{error.filename}: {error.strerror}"
    return str(error)
