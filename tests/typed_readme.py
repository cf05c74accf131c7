"""A shell that types steps of the README, as they stand there but for ports and the rate of the readings."""

import contextlib
import os
import re
import signal
import socket
import subprocess
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

from waiting import wait_until

ROOT = Path(__file__).parent.parent
PATIENCE_S, RATE_HZ = 400, 50.0
"""Time to wait for a step, and a rate of readings that a busy machine keeps."""


def blocks(title: str) -> list[str]:
    """Return the blocks of code in a section of the README."""
    section = (ROOT / "README.md").read_text().split(f"## {title}\n")[1].split("\n## ")[0]
    return re.findall(r"```\w*\n(.*?)```", section, re.DOTALL)


class Shell:
    """A shell in a folder that looks like a checkout after `make install`."""

    def __init__(self, folder: Path) -> None:
        (folder / "models").symlink_to(ROOT / "models")
        (folder / ".venv").symlink_to(sys.prefix)
        self._rig, self._service = _free_ports()
        self.url = f"http://127.0.0.1:{self._service}"
        """The address of the service."""
        self._output = folder / "output"
        with self._output.open("wb") as output:
            self._process = subprocess.Popen(
                ["bash", "-e"],
                cwd=folder,
                stdin=subprocess.PIPE,
                stdout=output,
                stderr=subprocess.STDOUT,
                text=True,
                start_new_session=True,
            )
        self._typed = 0

    def type(self, commands: str) -> str:
        """Type commands and wait until they have ended; return what the shell has printed meanwhile."""
        before, self._typed = len(self.printed), self._typed + 1
        done = f"typed block {self._typed}"
        self._write(f"{self._with_own_ports(commands)}\necho {done}\n")
        self.wait_until(lambda: done in self.printed)
        return self.printed[before:].partition(done)[0]

    def wait_until(self, condition: Callable[[], bool]) -> None:
        """Wait for a condition while the shell lives; a step that fails ends it."""

        def holds() -> bool:
            assert self._process.poll() is None, self.printed
            return condition()

        wait_until(holds, PATIENCE_S, pause_s=0.1)

    @property
    def printed(self) -> str:
        """Everything that the shell and its programs have printed."""
        return self._output.read_text()

    def leave(self) -> None:
        """Wait for the programs that were started and end the shell."""
        self._write("wait\nexit\n")
        assert self._process.wait(timeout=PATIENCE_S) == 0, self.printed

    def end(self) -> None:
        """End the shell and what it has left running."""
        # Programs outlive a shell that a failed step has ended.
        with contextlib.suppress(ProcessLookupError):
            os.killpg(self._process.pid, signal.SIGTERM)
        self._process.wait(timeout=PATIENCE_S)
        assert self._process.stdin is not None
        self._process.stdin.close()

    def _write(self, text: str) -> None:
        assert self._process.stdin is not None
        self._process.stdin.write(text)
        self._process.stdin.flush()

    def _with_own_ports(self, commands: str) -> str:
        """Return commands with free ports, also in the daemon's configuration once it is there."""
        ports = f"s/5020/{self._rig}/; s/8420/{self._service}/"
        commands = commands.replace("beamtouch-service run", f"beamtouch-service run --port {self._service}")
        commands = commands.replace("5020", str(self._rig)).replace("8420", str(self._service))
        change = f"sed -i '{ports}; s/^rate_hz = .*/rate_hz = {RATE_HZ}/' daemon.toml\n"
        return re.sub("^beamtouch-daemon", f"{change}beamtouch-daemon", commands, count=1, flags=re.MULTILINE)


@contextmanager
def shell(folder: Path) -> Iterator[Shell]:
    """A shell to type into; it ends with the block."""
    opened = Shell(folder)
    try:
        yield opened
    finally:
        opened.end()


def _free_ports() -> tuple[int, int]:
    with socket.socket() as one, socket.socket() as other:
        one.bind(("127.0.0.1", 0))
        other.bind(("127.0.0.1", 0))
        return one.getsockname()[1], other.getsockname()[1]
