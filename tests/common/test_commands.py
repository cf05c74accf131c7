"""The contract that all commands and subcommands keep: `--version`, wrong input in one line, and Ctrl-C."""

import os
import re
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from contextlib import redirect_stdout, suppress
from io import StringIO
from pathlib import Path

import httpx2
import pytest

import beamtouch_common
import beamtouch_models
from beamtouch_common.commands import exit_code, version
from beamtouch_common.errors import FailedError
from beamtouch_daemon import cli as daemon
from beamtouch_models import cli as design
from beamtouch_models.lab.rig import cli as rig
from beamtouch_service import cli as service
from support.network.free_ports import free_port
from support.running.waiting import wait_until
from support.surfaces.example_scenes import SCENES

Main = Callable[[list[str]], int]
PROGRAMS: dict[str, tuple[Main, str]] = {
    "beamtouch-daemon": (daemon.main, "beamtouch_daemon"),
    "beamtouch-service": (service.main, "beamtouch_service.cli"),
    "design-sensors": (design.main, "beamtouch_models.cli"),
    "beamtouch-rig": (rig.main, "beamtouch_models.lab.rig.cli"),
}


def subcommands(main: Main) -> list[str]:
    """Return the subcommands that the help of a command lists; empty if it has none."""
    with redirect_stdout(StringIO()) as shown, suppress(SystemExit):
        main(["--help"])
    return re.findall(r"^    ([a-z]+)", shown.getvalue(), re.MULTILINE)


COMMANDS: list[tuple[str, ...]] = [
    command
    for program, (main, _) in PROGRAMS.items()
    for command in ((program,), *((program, name) for name in subcommands(main)))
]
"""Each command, and each of its subcommands."""
READING: dict[str, list[str]] = {
    "beamtouch-daemon": ["tare", "PIPE"],
    "beamtouch-service": ["run", "--config", "PIPE"],
    "design-sensors": ["explain", "PIPE"],
    "beamtouch-rig": ["PIPE", "--model", "model.onnx", "--serial", "line"],
}
"""Arguments with which a program reads a pipe, and so can be interrupted at its work."""


def ended(main: Main, arguments: list[str]) -> int:
    """Return the exit code of a command that ends while it reads its arguments."""
    with pytest.raises(SystemExit) as end:
        main(arguments)
    assert isinstance(end.value.code, int)
    return end.value.code


@pytest.mark.parametrize("command", COMMANDS, ids=" ".join)
def test_every_command_prints_its_version(command: tuple[str, ...], capsys: pytest.CaptureFixture[str]) -> None:
    program, *subcommand = command
    assert ended(PROGRAMS[program][0], [*subcommand, "--version"]) == 0
    assert capsys.readouterr() == (f"{program} {version()}\n", "")


@pytest.mark.parametrize("command", COMMANDS, ids=" ".join)
@pytest.mark.parametrize("arguments", [["--not-an\noption"], ["one", "argument", "too", "many", "for", "all"]])
def test_wrong_arguments_of_every_command_are_one_line_and_exit_code_2(
    command: tuple[str, ...], arguments: list[str], capsys: pytest.CaptureFixture[str]
) -> None:
    program, *subcommand = command
    assert ended(PROGRAMS[program][0], [*subcommand, *arguments]) == 2
    output, errors = capsys.readouterr()
    assert (output, errors.count("\n")) == ("", 1)
    assert errors.startswith(program)
    assert errors.endswith(" --help\n")


@pytest.mark.parametrize("program", READING)
def test_ctrl_c_is_130_and_one_line(program: str, tmp_path: Path) -> None:
    pipe = tmp_path / "PIPE"
    os.mkfifo(pipe)
    line = [sys.executable, "-m", PROGRAMS[program][1], *READING[program]]
    with subprocess.Popen(line, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, cwd=tmp_path) as process:
        try:
            writer = opened_by_its_reader(pipe, process)
            process.send_signal(signal.SIGINT)
            # A read that begins just after the signal would wait for ever: Python takes the signal when it returns.
            os.close(writer)
            output, errors = process.communicate(timeout=60)
        finally:
            process.kill()
    assert (process.returncode, output, errors.count("\n")) == (130, "", 1)
    assert errors.startswith(f"{program}: interrupted")


def test_ctrl_c_in_the_import_of_compiled_code_is_130(capsys: pytest.CaptureFixture[str]) -> None:
    def work() -> int:
        try:
            raise KeyboardInterrupt  # in the initialisation of an extension module
        except KeyboardInterrupt as stop:
            raise ImportError("initialization failed") from stop

    assert exit_code("press", "design", work) == 130
    assert capsys.readouterr() == ("", "press: interrupted\n")


