"""Runs tests in processes forked from one that has imported the libraries: most mutants are seen within a second.

Starting Python, and importing numpy and all the others, takes longer than most of the tests that see a mutant. This
process imports nothing of the packages, so that what it forks imports them as they are then. It is a program of its
own: `python forking.py` reads requests in JSON, a line each, with the arguments of pytest and a time [s], and answers
each with the exit code and what the tests printed.
"""

import asyncio
import contextlib
import importlib
import json
import os
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Sequence
from functools import partial
from pathlib import Path
from typing import Any

sys.path.insert(0, str(Path(__file__).parent.parent))

from faults.copies import PACKAGES, Outcome, end_session, environment_of

LIBRARIES = (
    *("aiohttp", "asyncua", "fastapi", "httptools", "onnx", "onnxruntime", "paho.mqtt.client", "prometheus_client"),
    *("pydantic", "pymodbus.client", "pytest", "scipy.interpolate", "scipy.optimize", "scipy.signal", "scipy.stats"),
    *("serial", "sqlalchemy", "uvicorn"),
)
"""Those that take long to import."""
ONE_THREAD = dict.fromkeys(("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS"), "1")
IMPORTED_EARLY = ("-W", "ignore::pytest.PytestAssertRewriteWarning")
"""Libraries that are plugins of pytest, too, are imported before it can rewrite their assertions."""
PAUSE_S = 0.02
LONGEST_OUTPUT = 2**20
"""Bytes at the end of what tests print, which have the test that failed; a mutant that loops may print without end."""
LONGEST_ANSWER = 2**23
"""Bytes of an answer in JSON, in which a byte of the output may take six."""


class Runner:
    """A process that runs tests in a copy of the tree."""

    def __init__(self, copy: Path) -> None:
        """Compile the copy, so that each run compiles the mutated file only."""
        self._copy = copy
        self._process: asyncio.subprocess.Process | None = None
        writing = {name: value for name, value in environment_of(copy).items() if name != "PYTHONDONTWRITEBYTECODE"}
        for command in (["compileall", "-q", *PACKAGES], ["pytest", "-q", "--collect-only", "-p", "no:cacheprovider"]):
            words, quiet = [sys.executable, "-m", *command], subprocess.DEVNULL
            subprocess.run(words, cwd=copy, env=writing, check=False, stdout=quiet, stderr=quiet)

    async def run(self, arguments: Sequence[str], timeout_s: float) -> Outcome:
        """Run tests; nothing that they start is left. A mutant whose tests end this process too was seen."""
        if self._process is None:
            self._process = await asyncio.create_subprocess_exec(
                *(sys.executable, __file__),
                cwd=self._copy,
                env=environment_of(self._copy) | ONE_THREAD,
                stdin=asyncio.subprocess.PIPE,
                stdout=asyncio.subprocess.PIPE,
                limit=LONGEST_ANSWER,
                start_new_session=True,  # Ctrl-C is for this process, which then ends that one
            )
        assert self._process.stdin is not None
        assert self._process.stdout is not None
        self._process.stdin.write(json.dumps([list(arguments), timeout_s]).encode() + b"\n")
        answer = await self._process.stdout.readline()
        if not answer:
            await self._process.wait()
            self._process = None  # the next tests get another one
            return Outcome(-signal.SIGKILL, "", 0.0)
        return Outcome(**json.loads(answer))

    async def close(self) -> None:
        """End the process with what it runs."""
        if self._process is not None:
            with contextlib.suppress(ProcessLookupError):
                self._process.terminate()
            await self._process.wait()


def main() -> None:
    """Answer requests until they end."""
    for name in LIBRARIES:
        with contextlib.suppress(ImportError):
            importlib.import_module(name)
    for line in sys.stdin:
        arguments, timeout_s = json.loads(line)
        print(json.dumps(run_forked(arguments, timeout_s)), flush=True)


def run_forked(arguments: Sequence[str], timeout_s: float) -> dict[str, Any]:
    """Run pytest in a forked process in a session of its own, and return what makes an `Outcome`."""
    begin_s = time.monotonic()
    with tempfile.TemporaryFile() as output:
        signal.pthread_sigmask(signal.SIG_BLOCK, [signal.SIGTERM])  # it comes before both are ready, or after that
        child = os.fork()
        if not child:
            os.setsid()
            signal.signal(signal.SIGTERM, signal.SIG_DFL)
            signal.pthread_sigmask(signal.SIG_UNBLOCK, [signal.SIGTERM])
            for stream, number in ((Path(os.devnull).open(), 0), (output, 1), (output, 2)):  # noqa: SIM115
                os.dup2(stream.fileno(), number)
            _be_pytest(arguments)
        signal.signal(signal.SIGTERM, partial(_end, child))
        signal.pthread_sigmask(signal.SIG_UNBLOCK, [signal.SIGTERM])
        code = None
        while code is None and time.monotonic() < begin_s + timeout_s:
            time.sleep(PAUSE_S)
            pid, status = os.waitpid(child, os.WNOHANG)
            code = os.waitstatus_to_exitcode(status) if pid else None
        end_session(child)
        if code is None:
            os.waitpid(child, 0)
            code = -signal.SIGKILL
        signal.signal(signal.SIGTERM, signal.SIG_DFL)
        output.seek(max(0, output.seek(0, os.SEEK_END) - LONGEST_OUTPUT))
        text = output.read().decode(errors="replace")
        return {"code": code, "output": text, "seconds": time.monotonic() - begin_s}


def _end(child: int, *_: object) -> None:
    with contextlib.suppress(ProcessLookupError):
        os.kill(child, signal.SIGKILL)  # which may have no session of its own yet
    end_session(child)
    os._exit(128 + signal.SIGTERM)


def _be_pytest(arguments: Sequence[str]) -> None:
    code = 3
    try:
        sys.argv = ["pytest"]
        # What it imported to copy the tree is the copy's own for the tests.
        for name in [name for name in sys.modules if name.partition(".")[0] in {"faults", "mutants"}]:
            del sys.modules[name]
        code = int(sys.modules["pytest"].main(["-q", "-p", "no:cacheprovider", *IMPORTED_EARLY, *arguments]))
    finally:
        sys.stdout.flush()
        sys.stderr.flush()
        os._exit(code)


if __name__ == "__main__":
    main()
