"""Commands in processes of their own, forked from a server that has imported their libraries already.

Libraries take half a second of a processor to import, and tests start hundreds of processes. A forked process has
arguments, folder, environment, standard streams and signals of its own, and imports the modules of the command anew.
It ends without the teardown of an interpreter. The tests of the whole system start each command as a user does.
"""

import contextlib
import importlib
import multiprocessing
import multiprocessing.connection
import os
import sys
from collections.abc import Sequence
from multiprocessing.connection import Connection
from pathlib import Path
from signal import SIGKILL
from subprocess import TimeoutExpired
from threading import Lock, Thread
from typing import TextIO

LIBRARIES = (
    *("aiohttp", "cobs.cobs", "pymodbus.client", "serial", "sqlite3"),
    *("fastapi", "httptools", "sqlalchemy.dialects.postgresql", "sqlalchemy.dialects.sqlite"),
    *("uvicorn.protocols.http.httptools_impl", "pydantic.v1", "statistics", "tomllib"),
    *("numpy.typing", "prometheus_client", "pydantic.main"),
)
"""Those that take long to import. One that starts a thread when it is imported, as onnxruntime does, cannot be one."""

_CONTEXT = multiprocessing.get_context("forkserver")
_CONTEXT.set_forkserver_preload(list(LIBRARIES))
_ASKING = Lock()
"""Starting a process asks for the exit codes of all others too, and the answer to each comes once."""


class Forked:
    """A process of a command; its standard streams are pipes. It can do what tests ask of a `subprocess.Popen`."""

    def __init__(self, command: str, arguments: Sequence[str], folder: Path) -> None:
        """Start the `main` of a module `command`."""
        its_stdin, stdin = _CONTEXT.Pipe(duplex=False)
        stdout, its_stdout = _CONTEXT.Pipe(duplex=False)
        stderr, its_stderr = _CONTEXT.Pipe(duplex=False)
        theirs = (its_stdin, its_stdout, its_stderr)
        self.args = arguments
        self.stdin, self.stdout, self.stderr = _file(stdin, "w"), _file(stdout, "r"), _file(stderr, "r")
        request = (command, arguments, folder, dict(os.environ), theirs)
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

    def kill(self) -> None:
        self.send_signal(SIGKILL)

    def communicate(self, typed: str = "", timeout: float | None = None) -> tuple[str, str]:
        """Type this; return what comes from standard output and standard error once the process has ended."""
        if not self._readers:
            self._readers = [Thread(target=self._read, args=(index,), daemon=True) for index in range(2)]
            for reader in self._readers:
                reader.start()
            with contextlib.suppress(BrokenPipeError), self.stdin:
                self.stdin.write(typed)
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
    command: str, arguments: Sequence[str], folder: Path, environment: dict[str, str], streams: Sequence[Connection]
) -> None:
    """Be the command, in a forked process."""
    for number, stream in enumerate(streams):
        os.dup2(stream.fileno(), number)
        stream.close()
    sys.stdin, sys.stdout = open(0, encoding="utf-8", closefd=False), open(1, "w", encoding="utf-8", closefd=False)  # noqa: SIM115
    # The server passes over what it cannot import.
    missing = [name for name in LIBRARIES if name not in sys.modules]
    if missing:
        sys.exit(f"not imported beforehand: {', '.join(missing)}")
    os.chdir(folder)
    os.environ.clear()
    os.environ.update(environment)
    sys.argv[1:] = arguments
    sys.exit(importlib.import_module(command).main())
