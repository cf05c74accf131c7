"""The daemon as the user starts it: a process of its own."""

import asyncio
import json
import signal
import subprocess
import sys
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from support.programs.forked import Forked

COMMAND = "beamtouch_daemon.cli"
PATIENT_STOP = "from beamtouch_daemon.running import daemon; daemon.FINISH_S = 60.0"
"""Code by which a stop has a minute to deliver what is left: the 2.5 s of the daemon are short on a starved machine."""
Process = subprocess.Popen[str] | Forked


@dataclass(frozen=True)
class Outcome:
    """How a process ended and what it said."""

    code: int
    out: str
    err: str

    def complaint(self) -> str:
        """Return the only line on standard error."""
        (line,) = self.err.splitlines()
        assert line.startswith("beamtouch-daemon: ")
        return line.removeprefix("beamtouch-daemon: ")


class Daemon:
    """A running daemon."""

    def __init__(self, process: Process) -> None:
        self._process = process

    @property
    def pid(self) -> int:
        """Process id, for reading its memory and open files."""
        return self._process.pid

    async def stop(self, number: signal.Signals = signal.SIGTERM) -> Outcome:
        """Send a signal and wait for the end."""
        self._process.send_signal(number)
        return await self.end()

    async def said(self, end: str) -> str:
        """Return what it writes to standard error up to these words, or up to its end."""
        return await asyncio.to_thread(self._read, end)

    def _read(self, end: str) -> str:
        assert self._process.stderr is not None
        said = ""
        while not said.endswith(end) and (more := self._process.stderr.read(1)):
            said += more
        return said

    def answer(self, line: str) -> None:
        """Write a line to its standard input."""
        assert self._process.stdin is not None
        self._process.stdin.write(f"{line}\n")
        self._process.stdin.flush()

    def tell(self, number: signal.Signals) -> None:
        """Send a signal and go on."""
        self._process.send_signal(number)

    async def end(self) -> Outcome:
        """Wait for the end."""
        out, err = await asyncio.to_thread(self._process.communicate, timeout=60)
        return Outcome(self._process.wait(), out, err)


def _start(words: list[str], code: str, prefix: tuple[str, ...]) -> Process:
    # What is missing must not have been imported before.
    if not (prefix or "sys.modules" in code):
        return Forked(COMMAND, words, Path.cwd(), code)
    program = ("-c", f"import sys; {code}; from {COMMAND} import main; sys.exit(main())")
    pipe = subprocess.PIPE
    return subprocess.Popen(
        [*prefix, sys.executable, *(program if code else ("-m", "beamtouch_daemon")), *words],
        stdin=pipe,
        stdout=pipe,
        stderr=pipe,
        text=True,
    )


@asynccontextmanager
async def started(*arguments: str | Path, code: str = "", prefix: tuple[str, ...] = ()) -> AsyncIterator[Daemon]:
    """Start the daemon, with Python `code` run before it, by `prefix`; it is gone at the end of the block.

    With a prefix it is started anew, otherwise forked.
    """
    process = await asyncio.to_thread(_start, [str(one) for one in arguments], code, prefix)
    try:
        yield Daemon(process)
    finally:
        if process.returncode is None:
            process.kill()
            await asyncio.to_thread(process.communicate)


async def command(*arguments: str | Path, code: str = "") -> Outcome:
    """Run a command to its end."""
    async with started(*arguments, code=code) as daemon:
        return await daemon.end()


def summary_of(folder: Path) -> dict[str, Any]:
    content: dict[str, Any] = json.loads((folder / "summary.json").read_text())
    return content["surfaces"]  # type: ignore[no-any-return]
