"""Commands that refuse their input, in the process of the test."""

from collections.abc import Callable

import pytest

from beamtouch_daemon.cli import main
from support.programs.in_process import command_of

Refused = Callable[..., str]


@pytest.fixture
def refused(capsys: pytest.CaptureFixture[str]) -> Refused:
    """A function from the arguments of a command to its only line of complaint; by default its exit code is 2."""
    run = command_of(main, capsys)

    def complaint(*arguments: object, code: int = 2) -> str:
        done = run(*arguments)
        assert (done.returncode, done.stdout, done.stderr.count("\n")) == (code, "", 1), done
        return done.stderr.removesuffix("\n").removeprefix("beamtouch-daemon").lstrip(": ")

    return complaint
