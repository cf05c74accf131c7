"""The command line: one line for each error, and the exit code."""

from __future__ import annotations

import pytest

from beamtouch_common.commands import version
from beamtouch_service import cli


def ended(arguments: list[str]) -> int:
    """Return the exit code of a command that ends while it reads its options."""
    with pytest.raises(SystemExit) as end:
        cli.main(arguments)
    assert isinstance(end.value.code, int)
    return end.value.code


def test_version_names_the_program_and_its_version(capsys: pytest.CaptureFixture[str]) -> None:
    assert ended(["--version"]) == 0
    assert capsys.readouterr().out == f"beamtouch-service {version()}\n"


@pytest.mark.parametrize(
    ("arguments", "complaint"),
    [
        ([], "the following arguments are required: COMMAND"),
        (["run", "--port", "many"], "argument --port: not a whole number: 'many'"),
        (["run", "--hos", "::1"], "unknown argument --hos ::1; see beamtouch-service run --help"),
        (["check"], "one of the arguments MODEL --config is required"),
    ],
)
def test_a_wrong_option_is_one_line_and_exit_code_2(
    arguments: list[str], complaint: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert ended(arguments) == 2
    captured = capsys.readouterr()
    assert captured.out == ""
    assert captured.err.count("\n") == 1
    assert complaint in captured.err


def test_a_wrong_setting_is_one_line_and_exit_code_2(capsys: pytest.CaptureFixture[str]) -> None:
    assert cli.main(["run", "--stale-ms", "nan"]) == 2
    assert capsys.readouterr().err == (
        "beamtouch-service: command line: --stale-ms: must be a finite number (given: NaN)\n"
    )
