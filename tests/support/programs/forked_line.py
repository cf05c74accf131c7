"""The line of the demo, and a rig on which a test presses by hand, in processes that are forked.

To import their modules takes rig, service and daemon five seconds of a core together. Tutorial, guides and demo start
the same commands as a user does.
"""

import subprocess
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any, cast

import httpx2

from line import Line
from support.network.plain_http import NO_TLS, TIMEOUT_S
from support.programs.forked import Forked
from support.running.waiting import wait_until

MODULES = {
    "beamtouch-daemon": "beamtouch_daemon.cli",
    "beamtouch-rig": "beamtouch_models.lab.rig.cli",
    "beamtouch-service": "beamtouch_service.cli",
}


class ForkedLine(Line):
    """The same line."""

    def _start(self, name: str, command: list[str]) -> None:
        program, *words = command
        log = self.folder / f"{name}.log"
        log.write_text("")
        code = f"import os; os.dup2(os.open({str(log)!r}, os.O_WRONLY | os.O_APPEND), 2)"
        process = Forked(MODULES[program], words, Path.cwd(), code)
        process.stderr.close()
        process.stdin.close()
        # It does all that a line asks of one.
        self._processes[name] = cast("subprocess.Popen[str]", process)

    def contact(self) -> dict[str, Any]:
        """Return what the service answers now."""
        found: dict[str, Any] = httpx2.get(f"{self.url}/contact", verify=NO_TLS, timeout=TIMEOUT_S).json()
        return found

    def wait_for_still_contact(self) -> dict[str, Any]:
        """Return the contact once it has no note, and a mean of more readings than a touch has."""

        def is_still() -> bool:
            found = self.contact()
            return found.get("state") == "contact" and not found["notes"] and found["readings"] > 20

        wait_until(is_still)
        return self.contact()


class Rig:
    """A rig by itself, on which a test presses if it is by hand."""

    def __init__(self, rig: Forked) -> None:
        self._rig = rig
        self.place = rig.stdout.readline().strip().rpartition(" ")[2].rpartition(":")[2]
        """Its port of Modbus TCP, on loopback, or the path of its line."""

    def put(self, load: str) -> None:
        """Put a load on in place of the last one, or nothing; it is so when this returns."""
        self._rig.stdin.write(f"{load}\n")
        self._rig.stdin.flush()
        said = self._rig.stdout.readline()
        assert said.endswith(" on\n"), said


@contextmanager
def rig(scene: Path, model: Path, *options: str | Path) -> Iterator[Rig]:
    """Run a rig until the end of the block."""
    process = Forked(MODULES["beamtouch-rig"], [str(word) for word in (scene, "--model", model, *options)], Path.cwd())
    try:
        yield Rig(process)
    finally:
        process.terminate()
        process.communicate(timeout=60)
