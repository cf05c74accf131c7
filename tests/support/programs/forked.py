"""Commands in processes of their own, forked from a server that has imported their modules already.

Libraries and modules take most of a second of a processor to import, and tests start hundreds of processes. A forked
process has arguments, folder, environment, standard streams and signals of its own. It ends without the teardown of an
interpreter. Tutorial, guides and demo start each command as a user does.
"""

import contextlib
import gc
import importlib
import multiprocessing
import multiprocessing.connection
import os
import sys
from collections.abc import Sequence
from multiprocessing.connection import Connection
from pathlib import Path
from signal import SIGKILL, SIGTERM
from subprocess import TimeoutExpired
from threading import Lock, Thread
from typing import TextIO

import coverage

MODULES = (
    "coverage",  # of this module, which each of the processes imports
    *("aiohttp", "cobs.cobs", "pymodbus.client", "serial", "sqlite3"),
    *("fastapi", "httptools", "sqlalchemy.dialects.postgresql", "sqlalchemy.dialects.sqlite"),
    *("uvicorn.protocols.http.httptools_impl", "pydantic.v1", "statistics", "tomllib"),
    *("numpy.typing", "prometheus_client", "pydantic.main", "paho.mqtt.client", "pymodbus.framer"),
    *("beamtouch_service.cli", "beamtouch_service.host.setup", "beamtouch_service.api.app"),
    *("asyncua.server", "beamtouch_service.outputs.opcua.server"),
    *("beamtouch_daemon.cli", "beamtouch_daemon.running.daemon"),
    *(f"beamtouch_daemon.commands.{name}" for name in ("check", "noise", "record", "run", "scan", "tare")),
    *("beamtouch_models.runtime.loading", "beamtouch_models.lab.rig.cli", "beamtouch_models.lab.rig.run"),
)
"""Those that take long to import. With a thread for numbers, as tests have it, none of them starts another one."""

_CONTEXT = multiprocessing.get_context("forkserver")
_CONTEXT.set_forkserver_preload(list(MODULES))
_ASKING = Lock()
"""Starting a process asks for the exit codes of all others too, and the answer to each comes once."""


class Forked:
    """A process of a command; its standard streams are pipes. It can do what tests ask of a `subprocess.Popen`."""

    def __init__(self, command: str, arguments: Sequence[str], folder: Path, code: str = "") -> None:
        """Start the `main` of a module `command`, with Python `code` run before it."""
        its_stdin, stdin = _CONTEXT.Pipe(duplex=False)
        stdout, its_stdout = _CONTEXT.Pipe(duplex=False)
        stderr, its_stderr = _CONTEXT.Pipe(duplex=False)
        theirs = (its_stdin, its_stdout, its_stderr)
        self.args = arguments
        self.stdin, self.stdout, self.stderr = _file(stdin, "w"), _file(stdout, "r"), _file(stderr, "r")
        request = (command, arguments, folder, dict(os.environ), theirs, code)
        self._process = _CONTEXT.Process(target=_run, args=request, daemon=True)
        with _ASKING:
            self._process.start()
        for end in theirs:
            end.close()
        self.pid = self._process.pid or 0
        self._said, self._readers = ["", ""], list[Thread]()

    @property
    def returncode(self) -> int | None:
        """The exit code, or the negative number of the signal that ended it; None while it runs."""
        with _ASKING:
            return self._process.exitcode

    def poll(self) -> int | None:
        return self.returncode

    def wait(self, timeout: float | None = None) -> int:
        """Wait for the end; raises TimeoutExpired if it does not come in time [s]."""
        multiprocessing.connection.wait([self._process.sentinel], timeout)
        code = self.returncode
        if code is None:
            raise TimeoutExpired(list(self.args), timeout or 0)
        return code

    def send_signal(self, number: int) -> None:
        if self.poll() is None:
            with contextlib.suppress(ProcessLookupError):
                os.kill(self.pid, number)

    def terminate(self) -> None:
        self.send_signal(SIGTERM)

    def kill(self) -> None:
        self.send_signal(SIGKILL)

    def communicate(self, timeout: float | None = None) -> tuple[str, str]:
        """Type no more; return what comes from standard output and standard error once the process has ended."""
        if not self._readers:
            self._readers = [Thread(target=self._read, args=(index,), daemon=True) for index in range(2)]
            for reader in self._readers:
                reader.start()
            with contextlib.suppress(BrokenPipeError):
                self.stdin.close()
        self.wait(timeout)
        for reader in self._readers:
            reader.join()
        return self._said[0], self._said[1]

    def _read(self, index: int) -> None:
        with (self.stdout, self.stderr)[index] as stream:
            self._said[index] = stream.read()


def _file(end: Connection, mode: str) -> TextIO:
    """Return a text file for an end of a pipe, in its place."""
    with end:
        return open(os.dup(end.fileno()), mode, encoding="utf-8")  # type: ignore[return-value]  # noqa: PTH123


def _run(
    command: str,
    arguments: Sequence[str],
    folder: Path,
    environment: dict[str, str],
    streams: Sequence[Connection],
    code: str,
) -> None:
    """Be the command, in a forked process."""
    # What was imported beforehand stays shared: a search for garbage would touch, and so copy, all of it.
    gc.freeze()
    for number, stream in enumerate(streams):
        os.dup2(stream.fileno(), number)
        stream.close()
    sys.stdin, sys.stdout = open(0, encoding="utf-8", closefd=False), open(1, "w", encoding="utf-8", closefd=False)  # noqa: SIM115
    # The server passes over what it cannot import.
    missing = [name for name in MODULES if name not in sys.modules]
    if missing:
        sys.exit(f"not imported beforehand: {', '.join(missing)}")
    os.chdir(folder)
    os.environ.clear()
    os.environ.update(environment)
    if "COVERAGE_PROCESS_START" in environment:
        # What the process runs counts for the test that started it, and not for the first one of all.
        coverage.process_startup(force=True)
    sys.argv[1:] = arguments
    exec(code, {})  # noqa: S102 - of the tests
    sys.exit(importlib.import_module(command).main())