def test_a_failure_is_a_line_for_each_of_its_reasons(capsys: pytest.CaptureFixture[str]) -> None:
    def work() -> int:
        raise FailedError("s1 is stuck", "s2 is\nmissing")

    assert exit_code("press", "design", work) == 1
    assert capsys.readouterr() == ("", "press: s1 is stuck\npress: s2 is missing\n")


def opened_by_its_reader(pipe: Path, process: subprocess.Popen[str]) -> int:
    """Open a pipe for writing once the process reads from it."""
    deadline_s = time.monotonic() + 60
    while time.monotonic() < deadline_s:
        with suppress(OSError):  # nobody reads yet
            return os.open(pipe, os.O_WRONLY | os.O_NONBLOCK)
        assert process.poll() is None, process.communicate()
        time.sleep(0.02)
    pytest.fail(f"nobody reads {pipe}")


REGISTERS = [sys.executable, "-m", "beamtouch_service.cli", "registers"]
"""A command that prints much, and does nothing else."""
EXPLAIN = [sys.executable, "-m", "beamtouch_models.cli", "explain", str(SCENES / "bench.toml")]
"""One that prints a table."""


@pytest.mark.parametrize(
    ("where", "buffering", "reason"),
    [("pipe", "", "Broken pipe"), ("pipe", "1", "Broken pipe"), ("/dev/full", "", "No space left on device")],
)
def test_an_output_that_is_lost_is_a_failure_in_one_line(where: str, buffering: str, reason: str) -> None:
    reader, writer = os.pipe() if where == "pipe" else (os.open(where, os.O_RDONLY), os.open(where, os.O_WRONLY))
    os.close(reader)
    environment = {**os.environ, "PYTHONUNBUFFERED": buffering}
    done = subprocess.run(
        REGISTERS, stdout=writer, stderr=subprocess.PIPE, env=environment, text=True, check=False, timeout=60
    )
    os.close(writer)
    said = f"beamtouch-service: not all was printed to standard output: {reason}\n"
    assert (done.returncode, done.stderr) == (1, said)


@pytest.mark.parametrize("command", [REGISTERS, EXPLAIN], ids=["lines", "a table"])
def test_a_command_without_standard_output_does_its_work(command: list[str]) -> None:
    done = subprocess.run(
        ["sh", "-c", 'exec "$@" >&-', "sh", *command], stderr=subprocess.PIPE, text=True, check=False, timeout=60
    )
    assert (done.returncode, done.stderr) == (0, "")


def test_a_service_whose_output_is_full_serves_all_the_same(tmp_path: Path) -> None:
    port, token = free_port(), tmp_path / "token"
    token.write_text("swordfish-of-the-tests-and-longer")
    command = [
        sys.executable,
        "-m",
        "beamtouch_service.cli",
        "run",
        "--port",
        str(port),
        "--write-token-file",
        str(token),
    ]

    def answers() -> bool:
        try:
            return httpx2.get(f"http://127.0.0.1:{port}/health/live", trust_env=False).status_code == 200
        except httpx2.TransportError:
            return False

    with Path("/dev/full").open("w") as full, subprocess.Popen(command, stdout=full, cwd=tmp_path) as process:
        try:
            wait_until(lambda: answers() or process.poll() is not None)
            assert process.poll() is None
        finally:
            process.terminate()
    assert process.returncode == 0


def test_a_file_that_cannot_be_used_is_named_and_not_taken_for_a_lost_output(
    capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    absent = tmp_path / "absent.toml"
    assert exit_code("program", "daemon", lambda: len(absent.read_text()), (OSError,)) == 2
    assert capsys.readouterr().err == f"program: {absent}: No such file or directory\n"


def test_an_unexpected_error_is_a_traceback() -> None:
    def work() -> int:
        return 1 // 0

    with pytest.raises(ZeroDivisionError):
        exit_code("program", "daemon", work)


def test_an_error_of_our_own_is_a_traceback_and_no_missing_extra() -> None:
    def work() -> int:
        import beamtouch_common.absent  # type: ignore[import-not-found]  # noqa: PLC0415

        return int(beamtouch_common.absent)

    with pytest.raises(ModuleNotFoundError):
        exit_code("program", "daemon", work)


def test_the_contract_of_commands_imports_no_module_that_only_types_need() -> None:
    """The import of `typing` takes a fifth of the time of `--help`."""
    program = "import sys, beamtouch_common.commands, beamtouch_models; print({'typing'} & set(sys.modules))"
    roots = [str(Path(path).parent) for package in (beamtouch_common, beamtouch_models) for path in package.__path__]
    command = [sys.executable, "-S", "-c", f"import sys; sys.path[:0] = {roots}; {program}"]
    done = subprocess.run(command, capture_output=True, text=True, check=True)
    assert done.stdout == "set()\n"
