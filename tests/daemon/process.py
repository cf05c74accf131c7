"""The daemon as the user starts it: a process of its own."""

import asyncio
import contextlib
import json
import os
import random
import signal
import socket
import sys
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any


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

    def __init__(self, process: asyncio.subprocess.Process) -> None:
        self._process = process

    @property
    def pid(self) -> int:
        """Of the process."""
        return self._process.pid

    async def stop(self, number: signal.Signals = signal.SIGTERM) -> Outcome:
        """Send a signal and wait for the end."""
        self._process.send_signal(number)
        return await self.end()

    def tell(self, number: signal.Signals) -> None:
        """Send a signal."""
        self._process.send_signal(number)

    async def end(self) -> Outcome:
        """Wait for the end."""
        out, err = await asyncio.wait_for(self._process.communicate(), 15)
        assert self._process.returncode is not None
        return Outcome(self._process.returncode, out.decode(), err.decode())


@asynccontextmanager
async def started(
    *arguments: str | Path, code: str = "", environment: dict[str, str] | None = None, prefix: tuple[str, ...] = ()
) -> AsyncIterator[Daemon]:
    """Start the daemon, with Python `code` run before it, by `prefix`; it is gone at the end of the block."""
    program = ("-c", f"{code}; from beamtouch_daemon.cli import main; sys.exit(main())") if code else None
    process = await asyncio.create_subprocess_exec(
        *prefix,
        sys.executable,
        *(program or ("-m", "beamtouch_daemon")),
        *map(str, arguments),
        stdin=asyncio.subprocess.PIPE,
        stdout=asyncio.subprocess.PIPE,
        stderr=asyncio.subprocess.PIPE,
        env=os.environ | (environment or {}),
    )
    try:
        yield Daemon(process)
    finally:
        if process.returncode is None:
            process.kill()
            await process.communicate()


async def command(*arguments: str | Path, code: str = "") -> Outcome:
    """Run a command to its end."""
    async with started(*arguments, code=code) as daemon:
        return await daemon.end()


def summary_of(folder: Path) -> dict[str, Any]:
    content: dict[str, Any] = json.loads((folder / "summary.json").read_text())
    return content["surfaces"]  # type: ignore[no-any-return]


def free_port() -> int:
    """Return a port that stays free for a while: below those that outgoing connections of this machine get."""
    while True:
        port = random.randrange(20_000, 32_000)  # noqa: S311 - no secret
        with contextlib.suppress(OSError), socket.create_server(("127.0.0.1", port)):
            return port
