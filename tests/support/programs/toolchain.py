"""Compilers for the parts that are not Python, and what they make, once per test run."""

import os
import shutil
import subprocess
from collections.abc import Callable
from pathlib import Path

import pytest
from filelock import FileLock

from support.running.debian_parts import give_up

FIRMWARE_PROTOCOL = Path(__file__).parents[3] / "firmware_protocol"
CODEC = FIRMWARE_PROTOCOL / "c"


def need(*programs: str) -> None:
    """Skip the test if a program is missing; where changes are decided (CI=true) that is a failure."""
    missing = [program for program in programs if shutil.which(program) is None]
    if missing:
        give_up(f"{', '.join(missing)} not installed")


def run(*command: str | Path) -> str:
    """Run a command to its end; its standard output, or a failed test with all that it said."""
    done = subprocess.run(command, capture_output=True, text=True, timeout=120, check=False)
    assert done.returncode == 0, f"{' '.join(map(str, command))}\n{done.stdout}{done.stderr}"
    return done.stdout


def made_once(factory: pytest.TempPathFactory, name: str, make: Callable[[Path], object]) -> Path:
    """Return a folder that `make` has filled, in whichever test process came first."""
    base = factory.getbasetemp()
    folder = (base.parent if "PYTEST_XDIST_WORKER" in os.environ else base) / name
    with FileLock(folder.with_suffix(".lock")):
        done = folder / ".done"
        if not done.exists():
            folder.mkdir(exist_ok=True)
            make(folder)
            done.touch()
    return folder
