"""Commands run in the test's process: started anew, each spends most of a second on its imports."""

from collections.abc import Callable
from dataclasses import dataclass

import pytest


@dataclass(frozen=True)
class Outcome:
    """Exit code and output, named as in `subprocess.CompletedProcess`."""

    returncode: object
    stdout: str
    stderr: str

    @property
    def noted(self) -> str:
        """Return what is said on standard error, in one line: notes are broken to fit a page."""
        return " ".join(self.stderr.split())


Command = Callable[..., Outcome]
Refusal = Callable[..., str]
"""Runs a command that is wrong input, and returns the one line that it says."""


def command_of(main: Callable[[list[str]], int], capsys: pytest.CaptureFixture[str]) -> Command:
    """A function that takes the arguments of a command and runs its `main`."""

    def run(*arguments: object) -> Outcome:
        capsys.readouterr()
        code: object
        try:
            code = main([str(one) for one in arguments])
        except SystemExit as end:  # argparse refuses arguments in this way
            code = end.code
        told = capsys.readouterr()
        return Outcome(code, told.out, told.err)

    return run
