"""A disk that is really small: a tmpfs, mounted by root, by sudo, or in a name space of its own."""

import os
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

import pytest

FILL = """
import sys
with open(sys.argv[1], "ab", 0) as file:
    for size in (65536, 512, 1):
        try:
            while True:
                file.write(bytes(size))
        except OSError:
            pass
"""


@dataclass(frozen=True)
class SmallDisk:
    """A folder on the disk, as programs see it that are started with `prefix` before their command."""

    path: Path
    prefix: tuple[str, ...] = ()

    def fill(self) -> None:
        """Leave no room on it."""
        self.run(sys.executable, "-c", FILL, str(self.path / "filler"))

    def run(self, *command: str) -> str:
        """Run a command to its end; return what it prints."""
        done = subprocess.run((*self.prefix, *command), capture_output=True, text=True, check=False, timeout=120)
        assert done.returncode == 0, done.stderr
        return done.stdout


@contextmanager
def small_disk(folder: Path, size_kib: int) -> Iterator[SmallDisk]:
    """Mount a disk of this size for a block. Skips the test where nothing can be mounted; in CI it fails then."""
    path = folder / "small disk"
    path.mkdir()
    mount = ("mount", "-t", "tmpfs", "-o", f"size={size_kib}k,mode=0777", "none", str(path))
    for sudo in ((), ("sudo", "-n")):
        if _works(*sudo, *mount):
            try:
                yield SmallDisk(path)
            finally:
                subprocess.run((*sudo, "umount", "--lazy", str(path)), check=True)
            return
    if not _works("unshare", "--map-root-user", "--mount", *mount):
        words = "neither root, sudo nor a user name space can mount a small disk here"
        (pytest.fail if os.environ.get("CI") else pytest.skip)(words)
    script = '"$@" && echo mounted && exec sleep 900'
    command = ("unshare", "--map-root-user", "--mount", "sh", "-c", script, "sh", *mount)
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as keeper:
        try:
            assert keeper.stdout is not None
            assert keeper.stdout.readline() == "mounted\n"
            enter = ("nsenter", f"--target={keeper.pid}", "--user", "--mount", "--preserve-credentials")
            yield SmallDisk(path, (*enter, f"--wd={Path.cwd()}"))
        finally:
            keeper.kill()


def _works(*command: str) -> bool:
    try:
        return subprocess.run(command, capture_output=True, check=False).returncode == 0
    except OSError:
        return False
