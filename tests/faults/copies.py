"""Copies of the tree, in which faults are put and tests are run; nothing that a test starts is left."""

import asyncio
import contextlib
import os
import re
import shutil
import signal
import subprocess
import sys
import tempfile
from collections.abc import Sequence
from dataclasses import dataclass
from fnmatch import fnmatch
from pathlib import Path
from time import monotonic

ROOT = Path(__file__).parent.parent.parent
PACKAGES = ("common", "firmware_protocol", "models", "service", "daemon")
TIMEOUT_S = 1800.0
"""Bounds a run of tests. Each test has a bound of its own, which ends it with its processes."""
FINISHING_S = 20.0
"""Time for tests that are interrupted to put away what they made."""
FAILED = 1
"""Exit code of pytest if a test failed. Others mean that the tests could not be run."""


@dataclass(frozen=True)
class Outcome:
    """What the tests said."""

    code: int
    output: str
    seconds: float

    @property
    def failure(self) -> str:
        """The first test that failed, and the first line of its error."""
        test = re.search(r"^FAILED (.+) \(\w+\)$", self.output, re.MULTILINE)
        error = re.search(r"^E +(?!AssertionError: $)(.+)$", self.output, re.MULTILINE)
        return "\n        ".join(found[1] for found in (test, error) if found)


def copy_tree(folder: Path) -> Path:
    """Copy the tree without what git ignores."""
    patterns = [".git/", ".git", *(ROOT / ".gitignore").read_text().split()]

    def ignored(parent: str, names: list[str]) -> list[str]:
        marked = {name: f"{name}/" if (Path(parent) / name).is_dir() else name for name in names}
        return [name for name in names if any(fnmatch(marked[name], pattern) for pattern in patterns)]

    return Path(shutil.copytree(ROOT, folder, ignore=ignored))


def environment_of(copy: Path) -> dict[str, str]:
    """Return the environment in which Python takes the packages of a copy."""
    packages = os.pathsep.join(str(copy / package) for package in PACKAGES)
    # Tests of a copy may be started by a test.
    outer = {name: value for name, value in os.environ.items() if not name.startswith(("PYTEST_", "COV"))}
    return outer | {"PYTHONPATH": packages, "PYTHONDONTWRITEBYTECODE": "1"}


async def run_tests(copy: Path, tests: Sequence[str], *options: str, timeout_s: float = TIMEOUT_S) -> Outcome:
    """Run tests in a copy, with the packages of the copy; nothing that they start is left."""
    started_s = monotonic()
    with tempfile.TemporaryFile("w+") as output:
        process = await asyncio.create_subprocess_exec(
            *(sys.executable, "-m", "pytest", "-q", "-p", "no:cacheprovider", *options, *tests),
            cwd=copy,
            env=environment_of(copy),
            stdin=subprocess.DEVNULL,
            stdout=output,
            stderr=subprocess.STDOUT,
            start_new_session=True,
        )
        try:
            code = await asyncio.wait_for(process.wait(), timeout_s)
        except TimeoutError:
            code = -signal.SIGKILL
        except asyncio.CancelledError:
            process.send_signal(signal.SIGINT)
            with contextlib.suppress(TimeoutError):
                await asyncio.wait_for(process.wait(), FINISHING_S)
            raise
        finally:
            end_session(process.pid)
        output.seek(0)
        return Outcome(code, output.read(), monotonic() - started_s)


def end_session(session: int) -> None:
    """Kill the processes that are left of a session, in whatever process groups they are."""
    for folder in Path("/proc").glob("[0-9]*"):
        with contextlib.suppress(OSError):  # it has ended meanwhile
            _, _, _, of_session = (folder / "stat").read_text().rpartition(")")[2].split()[:4]
            if int(of_session) == session:
                os.kill(int(folder.name), signal.SIGKILL)
