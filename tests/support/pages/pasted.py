"""Blocks of commands in the pages, and a clean shell that they are pasted into."""

import contextlib
import json
import os
import re
import shutil
import signal
import subprocess
import sys
from collections.abc import Iterable
from contextlib import AbstractContextManager
from pathlib import Path
from tempfile import gettempdir
from typing import Any, NamedTuple

from filelock import FileLock

ROOT = Path(__file__).parents[3]
COMMANDS = "sh"
"""The word of the fences of commands that run anywhere. Those of `console` need a device, a host or a person."""
PATIENCE_S = 400.0
"""Time to wait for a page."""
_FENCE = re.compile(r"^```(\w*)\n(.*?)^```$", re.MULTILINE | re.DOTALL)
_ALONE = ("unshare", "--user", "--map-root-user", "--net", "sh", "-c", 'ip link set lo up && exec "$@"', "sh")
"""Runs a command in a network of its own, so that fixed ports are free."""


class Block(NamedTuple):
    """A fenced block of a page."""

    word: str
    text: str


def blocks_of(page: str) -> list[Block]:
    """Return the blocks of a page, by its path."""
    return [Block(*found) for found in _FENCE.findall((ROOT / page).read_text())]


def shown_in(text: str) -> dict[str, Any]:
    """Return an answer in a page as JSON; `...` stands for members that it leaves out."""
    shown: dict[str, Any] = json.loads(text.replace(", ... ", ",").replace(", ...}", "}"))
    return shown


def is_part_of(shown: Iterable[str], whole: Iterable[str]) -> bool:
    """Return whether names come in the order of others, which may have more between them."""
    others = iter(whole)
    return all(name in others for name in shown)


def paste(page: str, folder: Path, patience_s: float = PATIENCE_S) -> str:
    """Paste all blocks of commands of a page into a clean shell, in order and whole; return all that it printed."""
    script = folder / ".pasted.sh"
    script.write_text("\n".join(block.text for block in blocks_of(page) if block.word == COMMANDS))
    alone = _alone()
    with _fixed_ports(alone), (folder / ".printed").open("w+") as output:
        shell = subprocess.Popen(
            [*alone, "bash", "-e", script],
            cwd=folder,
            env=_clean(folder),
            stdin=subprocess.DEVNULL,
            stdout=output,
            stderr=subprocess.STDOUT,
            start_new_session=True,
        )
        try:
            code = shell.wait(patience_s)
        finally:
            with contextlib.suppress(ProcessLookupError):  # programs outlive a shell that a failed step has ended
                os.killpg(shell.pid, signal.SIGKILL)
            shell.wait()
        output.seek(0)
        printed = output.read()
    assert code == 0, printed
    return printed


def _clean(folder: Path) -> dict[str, str]:
    threads = {name: "1" for name in os.environ if name.endswith("_NUM_THREADS")}
    path = f"{sys.prefix}/bin:/usr/local/bin:/usr/bin:/bin:/usr/sbin:/sbin"
    return {"PATH": path, "HOME": str(folder), "LANG": "C.UTF-8"} | threads


def _alone() -> tuple[str, ...]:
    """Return the command before the shell; empty where networks of one's own are not allowed."""
    if shutil.which(_ALONE[0]) is None:
        return ()
    tried = subprocess.run([*_ALONE, "true"], capture_output=True, check=False)
    return _ALONE if tried.returncode == 0 else ()


def _fixed_ports(alone: tuple[str, ...]) -> AbstractContextManager[object]:
    """Return the lock of the ports that the pages name; nobody else has them in a network of one's own."""
    return contextlib.nullcontext() if alone else FileLock(Path(gettempdir()) / "beamtouch-pages.lock")
