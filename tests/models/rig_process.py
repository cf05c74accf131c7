"""`beamtouch-rig` as a process, for tests that talk with it."""

import os
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

RIG = str(Path(sys.executable).parent / "beamtouch-rig")


@contextmanager
def process_of(*options: str | Path) -> Iterator[subprocess.Popen[str]]:
    pipe, words = subprocess.PIPE, [RIG, *map(str, options)]
    environment = os.environ | {"PYTHONIOENCODING": "utf-8:strict"}  # as with LANG=en_US.UTF-8
    with subprocess.Popen(words, stdin=pipe, stdout=pipe, stderr=pipe, text=True, env=environment) as process:
        try:
            yield process
        finally:
            process.kill()
